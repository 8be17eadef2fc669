"""Manifolds whose points are arrays of numbers without the structure of a matrix."""

from .euclidean import Euclidean
from .sphere import Sphere

__all__ = ["Euclidean", "Sphere"]
