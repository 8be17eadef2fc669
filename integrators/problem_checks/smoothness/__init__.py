"""Searches for kinks, discontinuities and derivatives that miss a change."""
