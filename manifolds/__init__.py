"""Manifolds embedded in a vector space of arrays."""

if __package__ != "retrax.manifolds":
    raise ImportError(
        f"import this package as retrax.manifolds (pip install .), not as {__package__}: "
        "a second copy of its classes would not match the first"
    )

from ..errors import InvalidCallError, NotDifferentiableError
from . import groups, matrices, vectors
from .bundles import CotangentBundle, TangentBundle
from .combined_metrics import PowerMetric, ProductMetric, ScaledMetric
from .groups import *
from .level_set import LevelSet
from .manifold import HomogeneousSpace, Manifold
from .matrices import *
from .metric import EmbeddedMetric, Metric
from .numerics.errors import (
    ConvergenceError,
    DomainError,
    InvalidInputError,
    NotOnManifoldError,
    RetraxError,
    UnknownRetractionError,
)
from .power import Power
from .product import Product
from .submanifold import Submanifold
from .symplectic import (
    Immersion,
    LagrangianVerdict,
    PresymplecticManifold,
    TulczyjewTriple,
    form_matrix,
    is_lagrangian,
    pullback_form,
    tangent_lift,
)
from .vectors import *
from .verdict import Verdict

__all__ = [
    "ConvergenceError",
    "CotangentBundle",
    "DomainError",
    "EmbeddedMetric",
    "HomogeneousSpace",
    "Immersion",
    "InvalidCallError",
    "InvalidInputError",
    "LagrangianVerdict",
    "LevelSet",
    "Manifold",
    "Metric",
    "NotDifferentiableError",
    "NotOnManifoldError",
    "Power",
    "PowerMetric",
    "PresymplecticManifold",
    "Product",
    "ProductMetric",
    "RetraxError",
    "ScaledMetric",
    "Submanifold",
    "TangentBundle",
    "TulczyjewTriple",
    "UnknownRetractionError",
    "Verdict",
    "form_matrix",
    "is_lagrangian",
    "pullback_form",
    "tangent_lift",
]
__all__ += groups.__all__
__all__ += matrices.__all__
__all__ += vectors.__all__


def __dir__() -> list[str]:
    """The public names."""
    return sorted(__all__)
