"""geomstats' spaces as ours."""

from dataclasses import dataclass
from functools import cached_property, singledispatch
from typing import Any, final

import numpy as np
from geomstats.geometry.euclidean import Euclidean as GeomstatsEuclidean
from geomstats.geometry.grassmannian import Grassmannian
from geomstats.geometry.hyperboloid import Hyperboloid
from geomstats.geometry.hypersphere import _Hypersphere
from geomstats.geometry.manifold import Manifold as GeomstatsManifold
from geomstats.geometry.nfold_manifold import NFoldManifold
from geomstats.geometry.product_manifold import ProductManifold
from geomstats.geometry.spd_matrices import SPDMatrices
from geomstats.geometry.special_euclidean import _SpecialEuclideanMatrices
from geomstats.geometry.special_orthogonal import _SpecialOrthogonalMatrices
from geomstats.geometry.stiefel import Stiefel as GeomstatsStiefel

from ...manifolds import (
    SE,
    SO,
    SPD,
    CanonicalMetric,
    EmbeddedMetric,
    Euclidean,
    Grassmann,
    Hyperbolic,
    InvalidInputError,
    Manifold,
    Metric,
    Power,
    PowerMetric,
    Product,
    ProductMetric,
    ScaledMetric,
    Sphere,
    Stiefel,
)
from ...retractions import PowerRetraction, ProductRetraction, default_retraction
from ..conventions import Conventions, Reshaping, SameConvention, Stack
from ..counterpart import Counterpart
from ..isolated_import import seed_numpy
from ..metrics import natural_metric
from ..wrapped import HostSpace, wrap
from .space import RetraxSpace


def counterpart(space: Any) -> Counterpart:
    """The manifold of retrax for a geomstats space: a native one if the space has its default metric, otherwise
    wrapped.

    Parameters
    ----------
    space : geomstats space
        The space.

    Returns
    -------
    Counterpart
        Manifold, retraction, metric and conventions.
    """
    return _wrap(space) if _has_another_metric(space) else _counterpart(space)


def _has_another_metric(space: Any) -> bool:
    has = hasattr(space, "metric") and not isinstance(space, RetraxSpace) and hasattr(space, "default_metric")
    return has and (
        type(space.metric) is not space.default_metric() or getattr(space.metric, "scales", None) is not None
    )


def _wrap(space: GeomstatsManifold) -> Counterpart:
    manifold, retraction = wrap(GeomstatsHost(space), _name(space))
    return Counterpart(manifold, retraction, natural_metric(manifold), SameConvention())


@singledispatch
def _counterpart(space: Any) -> Counterpart:
    raise InvalidInputError(f"from_geomstats takes a real manifold of geomstats, got {space!r}; try Hypersphere(2)")


@_counterpart.register
def _(space: GeomstatsManifold) -> Counterpart:
    if not hasattr(space, "metric"):
        raise InvalidInputError(
            f"{_name(space)} has no metric, whose exponential map is needed; call equip_with_metric()"
        )
    return _wrap(space)


@_counterpart.register
def _(space: RetraxSpace) -> Counterpart:
    geometry = space.geometry
    return Counterpart(geometry.manifold, geometry.retraction, geometry.metric, geometry.conventions)


@_counterpart.register
def _(space: GeomstatsEuclidean) -> Counterpart:
    return _native(Euclidean(space.shape))


@_counterpart.register
def _(space: _Hypersphere) -> Counterpart:
    if space.intrinsic:
        raise InvalidInputError(f"{_name(space)} is in angles, which are not an embedding; use intrinsic=False")
    return _native(Sphere(space.dim))


@_counterpart.register
def _(space: _SpecialOrthogonalMatrices) -> Counterpart:
    manifold = SO(space.n)
    return _native(manifold, ScaledMetric(EmbeddedMetric(manifold), 0.5))  # theirs is tr(A'B)/2 in the algebra


@_counterpart.register
def _(space: _SpecialEuclideanMatrices) -> Counterpart:
    return _native(SE(space.n))


@_counterpart.register
def _(space: SPDMatrices) -> Counterpart:
    return _native(SPD(space.n))


@_counterpart.register
def _(space: GeomstatsStiefel) -> Counterpart:
    manifold = Stiefel(space.n, space.p)
    return _native(manifold, CanonicalMetric(manifold))


@_counterpart.register
def _(space: Grassmannian) -> Counterpart:
    return _native(Grassmann(space.n, space.p))


@_counterpart.register
def _(space: Hyperboloid) -> Counterpart:
    return _native(Hyperbolic(space.dim))


@_counterpart.register
def _(space: NFoldManifold) -> Counterpart:
    if type(space) is not NFoldManifold:  # landmarks, curves and the polydisk come with metrics of their own
        return _wrap(space)
    base = counterpart(space.base_manifold)
    manifold, k = Power(base.manifold, space.n_copies), space.n_copies
    return Counterpart(
        manifold, PowerRetraction(base.retraction, k), PowerMetric(base.metric, k), Stack(base.conventions)
    )


@_counterpart.register
def _(space: ProductManifold) -> Counterpart:
    factors = [counterpart(factor) for factor in space.factors]
    manifold = Product(*(factor.manifold for factor in factors))
    retraction = ProductRetraction(*(factor.retraction for factor in factors))
    metric = ProductMetric(*(factor.metric for factor in factors))
    return Counterpart(manifold, retraction, metric, Reshaping(manifold.ambient, space.shape))


def conventions_of(manifold: Manifold) -> Conventions:
    """The form of a manifold in geomstats: unchanged if its points are one array, otherwise in one vector.

    Parameters
    ----------
    manifold : Manifold
        The manifold.

    Returns
    -------
    Conventions
        The conventions.
    """
    ambient = manifold.ambient
    return SameConvention() if hasattr(ambient, "shape") else Reshaping(ambient)


def _native(manifold: Manifold, metric: Metric | None = None) -> Counterpart:
    metric = natural_metric(manifold) if metric is None else metric
    return Counterpart(manifold, default_retraction(manifold), metric, SameConvention())


def _name(space: GeomstatsManifold) -> str:
    return f"{type(space).__name__} of shape {space.shape}"


@final
@dataclass(frozen=True)
class GeomstatsHost(HostSpace):
    """A geomstats space that we do not have, with its exponential map."""

    space: Any

    @property
    def dimension(self) -> int:
        return self.space.dim

    @property
    def shape(self) -> tuple[int, ...]:
        return self.space.shape

    def retract(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        return self.space.metric.exp(v, x)

    def project(self, x: np.ndarray, a: np.ndarray) -> np.ndarray:
        return self.space.to_tangent(a, x)

    def restore(self, x: np.ndarray) -> np.ndarray:
        return self.space.projection(x) if self._has_projection else x

    def contains(self, x: np.ndarray) -> np.ndarray:
        return self.space.belongs(x, atol=1e-8)

    def random_point(self, seed: int) -> np.ndarray:
        with seed_numpy(seed):
            return self.space.random_point()

    @cached_property
    def _has_projection(self) -> bool:
        try:
            self.space.projection(self.random_point(0))
        except (NotImplementedError, ValueError):  # rotation vectors have one for matrices
            return False
        return True
