"""Our manifolds as geomstats spaces with a metric."""

from functools import lru_cache
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from geomstats.geometry.manifold import Manifold as GeomstatsManifold
from geomstats.geometry.riemannian_metric import RiemannianMetric

from ..geometry import Geometry

ATOL = 1e-12  # the default of geomstats
_VALUES = {"inner_product", "dist", "violation", "normal_part"}  # methods whose values are numbers


@final
class RetraxSpace(GeomstatsManifold):
    """A manifold of retrax with its metric, for the learning algorithms of geomstats.

    Parameters
    ----------
    geometry : Geometry
        The manifold with its conventions.
    equip : bool
        Whether the space has its metric.

    Notes
    -----
    Points are arrays, or the entries of all arrays of a point in one vector. Leading axes are batches. Random points
    draw their keys from the global state of NumPy, as geomstats does.
    """

    def __init__(self, geometry: Geometry, equip: bool = True) -> None:
        self.geometry = geometry
        shape = jax.eval_shape(geometry.conventions.lift, geometry.manifold.ambient).shape
        super().__init__(geometry.manifold.dimension, shape, intrinsic=False, equip=equip)

    def new(self, equip: bool = True) -> "RetraxSpace":
        """A copy of the space, with or without its metric.

        Parameters
        ----------
        equip : bool
            Whether the space has its metric.
        """
        return RetraxSpace(self.geometry, equip)

    @staticmethod
    def default_metric() -> type["RetraxMetric"]:
        """The metric class of the space."""
        return RetraxMetric

    def belongs(self, point: np.ndarray, atol: float = ATOL) -> Any:
        """Whether every equation of the manifold holds.

        Parameters
        ----------
        point : array
            Points.
        atol : float
            The largest violation.
        """
        batch = np.shape(point)[: np.ndim(point) - self.point_ndim]
        if np.shape(point)[len(batch) :] != self.shape:
            return np.zeros(batch, bool)
        return self.host("violation", point) <= atol

    def is_tangent(self, vector: np.ndarray, base_point: np.ndarray | None = None, atol: float = ATOL) -> Any:
        """Whether vectors are tangent.

        Parameters
        ----------
        vector : array
            Vectors.
        base_point : array, optional
            The base point.
        atol : float
            The largest normal part.
        """
        return self.host("normal_part", _require_point(base_point), vector) <= atol

    def to_tangent(self, vector: np.ndarray, base_point: np.ndarray | None = None) -> Any:
        """The tangent projection.

        Parameters
        ----------
        vector : array
            Vectors.
        base_point : array, optional
            The base point.
        """
        return self.host("project", _require_point(base_point), vector)

    def random_point(self, n_samples: int = 1, bound: float = 1.0) -> Any:
        """Random points.

        Parameters
        ----------
        n_samples : int
            Their number.
        bound : float
            As in geomstats; it has no effect.
        """
        seeds = np.random.randint(2**31, size=n_samples)  # noqa: NPY002
        drawn = np.array(_draw(self.geometry, jnp.asarray(seeds)))
        return drawn if n_samples > 1 else drawn[0]

    def projection(self, point: np.ndarray) -> np.ndarray:
        """The points of the manifold near given points, by Newton's method.

        Parameters
        ----------
        point : array
            Points near the manifold.
        """
        return self.host("restore", point)

    def host(self, method: str, *arguments: np.ndarray) -> np.ndarray:
        """The compiled method of the geometry on NumPy arrays with broadcast leading axes.

        Parameters
        ----------
        method : str
            The name of a method of ``Geometry``.
        *arguments : array
            Its arguments.
        """
        core = "(" + ",".join(f"d{i}" for i in range(self.point_ndim)) + ")"
        out = "()" if method in _VALUES else core
        signature = ",".join([core] * len(arguments)) + "->" + out
        values = np.array(_kernel(method, signature)(self.geometry, *map(jnp.asarray, arguments)))
        points = (x for a in arguments[:2] for x in np.reshape(a, (-1, *self.shape)))
        self.geometry.require_values(method, values, points)
        return values


