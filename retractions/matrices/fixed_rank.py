"""Retractions of the manifold of matrices of one rank [Absil, Oseledets 2015]."""

from typing import final

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ...manifolds import FixedRank
from ...manifolds.manifold import default_tolerance
from ..retraction import Retraction, nan_unless


@final
class FixedRankProjection(Retraction):
    """``R(x, v)`` = nearest matrix of rank ``r`` to ``x + v``: its truncated singular value decomposition. Second order.

    Inverse ``v = P_x(y - x + n)`` with the normal vector ``n`` at ``y`` that makes ``y - x + n`` tangent at ``x``, a linear
    equation; its image is where ``n`` is shorter (largest singular value) than the smallest singular value of ``y``.
    """

    manifold: FixedRank

    def __call__(self, x: Array, v: Array) -> Array:
        return self.manifold.restore(x + v)

    def preimage(self, x: Array, y: Array) -> Array:
        (c, d), (c_there, d_there) = self.manifold.projectors(x), self.manifold.projectors(y)
        chord = y - x
        outside = chord - self.manifold.projection(x, chord)
        # (I - c) n (I - d) = -outside with n = (I - c') n (I - d'), side by side.
        left = jnp.linalg.solve(_carrier(c, c_there), outside)
        n = -jnp.linalg.solve(_carrier(d, d_there), left.T).T
        smallest = jnp.linalg.svd(y, compute_uv=False)[self.manifold.r - 1]
        return nan_unless(jnp.linalg.norm(n, 2) < smallest, self.manifold.projection(x, chord + n))


def _carrier(here: Array, there: Array) -> Array:
    """Linear map that takes the image of the projector ``there`` to that of ``here``, and kernel to kernel."""
    return jnp.eye(here.shape[0], dtype=here.dtype) - here - there + 2 * here @ there


@final
class FixedRankOrthographic(Retraction):
    """``R(x, v)`` = the matrix of rank ``r`` that differs from ``x + v`` by a normal vector at ``x``. Second order.

    With ``u`` and ``w`` any bases of the spans of the columns and rows of ``x``, and ``a = x + v``, it is
    ``a w (u'a w)^-1 u'a``. Inverse: the tangent projection ``P_x(y - x)``; its image, and its domain, are where ``u'y w``,
    respectively ``u'a w``, is invertible.
    """

    manifold: FixedRank

    def __call__(self, x: Array, v: Array) -> Array:
        u, w = self._bases(x)
        a = x + v
        return a @ w @ jnp.linalg.solve(u.T @ a @ w, u.T @ a)

    def preimage(self, x: Array, y: Array) -> Array:
        u, w = self._bases(x)
        singular = jnp.linalg.svd(u.T @ y @ w, compute_uv=False)
        there = singular[-1] > default_tolerance() * jnp.linalg.norm(y, 2)
        return nan_unless(there, self.manifold.projection(x, y - x))

    def _bases(self, x: Array) -> tuple[Array, Array]:
        """Bases of the spans of columns and rows, carried from frozen singular vectors: the spans move with ``x``."""
        left, _, right = jnp.linalg.svd(jax.lax.stop_gradient(x), full_matrices=False)
        columns, rows = self.manifold.projectors(x)
        return columns @ left[:, : self.manifold.r], rows @ right[: self.manifold.r].T
