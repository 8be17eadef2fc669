"""Manifolds embedded in a vector space of arrays."""

if __package__ != "retrax.manifolds":
    raise ImportError(
        f"import this package as retrax.manifolds (pip install .), not as {__package__}: "
        "a second copy of its classes would not match the first"
    )

from .bundles import CotangentBundle, TangentBundle
from .groups import SO, hat, vee
from .level_set import LevelSet
from .manifold import HomogeneousSpace, Manifold, Verdict
from .metric import EmbeddedMetric, Metric
from .numerics.errors import (
    ConvergenceError,
    DomainError,
    InvalidInputError,
    NotOnManifoldError,
    RetraxError,
    UnknownRetractionError,
)
from .product import Product
from .vectors import Euclidean, Sphere

__all__ = [
    "SO",
    "ConvergenceError",
    "CotangentBundle",
    "DomainError",
    "EmbeddedMetric",
    "Euclidean",
    "HomogeneousSpace",
    "InvalidInputError",
    "LevelSet",
    "Manifold",
    "Metric",
    "NotOnManifoldError",
    "Product",
    "RetraxError",
    "Sphere",
    "TangentBundle",
    "UnknownRetractionError",
    "Verdict",
    "hat",
    "vee",
]
