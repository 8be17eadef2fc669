"""Manifolds whose points are arrays of numbers without the structure of a matrix."""

from .euclidean import Euclidean
from .hyperbolic import Hyperbolic, LorentzMetric
from .simplex import Simplex
from .sphere import Sphere

__all__ = ["Euclidean", "Hyperbolic", "LorentzMetric", "Simplex", "Sphere"]
