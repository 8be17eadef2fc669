"""Evaluation of functions: the binding of the compiled core."""