@final
class RetraxMetric(RiemannianMetric):
    """The metric of a manifold of retrax, with its exponential map and the retraction of the space.

    Parameters
    ----------
    space : RetraxSpace
        The space.
    signature : tuple of int, optional
        As in geomstats.
    """

    def inner_product(
        self, tangent_vec_a: np.ndarray, tangent_vec_b: np.ndarray, base_point: np.ndarray | None = None
    ) -> np.ndarray:
        """The inner product of tangent vectors.

        Parameters
        ----------
        tangent_vec_a, tangent_vec_b : array
            Tangent vectors at the base point.
        base_point : array, optional
            The base point.
        """
        return self._space.host("inner_product", _require_point(base_point), tangent_vec_a, tangent_vec_b)

    def exp(self, tangent_vec: np.ndarray, base_point: np.ndarray) -> np.ndarray:
        """The exponential map.

        Parameters
        ----------
        tangent_vec : array
            A tangent vector at the base point.
        base_point : array
            The base point.
        """
        return self._space.host("exp", base_point, tangent_vec)

    def log(self, point: np.ndarray, base_point: np.ndarray) -> np.ndarray:
        """The logarithm: the tangent vector at the base point whose geodesic reaches ``point``.

        Parameters
        ----------
        point, base_point : array
            Two points.
        """
        return self._space.host("log", base_point, point)

    def squared_dist(self, point_a: np.ndarray, point_b: np.ndarray) -> np.ndarray:
        """The squared geodesic distance.

        Parameters
        ----------
        point_a, point_b : array
            Two points.
        """
        if not self._space.geometry.is_symmetric:  # the length of the logarithm: nothing more to compile
            return super().squared_dist(point_a, point_b)
        return self._space.host("dist", point_a, point_b) ** 2

    def retraction(self, tangent_vec: np.ndarray, base_point: np.ndarray) -> np.ndarray:
        """The retraction of the space.

        Parameters
        ----------
        tangent_vec : array
            A tangent vector at the base point.
        base_point : array
            The base point.
        """
        return self._space.host("move", base_point, tangent_vec)

    def lifting(self, point: np.ndarray, base_point: np.ndarray) -> np.ndarray:
        """The inverse of the retraction of the space.

        Parameters
        ----------
        point, base_point : array
            Two points.
        """
        return self._space.host("back", base_point, point)

    def parallel_transport(
        self,
        tangent_vec: np.ndarray,
        base_point: np.ndarray,
        direction: np.ndarray | None = None,
        end_point: np.ndarray | None = None,
    ) -> np.ndarray:
        """The parallel transport along the geodesic to ``end_point``, or in ``direction``, on symmetric spaces.

        Parameters
        ----------
        tangent_vec : array
            A tangent vector at the base point.
        base_point : array
            The base point.
        direction : array, optional
            The initial velocity of the geodesic.
        end_point : array, optional
            The end of the geodesic.
        """
        if not self._space.geometry.is_symmetric:
            raise NotImplementedError(
                f"parallel transport is known on symmetric spaces, not on {self._space.geometry.manifold}"
            )
        if end_point is None:
            end_point = self.exp(_require_point(direction), base_point)
        return self._space.host("transport", base_point, end_point, tangent_vec)


def _require_point(array: np.ndarray | None) -> np.ndarray:
    if array is None:
        raise ValueError("base_point (for a transport: end_point or direction) is missing: these spaces need it")
    return array


@lru_cache
def _kernel(method: str, signature: str) -> Any:
    def apply(geometry: Geometry, *arguments: jax.Array) -> jax.Array:
        return jnp.vectorize(getattr(geometry, method), signature=signature)(*arguments)

    return eqx.filter_jit(apply)


@eqx.filter_jit
def _draw(geometry: Geometry, seeds: jax.Array) -> jax.Array:
    return jax.vmap(lambda seed: geometry.random_point(jax.random.key(seed)))(seeds)
