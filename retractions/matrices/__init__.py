"""Retractions of the manifolds of ``retrax.manifolds.matrices``."""

from .positive_definite import SPDExponential, SPDLogEuclidean, SPDSecondOrder

__all__ = ["SPDExponential", "SPDLogEuclidean", "SPDSecondOrder"]
