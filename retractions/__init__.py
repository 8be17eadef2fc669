"""Retractions, discretization maps and their cotangent lifts."""

if __package__ != "retrax.retractions":
    raise ImportError(
        f"import this package as retrax.retractions (pip install .), not as {__package__}: "
        "a second copy of its classes would not match the first"
    )

from typing import Any

from ..former_names import former
from . import constructions, groups, matrices, vectors
from .collocation import CollocationMethod
from .constructions import *
from .cotangent_lift import BundleRetraction, CotangentLift, cotangent_lift
from .differential import DifferentiatedRetraction, differential_adjoint, differentiated
from .discretization import Adjoint, DiscretizationMap, Euler, Midpoint, Theta
from .families import QR, Cayley, Exponential, Polar, Projection, RetractionFamily, default_retraction
from .gauss import Gauss
from .groups import *
from .level_set import LevelSetProjection
from .matrices import *
from .measured_order import MeasuredOrder, measured_order
from .radau import Radau
from .restored import ProjectionByNewton
from .retraction import MidpointRetraction, Retraction
from .submanifold import Orthographic
from .vectors import *

__all__ = [
    "QR",
    "Adjoint",
    "BundleRetraction",
    "Cayley",
    "CollocationMethod",
    "CotangentLift",
    "DifferentiatedRetraction",
    "DiscretizationMap",
    "Euler",
    "Exponential",
    "Gauss",
    "LevelSetProjection",
    "MeasuredOrder",
    "Midpoint",
    "MidpointRetraction",
    "Orthographic",
    "Polar",
    "Projection",
    "ProjectionByNewton",
    "Radau",
    "Retraction",
    "RetractionFamily",
    "Theta",
    "cotangent_lift",
    "default_retraction",
    "differential_adjoint",
    "differentiated",
    "measured_order",
]
__all__ += constructions.__all__
__all__ += groups.__all__
__all__ += matrices.__all__
__all__ += vectors.__all__

FORMER = {
    "Restored": "ProjectionByNewton",
    "Stabilized": "RestoredAfter",
    "fibre_adjoint": "differential_adjoint",
    "order": "measured_order",
}


def __getattr__(name: str) -> Any:
    """Objects by their former names."""
    return former(__name__, FORMER, name)


def __dir__() -> list[str]:
    """The public names."""
    return sorted(__all__)
