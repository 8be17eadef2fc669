"""Retractions, discretization maps and their cotangent lifts."""

if __package__ != "retrax.retractions":
    raise ImportError(
        f"import this package as retrax.retractions (pip install .), not as {__package__}: "
        "a second copy of its classes would not match the first"
    )

from .cotangent_lift import BundleRetraction, CotangentLift, cotangent_lift
from .differential import DifferentiatedRetraction, adjoint, differentiated
from .discretization import Adjoint, DiscretizationMap, Euler, Midpoint, Theta
from .families import QR, Cayley, Exponential, Polar, Projection, RetractionFamily, default_retraction
from .groups import SOQR, SOCayley, SOExponential, SOPolar
from .level_set import LevelSetProjection
from .product import ProductRetraction
from .retraction import MidpointRetraction, Retraction
from .vectors import Addition, SphereExponential, SphereProjection

__all__ = [
    "QR",
    "SOQR",
    "Addition",
    "Adjoint",
    "BundleRetraction",
    "Cayley",
    "CotangentLift",
    "DifferentiatedRetraction",
    "DiscretizationMap",
    "Euler",
    "Exponential",
    "LevelSetProjection",
    "Midpoint",
    "MidpointRetraction",
    "Polar",
    "ProductRetraction",
    "Projection",
    "Retraction",
    "RetractionFamily",
    "SOCayley",
    "SOExponential",
    "SOPolar",
    "SphereExponential",
    "SphereProjection",
    "Theta",
    "adjoint",
    "cotangent_lift",
    "default_retraction",
    "differentiated",
]
