"""A manifold of another library that we do not have, with its own functions behind ours."""

from abc import ABC, abstractmethod
from math import prod
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from ...manifolds import Manifold
from ...manifolds.numerics.precision import default_tolerance, real
from ...retractions import Retraction
from .differences import HOST_NODES, Host, Moved, host_function


class HostSpace(ABC):
    """The functions that a space of another library supplies: functions of NumPy arrays, with batches along the leading
    axis."""

    dimension: int
    shape: tuple[int, ...]

    @abstractmethod
    def retract(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Points reached from ``x`` along tangent vectors ``v``."""

    @abstractmethod
    def project(self, x: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Tangent vectors at ``x`` from ambient vectors."""

    @abstractmethod
    def restore(self, x: np.ndarray) -> np.ndarray:
        """The points of the manifold for points that rounding has taken off it."""

    @abstractmethod
    def contains(self, x: np.ndarray) -> np.ndarray:
        """Whether the library takes ``x`` for points, one truth value each."""

    @abstractmethod
    def random_point(self, seed: int) -> np.ndarray:
        """A random point, without its batch axis."""


@final
class WrappedManifold(Manifold):
    """A space of another library as a manifold: its functions run on the host, derivatives are differences.

    The tangent spaces are the images of its tangent projection, with the orthogonal projection of our own on them.
    """

    host: HostSpace = eqx.field(static=True)

    @property
    def dimension(self) -> int:
        return self.host.dimension

    @property
    def ambient(self) -> jax.ShapeDtypeStruct:
        return real(self.host.shape)

    def projector(self, x: Array) -> Array:
        """Matrix of the orthogonal projection on the tangent space at ``x``, shape ``(N, N)``."""
        size = prod(self.host.shape)
        values, moved = projectors_of(self.host), moved_points(self.host)
        return host_function(values, moved, (size, size))(jnp.ravel(x))

    def projection(self, x: Array, a: Array) -> Array:
        return (self.projector(x) @ jnp.ravel(a)).reshape(self.host.shape)

    def basis(self, x: Array) -> Array:
        vectors = jnp.linalg.eigh(jax.lax.stop_gradient(self.projector(x)))[1]
        return vectors.T[-self.dimension :].reshape(-1, *self.host.shape)

    def restore(self, x: Array) -> Array:
        # On the manifold the derivative is the identity of its tangent spaces.
        return x + jax.lax.stop_gradient(self._on_host(self.host.restore, x) - x)

    def violations(self, x: Array) -> dict[str, Array]:
        moved = jnp.max(jnp.abs(self.restore(x) - x))
        outside = self._on_host(lambda points: np.where(self.host.contains(points), 0.0, 1.0), x, ())
        return {"distance to the library's own point": moved, "points that the library takes for none": outside}

    def random_point(self, key: Array) -> Array:
        seed = jax.random.randint(key, (), 0, 2**31 - 1)
        out = self.ambient
        return jax.pure_callback(
            lambda s: np.asarray(self.host.random_point(int(s)), out.dtype), out, seed, vmap_method="sequential"
        )

    def _on_host(self, function: Host, x: Array, shape: tuple[int, ...] | None = None) -> Array:
        """A function of a batch of points, without a derivative."""
        inner, outer = self.host.shape, self.host.shape if shape is None else shape

        def call(points: Array) -> np.ndarray:
            batch = np.shape(points)[: np.ndim(points) - len(inner)]
            values = function(np.asarray(points, np.float64).reshape(-1, *inner))
            return np.asarray(values, np.asarray(points).dtype).reshape((*batch, *outer))

        out = jax.ShapeDtypeStruct(outer, x.dtype)
        return jax.pure_callback(call, out, jax.lax.stop_gradient(x), vmap_method="broadcast_all")


@final
class WrappedRetraction(Retraction):
    """The retraction, or the exponential map, of a space of another library."""

    manifold: WrappedManifold

    def retract(self, x: Array, v: Array) -> Array:
        host = self.manifold.host
        values, moved = _retractions(host), _moved_tangents(host)
        point = jnp.concatenate([jnp.ravel(x), jnp.ravel(v)])
        return host_function(values, moved, host.shape)(point)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        """Where the inverse comes back, and the library takes the value for a point: far out it may be rounded to the
        edge."""
        violations = jnp.stack(list(self.manifold.violations(self(x, v)).values()))
        return super().domain(x, v) & (jnp.max(violations) <= default_tolerance())


def projectors_of(host: HostSpace) -> Host:
    """Orthogonal projectors on the images of the library's tangent projections."""
    size = prod(host.shape)

    def values(x: np.ndarray) -> np.ndarray:
        points = np.repeat(x.reshape(-1, *host.shape), size, axis=0)
        units = np.tile(np.eye(size), (len(x), 1)).reshape(-1, *host.shape)
        images = host.project(points, units).reshape(-1, size, size)
        known = np.all(np.isfinite(images), (1, 2), keepdims=True)
        frames = np.linalg.svd(np.where(known, images, 0.0))[2][:, : host.dimension]
        return np.where(known, np.swapaxes(frames, 1, 2) @ frames, np.nan)

    return values


def _retractions(host: HostSpace) -> Host:
    def values(z: np.ndarray) -> np.ndarray:
        x, v = _split(host, z)
        return host.retract(x, _tangential(host, x, v))

    return values


def moved_points(host: HostSpace) -> Moved:
    """Points on the curves ``s -> R(x, s P_x e_i)`` for the coordinate vectors ``e_i``."""
    size = prod(host.shape)

    def move(x: np.ndarray, step: float) -> np.ndarray:
        directions = np.swapaxes(projectors_of(host)(x), 1, 2)[:, :, None] * (step * HOST_NODES)[:, None]
        starts = np.broadcast_to(x[:, None, None], directions.shape)
        there = host.retract(starts.reshape(-1, *host.shape), directions.reshape(-1, *host.shape))
        return there.reshape(len(x), size, len(HOST_NODES), size)

    return move


def _moved_tangents(host: HostSpace) -> Moved:
    """Tangent vectors on curves along each coordinate of the base point, then of the fibre."""
    size = prod(host.shape)

    def move(z: np.ndarray, step: float) -> np.ndarray:
        x, v = z[:, :size], z[:, size:]
        steps = step * HOST_NODES[:, None] * np.eye(size)[:, None]
        base = moved_points(host)(x, step)
        same, other = (np.broadcast_to(part[:, None, None], base.shape) for part in (x, v))
        along_base, along_fibre = np.concatenate([base, other], -1), np.concatenate([same, other + steps], -1)
        return np.concatenate([along_base, along_fibre], 1)

    return move


def _split(host: HostSpace, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, v = np.split(z, 2, axis=-1)
    return x.reshape(-1, *host.shape), v.reshape(-1, *host.shape)


def _tangential(host: HostSpace, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    flat = v.reshape(len(v), -1)
    return np.einsum("bij,bj->bi", projectors_of(host)(x.reshape(len(x), -1)), flat).reshape(v.shape)
