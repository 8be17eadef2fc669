"""Manifolds of matrices that are not groups."""

from .positive_definite import SPD, AffineInvariantMetric

__all__ = ["SPD", "AffineInvariantMetric"]
