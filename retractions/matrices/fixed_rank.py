"""Retractions of the manifold of matrices of one rank [Absil, Oseledets 2015], with inverses derived here."""

from typing import final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds import FixedRank
from ...manifolds.numerics.precision import default_tolerance
from ..retraction import Retraction, comes_back, nan_unless
from ..rounding import SINGULAR_DISTANCE


@final
class FixedRankProjection(Retraction):
    """The projection of ``x + v`` on matrices of rank ``r``: its truncated singular value decomposition. Second
    order.

    Parameters
    ----------
    manifold : FixedRank
        The manifold.

    Notes
    -----
    Inverse: :math:`v = P_x(y - x + n)` with the normal vector ``n`` at ``y`` for which :math:`y - x + n` is tangent at
    ``x``, a linear equation. It has one solution if the columns of ``y`` span no direction orthogonal to the columns of
    ``x``, and likewise the rows. The image is where, in addition, the largest singular value of ``n`` is below the
    smallest one of ``y``.

    Domain: the ``v`` for which the ``r``-th singular value of ``x + v`` is larger than the next one, and the columns
    and rows of the nearest matrix span no direction orthogonal to the columns and rows of ``x``. By the bounds of Weyl
    and Wedin the domain contains every ``v`` whose largest singular value is below half the smallest one of ``x``.

    Examples
    --------
    >>> Projection(FixedRank(5, 4, 2))
    FixedRankProjection(manifold=FixedRank(m=5, n=4, r=2))
    """

    manifold: FixedRank

    def retract(self, x: Array, v: Array) -> Array:
        return _of_rank(self.manifold.r, self.manifold.restore(x + v))

    def preimage(self, x: Array, y: Array) -> Array:
        (c, d), (c_there, d_there) = self.manifold.projectors(x), self.manifold.projectors(y)
        chord = y - x
        outside = chord - self.manifold.projection(x, chord)
        # (I - c) n (I - d) = -outside with n = (I - c') n (I - d'), side by side.
        left = jnp.linalg.solve(_carrier(c, c_there), outside)
        n = -jnp.linalg.solve(_carrier(d, d_there), left.T).T
        smallest = jnp.linalg.svd(y, compute_uv=False)[self.manifold.r - 1]
        inside = (jnp.linalg.norm(n, 2) < smallest) & self._inclined(x, y)
        return nan_unless(inside, self.manifold.projection(x, chord + n))

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        singular = jnp.linalg.svd(x + v, compute_uv=False)
        last, beyond = singular[self.manifold.r - 1], singular[self.manifold.r]
        apart = last - beyond > _rounding(singular[0])
        return apart & self._inclined(x, x + v) & comes_back(self, x, v)

    def _inclined(self, x: Array, a: Array) -> Bool[Array, ""]:
        """Whether the leading columns and rows of ``a`` make angles below pi/2 with the columns and rows of ``x``."""
        pairs = zip(self.manifold.projectors(x), self.manifold.projectors(a), strict=True)
        cosines = [jnp.linalg.svd(_carrier(here, there), compute_uv=False)[-1] for here, there in pairs]
        return jnp.minimum(*cosines) > _rounding(jnp.ones((), x.dtype))


def _carrier(here: Array, there: Array) -> Array:
    """Linear map that takes image and kernel of the projector ``there`` to image and kernel of ``here``.

    Its singular values are the cosines of the angles between them.
    """
    return jnp.eye(here.shape[0], dtype=here.dtype) - here - there + 2 * here @ there


def _of_rank(r: int, y: Array) -> Array:
    """``y`` where its first ``r`` singular values are told from rounding of its largest by half of the digits, NaN
    elsewhere."""
    singular = jnp.linalg.svd(jax.lax.stop_gradient(y), compute_uv=False)
    return nan_unless(singular[r - 1] > default_tolerance() * singular[0], y)


def _rounding(size: Array) -> Array:
    """The bound below which a number is zero up to rounding, for a matrix of this size."""
    return SINGULAR_DISTANCE * jnp.finfo(size.dtype).eps * size


@final
class FixedRankOrthographic(Retraction):
    """The orthographic retraction: the matrix of rank ``r`` that differs from ``x + v`` by a normal vector at
    ``x``. Second order.

    Parameters
    ----------
    manifold : FixedRank
        The manifold.

    Notes
    -----
    With any bases ``u`` and ``w`` of the spans of the columns and rows of ``x``, and :math:`a = x + v`, it is
    :math:`a w (u^T a w)^{-1} u^T a`. Inverse: the tangent projection :math:`P_x(y - x)`. Its image and its domain are
    where :math:`u^T y w`, respectively :math:`u^T a w`, is invertible up to rounding of the value. The domain contains
    every ``v`` whose largest singular value is below the smallest one of ``x``, and all but at most ``r`` multiples of
    any ``v``.

    Examples
    --------
    >>> FixedRankOrthographic(FixedRank(5, 4, 2)).manifold
    FixedRank(m=5, n=4, r=2)
    """

    manifold: FixedRank

    def retract(self, x: Array, v: Array) -> Array:
        u, w = self._bases(x)
        a = x + v
        return _of_rank(self.manifold.r, a @ w @ jnp.linalg.solve(u.T @ a @ w, u.T @ a))

    def preimage(self, x: Array, y: Array) -> Array:
        return nan_unless(self._invertible(x, y, y), self.manifold.projection(x, y - x))

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return self._invertible(x, x + v, self(x, v)) & comes_back(self, x, v)

    def _invertible(self, x: Array, a: Array, y: Array) -> Bool[Array, ""]:
        """Whether ``u'a w`` is, up to the rounding of ``y``."""
        u, w = self._bases(x)
        return jnp.linalg.svd(u.T @ a @ w, compute_uv=False)[-1] > _rounding(jnp.linalg.norm(y, 2))

    def _bases(self, x: Array) -> tuple[Array, Array]:
        """Bases of the spans of columns and rows, carried from frozen singular vectors: the spans move with ``x``."""
        left, _, right = jnp.linalg.svd(jax.lax.stop_gradient(x), full_matrices=False)
        columns, rows = self.manifold.projectors(x)
        return columns @ left[:, : self.manifold.r], rows @ right[: self.manifold.r].T
