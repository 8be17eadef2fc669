"""Retractions, discretization maps and their cotangent lifts."""

if __package__ != "retrax.retractions":
    raise ImportError(
        f"import this package as retrax.retractions (pip install .), not as {__package__}: "
        "a second copy of its classes would not match the first"
    )

from . import constructions, groups, matrices, vectors
from .constructions import *
from .cotangent_lift import BundleRetraction, CotangentLift, cotangent_lift
from .differential import DifferentiatedRetraction, differentiated, fibre_adjoint
from .discretization import Adjoint, DiscretizationMap, Euler, Midpoint, Theta
from .families import QR, Cayley, Exponential, Polar, Projection, RetractionFamily, default_retraction
from .gauss import Gauss
from .groups import *
from .level_set import LevelSetProjection
from .matrices import *
from .measured_order import MeasuredOrder, order
from .restored import Restored
from .retraction import MidpointRetraction, Retraction
from .submanifold import Orthographic
from .vectors import *

__all__ = [
    "QR",
    "Adjoint",
    "BundleRetraction",
    "Cayley",
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
    "Restored",
    "Retraction",
    "RetractionFamily",
    "Theta",
    "cotangent_lift",
    "default_retraction",
    "differentiated",
    "fibre_adjoint",
    "order",
]
__all__ += constructions.__all__
__all__ += groups.__all__
__all__ += matrices.__all__
__all__ += vectors.__all__
