"""Our manifolds as pymanopt's."""

from functools import lru_cache
from typing import Any, final

import equinox as eqx
import jax
import numpy as np
from pymanopt.manifolds.manifold import Manifold as PymanoptManifold
from pymanopt.tools import ndarraySequenceMixin

from ..conventions import Theirs
from ..geometry import Geometry


class TangentList(ndarraySequenceMixin, list):
    """A tangent vector of several arrays, with the arithmetic of a vector space."""

    def __add__(self, other: list) -> "TangentList":
        return TangentList(a + b for a, b in zip(self, other, strict=True))

    def __sub__(self, other: list) -> "TangentList":
        return TangentList(a - b for a, b in zip(self, other, strict=True))

    def __mul__(self, factor: Any) -> Any:
        return TangentList(factor * a for a in self)

    def __rmul__(self, factor: Any) -> Any:
        return self * factor

    def __truediv__(self, divisor: float) -> "TangentList":
        return TangentList(a / divisor for a in self)

    def __neg__(self) -> "TangentList":
        return TangentList(-a for a in self)


@final
class RetraxManifold(PymanoptManifold):
    """A manifold of retrax with a retraction and a metric, for the optimizers of pymanopt.

    Parameters
    ----------
    geometry : Geometry
        The manifold with its conventions.
    typical_dist : float
        The scale, from ``typical_distance``.

    Notes
    -----
    Points, tangent vectors and methods follow pymanopt. Random points draw their keys from the global state of
    NumPy, as pymanopt does.
    """

    def __init__(self, geometry: Geometry, typical_dist: float) -> None:
        point = jax.eval_shape(geometry.conventions.lift, geometry.manifold.ambient)
        layout = tuple(map(_layout, point)) if isinstance(point, list) else _layout(point)
        super().__init__(str(geometry.manifold), geometry.manifold.dimension, layout)
        self.geometry, self._typical_dist = geometry, typical_dist

    @property
    def typical_dist(self) -> float:
        return self._typical_dist

    def inner_product(self, point: Theirs, tangent_vector_a: Theirs, tangent_vector_b: Theirs) -> float:
        return float(self._host("inner_product", point, tangent_vector_a, tangent_vector_b))

    def norm(self, point: Theirs, tangent_vector: Theirs) -> Any:
        return float(np.sqrt(self.inner_product(point, tangent_vector, tangent_vector)))

    def projection(self, point: Theirs, vector: Theirs) -> Theirs:
        return self._tangent("project", point, vector)

    def to_tangent_space(self, point: Theirs, vector: Theirs) -> Theirs:
        return self._tangent("tangential", point, vector)

    def embedding(self, point: Theirs, tangent_vector: Theirs) -> Theirs:
        return self._tangent("embed", point, tangent_vector)

    def euclidean_to_riemannian_gradient(self, point: Theirs, euclidean_gradient: Theirs) -> Theirs:
        return self._tangent("gradient", point, _like(point, euclidean_gradient))

    def euclidean_to_riemannian_hessian(
        self, point: Theirs, euclidean_gradient: Theirs, euclidean_hessian: Theirs, tangent_vector: Theirs
    ) -> Theirs:
        slopes = _like(point, euclidean_gradient), _like(point, euclidean_hessian)
        return self._tangent("hessian", point, *slopes, tangent_vector)

    def retraction(self, point: Theirs, tangent_vector: Theirs) -> Theirs:
        return self._host("move", point, tangent_vector)

    def exp(self, point: Theirs, tangent_vector: Theirs) -> Theirs:
        return self._host("exp", point, tangent_vector)

    def log(self, point_a: Theirs, point_b: Theirs) -> Theirs:
        return self._tangent("log", point_a, point_b)

    def dist(self, point_a: Theirs, point_b: Theirs) -> Any:
        return float(self._host("dist", point_a, point_b))

    def pair_mean(self, point_a: Theirs, point_b: Theirs) -> Theirs:
        return self._host("middle", point_a, point_b)

    def transport(self, point_a: Theirs, point_b: Theirs, tangent_vector_a: Theirs) -> Theirs:
        return self._tangent("carry", point_a, point_b, tangent_vector_a)

    def zero_vector(self, point: Theirs) -> Theirs:
        return self._tangent("zero", point)

    def random_point(self) -> Theirs:
        return self._host("random_point", _key())

    def random_tangent_vector(self, point: Theirs) -> Theirs:
        return self._tangent("random_tangent", _key(), point)

    def _tangent(self, method: str, *arguments: Theirs) -> Theirs:
        return _as_tangent(self._host(method, *arguments))

    def _host(self, method: str, *arguments: Theirs) -> Theirs:
        """A method of the geometry, compiled, on NumPy arrays."""
        values = jax.tree.map(np.array, _kernel(method)(self.geometry, *map(_plain, arguments)))
        self.geometry.require_values(method, values, arguments[:2])
        return values


@lru_cache
def _kernel(method: str) -> Any:
    return eqx.filter_jit(lambda geometry, *arguments: getattr(geometry, method)(*arguments))


def _plain(a: Any) -> Any:
    """Lists of pymanopt's as lists that JAX knows as pytrees."""
    return list(a) if isinstance(a, list) else a


def _layout(point: Any) -> int:
    """How many arrays a point is made of."""
    return len(jax.tree.leaves(point))


def _like(point: Any, a: Any) -> Any:
    """The arrays of ``a`` in the containers of a point."""
    return jax.tree.unflatten(jax.tree.structure(_plain(point)), jax.tree.leaves(_plain(a)))


def _as_tangent(a: Any) -> Any:
    return TangentList(a) if isinstance(a, list) else a


def _key() -> jax.Array:
    return jax.random.key(np.random.randint(2**31))  # noqa: NPY002
