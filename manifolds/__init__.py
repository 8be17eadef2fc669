"""Manifolds embedded in a vector space of arrays."""

if __package__ != "retrax.manifolds":
    raise ImportError(
        f"import this package as retrax.manifolds (pip install .), not as {__package__}: "
        "a second copy of its classes would not match the first"
    )

from .bundles import CotangentBundle, TangentBundle
from .combined_metrics import PowerMetric, ProductMetric, ScaledMetric
from .groups import SE, SL, SO, SU, LeftInvariantMetric, MatrixLieGroup, U, hat, vee
from .level_set import LevelSet
from .manifold import HomogeneousSpace, Manifold, Verdict
from .matrices import SPD, AffineInvariantMetric, CanonicalMetric, FixedRank, Grassmann, Oblique, Stiefel
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
from .vectors import Euclidean, Hyperbolic, LorentzMetric, Simplex, Sphere

__all__ = [
    "SE",
    "SL",
    "SO",
    "SPD",
    "SU",
    "AffineInvariantMetric",
    "CanonicalMetric",
    "ConvergenceError",
    "CotangentBundle",
    "DomainError",
    "EmbeddedMetric",
    "Euclidean",
    "FixedRank",
    "Grassmann",
    "HomogeneousSpace",
    "Hyperbolic",
    "Immersion",
    "InvalidInputError",
    "LagrangianVerdict",
    "LeftInvariantMetric",
    "LevelSet",
    "LorentzMetric",
    "Manifold",
    "MatrixLieGroup",
    "Metric",
    "NotOnManifoldError",
    "Oblique",
    "Power",
    "PowerMetric",
    "PresymplecticManifold",
    "Product",
    "ProductMetric",
    "RetraxError",
    "ScaledMetric",
    "Simplex",
    "Sphere",
    "Stiefel",
    "Submanifold",
    "TangentBundle",
    "TulczyjewTriple",
    "U",
    "UnknownRetractionError",
    "Verdict",
    "form_matrix",
    "hat",
    "is_lagrangian",
    "pullback_form",
    "tangent_lift",
    "vee",
]
