"""pymanopt's manifolds as ours."""

from dataclasses import dataclass
from functools import cached_property, singledispatch
from typing import Any, final

import numpy as np
from pymanopt import manifolds as theirs
from pymanopt.manifolds.manifold import Manifold as PymanoptManifold

from ...manifolds import SO, Euclidean, InvalidInputError, Product, Sphere
from ...retractions import QR, Exponential, Polar, ProductRetraction, Projection
from ..conventions import Listed, Reshaped, Same, SkewFactors
from ..counterpart import Counterpart
from ..peers import seeded
from ..wrapped import HostSpace, wrap
from .manifold import RetraxManifold

_RETRACTIONS = {"_retraction_qr": QR, "_retraction_polar": Polar}


@singledispatch
def counterpart(space: Any) -> Counterpart:
    """Our manifold for a pymanopt manifold."""
    raise InvalidInputError(f"from_pymanopt takes a pymanopt manifold, got {space!r}; try pymanopt.manifolds.Sphere(3)")


@counterpart.register
def _(space: PymanoptManifold) -> Counterpart:
    if space.point_layout != 1:
        raise InvalidInputError(
            f"{space} cannot be used: its points are made of {space.num_values} arrays whose tangent vectors are written in "
            "coordinates of their own; this door takes manifolds whose points are one array, and products of them"
        )
    return Counterpart(*wrap(PymanoptHost(space), str(space)), None, Same())


@counterpart.register
def _(space: RetraxManifold) -> Counterpart:
    geometry = space.geometry
    return Counterpart(geometry.manifold, geometry.retraction, geometry.metric, geometry.conventions)


@counterpart.register
def _(space: theirs.Euclidean) -> Counterpart:
    manifold = Euclidean(np.shape(space.zero_vector(None)))
    return Counterpart(manifold, Exponential(manifold), None, Same())


@counterpart.register
def _(space: theirs.Sphere) -> Counterpart:
    manifold = Sphere(int(space.dim))
    return Counterpart(manifold, Projection(manifold), None, Reshaped(manifold.ambient, np.shape(space.zero_vector(None))))


@counterpart.register
def _(space: theirs.SpecialOrthogonalGroup) -> Counterpart:
    manifold = SO(space.zero_vector(None).shape[-1])
    return Counterpart(manifold, _named(space)(manifold), None, SkewFactors())


@counterpart.register
def _(space: theirs.Product) -> Counterpart:
    factors = [counterpart(factor) for factor in space.manifolds]
    manifold = Product(*(factor.manifold for factor in factors))
    retraction = ProductRetraction(*(factor.retraction for factor in factors))
    return Counterpart(manifold, retraction, None, Listed(tuple(factor.conventions for factor in factors)))


def _named(space: Any) -> Any:
    """The family of the retraction that a pymanopt manifold was made with."""
    return _RETRACTIONS[space._retraction.__name__]


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
        return np.shape(self.random_point(0))

    def retract(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.stack([self.space.retraction(xi, vi) for xi, vi in zip(x, v, strict=True)])

    def project(self, x: np.ndarray, a: np.ndarray) -> np.ndarray:
        return np.stack([self.space.projection(xi, ai) for xi, ai in zip(x, a, strict=True)])

    def restore(self, x: np.ndarray) -> np.ndarray:
        return self.retract(x, np.zeros_like(x))

    def contains(self, x: np.ndarray) -> np.ndarray:
        return np.all(np.isfinite(x.reshape(len(x), -1)), axis=1)

    def random_point(self, seed: int) -> np.ndarray:
        with seeded(seed):
            return self.space.random_point()
