"""Vectors of numbers in loops that Python runs."""

from .numpy_vectors import *  # noqa: F403
