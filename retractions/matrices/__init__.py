"""Retractions of the manifolds of ``retrax.manifolds.matrices``."""

from .fixed_rank import FixedRankOrthographic, FixedRankProjection
from .grassmann import GrassmannCayley, GrassmannExponential, GrassmannPolar
from .oblique import Columnwise
from .positive_definite import SPDExponential, SPDLogEuclidean, SPDSecondOrder
from .stiefel import StiefelCayley, StiefelPolar, StiefelQR
from .stiefel_exponential import StiefelCanonicalExponential, StiefelExponential

__all__ = [
    "Columnwise",
    "FixedRankOrthographic",
    "FixedRankProjection",
    "GrassmannCayley",
    "GrassmannExponential",
    "GrassmannPolar",
    "SPDExponential",
    "SPDLogEuclidean",
    "SPDSecondOrder",
    "StiefelCanonicalExponential",
    "StiefelCayley",
    "StiefelExponential",
    "StiefelPolar",
    "StiefelQR",
]
