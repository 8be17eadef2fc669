"""Retractions of the manifolds of ``retrax.manifolds.vectors``."""

from .euclidean import Addition
from .hyperbolic import HyperbolicExponential, HyperbolicProjection
from .simplex import SimplexExponential
from .sphere import SphereExponential, SphereProjection

__all__ = [
    "Addition",
    "HyperbolicExponential",
    "HyperbolicProjection",
    "SimplexExponential",
    "SphereExponential",
    "SphereProjection",
]
