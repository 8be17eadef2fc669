"""Manifolds of matrices that are not groups."""

from .fixed_rank import FixedRank
from .grassmann import Grassmann
from .oblique import Oblique
from .positive_definite import SPD, AffineInvariantMetric
from .stiefel import CanonicalMetric, ComplexStiefel, Stiefel

__all__ = [
    "SPD",
    "AffineInvariantMetric",
    "CanonicalMetric",
    "ComplexStiefel",
    "FixedRank",
    "Grassmann",
    "Oblique",
    "Stiefel",
]
