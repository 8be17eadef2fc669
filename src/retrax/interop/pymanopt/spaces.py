"""pymanopt's manifolds as ours."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, singledispatch
from typing import Any, final

import numpy as np
from pymanopt import manifolds as theirs
from pymanopt.manifolds.manifold import Manifold as PymanoptManifold

from ...manifolds import (
    SO,
    SPD,
    Euclidean,
    FixedRank,
    Grassmann,
    InvalidInputError,
    Manifold,
    Oblique,
    Power,
    Product,
    ProductMetric,
    ScaledMetric,
    Sphere,
    Stiefel,
    U,
)
from ...retractions import (
    QR,
    Exponential,
    Polar,
    PowerRetraction,
    ProductRetraction,
    Projection,
    Retraction,
    SPDSecondOrder,
)
from ..conventions import Conventions, PartList, Representatives, Reshaping, SameConvention, SkewFactors, Stack
from ..counterpart import Counterpart
from ..isolated_import import seed_numpy
from ..metrics import natural_metric
from ..wrapped import HostSpace, wrap
from .conventions import Factors
from .manifold import RetraxManifold

_RETRACTIONS = {"_retraction_qr": QR, "_retraction_polar": Polar}


@singledispatch
def counterpart(space: Any) -> Counterpart:
    """The manifold of retrax for a pymanopt manifold.

    Parameters
    ----------
    space : pymanopt manifold
        The manifold.

    Returns
    -------
    Counterpart
        Manifold, retraction, metric and conventions.
    """
    raise InvalidInputError(f"from_pymanopt takes a pymanopt manifold, got {space!r}; try pymanopt.manifolds.Sphere(3)")


@counterpart.register
def _(space: PymanoptManifold) -> Counterpart:
    if space.point_layout != 1:
        raise InvalidInputError(
            f"{space} cannot be used: its points are made of {space.num_values} arrays whose tangent vectors are "
            "written in coordinates of their own; this door takes manifolds whose points are one array, and products "
            "of them"
        )
    manifold, retraction = wrap(PymanoptHost(space), str(space))
    return _with_natural_metric(manifold, retraction, SameConvention())


@counterpart.register
def _(space: RetraxManifold) -> Counterpart:
    geometry = space.geometry
    return Counterpart(geometry.manifold, geometry.retraction, geometry.metric, geometry.conventions)


@counterpart.register
def _(space: theirs.Euclidean) -> Counterpart:
    manifold = Euclidean(_shape(space))
    return _with_natural_metric(manifold, Exponential(manifold), SameConvention())


@counterpart.register
def _(space: theirs.Sphere) -> Counterpart:
    manifold = Sphere(int(space.dim))
    return _with_natural_metric(manifold, Projection(manifold), Reshaping(manifold.ambient, _shape(space)))


@counterpart.register
def _(space: theirs.SpecialOrthogonalGroup) -> Counterpart:
    return _copies(space, lambda n, _: SO(n), _family_of(space), SkewFactors())


@counterpart.register
def _(space: theirs.UnitaryGroup) -> Counterpart:
    return _copies(space, lambda n, _: U(n), _family_of(space), SkewFactors())


@counterpart.register
def _(space: theirs.FixedRankEmbedded) -> Counterpart:
    u, s, vt = _random_point(space)
    manifold = FixedRank(len(u), vt.shape[1], len(s))
    return _with_natural_metric(manifold, Projection(manifold), Factors(len(s)))


@counterpart.register
def _(space: theirs.SymmetricPositiveDefinite) -> Counterpart:
    return _copies(space, lambda n, _: SPD(n), SPDSecondOrder, SameConvention())


@counterpart.register
def _(space: theirs.Stiefel) -> Counterpart:
    return _copies(space, Stiefel, _family_of(space), SameConvention())


@counterpart.register
def _(space: theirs.Oblique) -> Counterpart:
    return _copies(space, Oblique, Projection, SameConvention())


@counterpart.register
def _(space: theirs.Grassmann) -> Counterpart:
    p = _shape(space)[-1]
    manifold, retraction, metric, conventions = _copies(space, Grassmann, Polar, Representatives(p))
    return Counterpart(manifold, retraction, ScaledMetric(metric, 0.5), conventions)  # |v x' + x v'|^2 = 2 |v|^2


@counterpart.register
def _(space: theirs.Product) -> Counterpart:
    manifolds, retractions, metrics, conventions = zip(*map(counterpart, space.manifolds), strict=True)
    return Counterpart(
        Product(*manifolds), ProductRetraction(*retractions), ProductMetric(*metrics), PartList(conventions)
    )


def _copies(
    space: Any, make: Callable[..., Manifold], family: Callable[..., Retraction], conventions: Conventions
) -> Counterpart:
    """The counterpart of a manifold of matrices, or of the power that pymanopt makes of it with ``k > 1``."""
    *copies, rows, columns = _shape(space)
    manifold = make(rows, columns)
    if not copies:
        return _with_natural_metric(manifold, family(manifold), conventions)
    power = Power(manifold, copies[0])
    return _with_natural_metric(power, PowerRetraction(family(manifold), copies[0]), Stack(conventions))


def _with_natural_metric(manifold: Manifold, retraction: Retraction, conventions: Conventions) -> Counterpart:
    return Counterpart(manifold, retraction, natural_metric(manifold), conventions)


def _family_of(space: Any) -> Any:
    """The family of the retraction that a pymanopt manifold was made with."""
    return _RETRACTIONS[space._retraction.__name__]


def _shape(space: Any) -> tuple[int, ...]:
    return np.shape(_random_point(space))


def _random_point(space: Any) -> Any:
    with seed_numpy(0):
        return space.random_point()


@final
@dataclass(frozen=True)
class PymanoptHost(HostSpace):
    """A pymanopt manifold that we do not have: one point at a time."""

    space: Any

    @property
    def dimension(self) -> int:
        return int(self.space.dim)

    @cached_property
    def shape(self) -> tuple[int, ...]:
        return _shape(self.space)

    def retract(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.stack([self.space.retraction(xi, vi) for xi, vi in zip(x, v, strict=True)])

    def project(self, x: np.ndarray, a: np.ndarray) -> np.ndarray:
        return np.stack([self.space.projection(xi, ai) for xi, ai in zip(x, a, strict=True)])

    def restore(self, x: np.ndarray) -> np.ndarray:
        return self.retract(x, np.zeros_like(x))

    def contains(self, x: np.ndarray) -> np.ndarray:
        return np.all(np.isfinite(x.reshape(len(x), -1)), axis=1)

    def random_point(self, seed: int) -> np.ndarray:
        with seed_numpy(seed):
            return self.space.random_point()
