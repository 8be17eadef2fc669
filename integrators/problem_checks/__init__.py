"""Checks of a problem before it is solved: costs, use of the controls, smoothness."""
