"""Retractions of the manifolds of ``retrax.manifolds.vectors``."""

from .euclidean import Addition
from .sphere import SphereExponential, SphereProjection

__all__ = ["Addition", "SphereExponential", "SphereProjection"]
