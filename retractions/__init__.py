"""Retractions, discretization maps and their cotangent lifts."""

if __package__ != "retrax.retractions":
    raise ImportError(
        f"import this package as retrax.retractions (pip install .), not as {__package__}: "
        "a second copy of its classes would not match the first"
    )

from .constructions import PowerRetraction, ProductRetraction, SecondOrder, Stabilized, acceleration
from .cotangent_lift import BundleRetraction, CotangentLift, cotangent_lift
from .differential import DifferentiatedRetraction, differentiated, fibre_adjoint
from .discretization import Adjoint, DiscretizationMap, Euler, Midpoint, Theta
from .families import QR, Cayley, Exponential, Polar, Projection, RetractionFamily, default_retraction
from .gauss import Gauss
from .groups import (
    SOQR,
    UQR,
    FrobeniusExponential,
    GroupCayley,
    GroupExponential,
    GroupRetraction,
    SEDecoupled,
    SOCayley,
    SOPolar,
    SymmetricGroupRetraction,
    Translated,
    UPolar,
)
from .level_set import LevelSetProjection
from .matrices import (
    Columnwise,
    FixedRankOrthographic,
    FixedRankProjection,
    GrassmannCayley,
    GrassmannExponential,
    GrassmannPolar,
    SPDExponential,
    SPDLogEuclidean,
    SPDSecondOrder,
    StiefelCanonicalExponential,
    StiefelCayley,
    StiefelExponential,
    StiefelPolar,
    StiefelQR,
)
from .measured_order import MeasuredOrder, order
from .restored import Restored
from .retraction import MidpointRetraction, Retraction
from .submanifold import Orthographic
from .vectors import (
    Addition,
    HyperbolicExponential,
    HyperbolicProjection,
    SimplexExponential,
    SphereExponential,
    SphereProjection,
)

__all__ = [
    "QR",
    "SOQR",
    "UQR",
    "Addition",
    "Adjoint",
    "BundleRetraction",
    "Cayley",
    "Columnwise",
    "CotangentLift",
    "DifferentiatedRetraction",
    "DiscretizationMap",
    "Euler",
    "Exponential",
    "FixedRankOrthographic",
    "FixedRankProjection",
    "FrobeniusExponential",
    "Gauss",
    "GrassmannCayley",
    "GrassmannExponential",
    "GrassmannPolar",
    "GroupCayley",
    "GroupExponential",
    "GroupRetraction",
    "HyperbolicExponential",
    "HyperbolicProjection",
    "LevelSetProjection",
    "MeasuredOrder",
    "Midpoint",
    "MidpointRetraction",
    "Orthographic",
    "Polar",
    "PowerRetraction",
    "ProductRetraction",
    "Projection",
    "Restored",
    "Retraction",
    "RetractionFamily",
    "SEDecoupled",
    "SOCayley",
    "SOPolar",
    "SPDExponential",
    "SPDLogEuclidean",
    "SPDSecondOrder",
    "SecondOrder",
    "SimplexExponential",
    "SphereExponential",
    "SphereProjection",
    "Stabilized",
    "StiefelCanonicalExponential",
    "StiefelCayley",
    "StiefelExponential",
    "StiefelPolar",
    "StiefelQR",
    "SymmetricGroupRetraction",
    "Theta",
    "Translated",
    "UPolar",
    "acceleration",
    "cotangent_lift",
    "default_retraction",
    "differentiated",
    "fibre_adjoint",
    "order",
]
