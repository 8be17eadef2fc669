"""The integrability algorithm: classification of optimal control problems, and the final manifold P_f."""

from ..integrability_result import Signature
from .affine_hulls import AffineHull
from .algorithm_stages import Level
from .classification import Classification, MorseTest
from .classify import classify
from .final_equations import FinalEquations
from .lagrangian_submanifolds import L_H, S_H, critical_set
from .strata import Stratum

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
