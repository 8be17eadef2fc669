"""The integrability algorithm: classification of optimal control problems, and the final manifold P_f."""

from ..integrability_result import Signature
from .classification import Classification, MorseTest, Stratum
from .classify import classify
from .final import FinalEquations
from .hulls import AffineHull
from .lagrangian_submanifolds import L_H, S_H, critical_set
from .levels import Level

__all__ = [
    "L_H",
    "S_H",
    "AffineHull",
    "Classification",
    "FinalEquations",
    "Level",
    "MorseTest",
    "Signature",
    "Stratum",
    "classify",
    "critical_set",
]
