"""Rational and factorisation retractions of the Stiefel manifold.

The differentiated QR retraction is that of [Absil, Mahony, Sepulchre 2008, 8.1], of the others and of all adjoints the
formulas are derived here; inverses are written with ``y - x``, so that they keep the relative accuracy of short
vectors.
"""

from typing import final

import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds import Stiefel
from ...manifolds.numerics.frames import polar_factor, qr_factor
from ...manifolds.numerics.matrices import lyapunov, symmetric, symmetric_factor, triangular_factor
from ..differential import DifferentiatedRetraction
from ..retraction import comes_back, nan_unless
from ..rounding import SINGULAR_DISTANCE, is_seen_beside, keeps_half_the_digits, length


def _right_divide(a: Array, b: Array) -> Array:
    """``a b^-1``."""
    return jnp.linalg.solve(b.T, a.T).T


def _skew(a: Array) -> Array:
    return (a - a.conj().T) / 2


def _triangle(a: Array) -> Array:
    """The strictly lower triangle and half of the diagonal; less its adjoint it is skew."""
    return (jnp.tril(a) + jnp.tril(a, -1)) / 2


def _defect(x: Array, d: Array) -> Array:
    """``2I - a - a'`` of ``a = x'y``, from ``d = y - x``."""
    return -2 * symmetric(x.conj().T @ d)


@final
class StiefelPolar(DifferentiatedRetraction):
    r"""The polar retraction of frames: the nearest frame to ``x + v``. Second order.

    Parameters
    ----------
    manifold : Stiefel
        The manifold.

    Notes
    -----
    :math:`R(x, v) = (x + v)(I + v^T v)^{-1/2}`. Inverse: :math:`y t - x` with the symmetric ``t`` of
    :math:`a t + t a^T = 2I`, :math:`a = x^T y`. Its image is where ``t`` is positive definite: all eigenvalues of ``a``
    have positive real parts. Its domain is every tangent vector shorter than :math:`1/(4\sqrt\epsilon)`.

    References
    ----------
    Kaneko, Fiori, Tanaka, Empirical arithmetic averaging over the compact Stiefel manifold, 2013.

    Examples
    --------
    >>> Polar(Stiefel(3, 2))
    StiefelPolar(manifold=Stiefel(n=3, p=2))
    """

    manifold: Stiefel

    def retract(self, x: Array, v: Array) -> Array:
        return nan_unless(is_seen_beside(v), polar_factor(x + v))

    def preimage(self, x: Array, y: Array) -> Array:
        d = y - x
        t = symmetric_factor(x.conj().T @ y, _defect(x, d))
        positive = jnp.linalg.eigvalsh(t)[0] > -1
        return nan_unless(positive, d + y @ t)

    def fibre_derivative(self, x: Array, v: Array, w: Array) -> Array:
        y, s = self._factors(x, v)
        return y @ lyapunov(s, 2 * _skew(y.conj().T @ w)) + _right_divide(w - y @ (y.conj().T @ w), s)

    def differential_adjoint(self, x: Array, v: Array, xi: Array) -> Array:
        y, s = self._factors(x, v)
        turn = 2 * lyapunov(s, _skew(y.conj().T @ xi))
        return self.manifold.projection(x, y @ turn + _right_divide(xi - y @ (y.conj().T @ xi), s))

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return keeps_half_the_digits(length(v))

    def _factors(self, x: Array, v: Array) -> tuple[Array, Array]:
        """``y`` and the symmetric ``s`` of ``x + v = y s``."""
        y = polar_factor(x + v)
        return y, symmetric(y.conj().T @ (x + v))


@final
class StiefelQR(DifferentiatedRetraction):
    """The QR retraction of frames: the orthonormal factor of ``x + v`` with a positive diagonal. First order.

    Parameters
    ----------
    manifold : Stiefel
        The manifold.

    Notes
    -----
    Inverse: :math:`y t - x` with the upper triangular ``t`` of :math:`a t + t^T a^T = 2I`, :math:`a = x^T y`. Its image
    is where the diagonal of ``t`` is positive: the leading principal minors of ``a`` are. Its domain is every tangent
    vector short enough for half of its digits to come back.

    References
    ----------
    Kaneko, Fiori, Tanaka, Empirical arithmetic averaging over the compact Stiefel manifold, 2013.

    Examples
    --------
    >>> QR(Stiefel(3, 2))
    StiefelQR(manifold=Stiefel(n=3, p=2))
    """

    manifold: Stiefel

    def retract(self, x: Array, v: Array) -> Array:
        return nan_unless(is_seen_beside(v), qr_factor(x + v))

    def preimage(self, x: Array, y: Array) -> Array:
        d = y - x
        t = triangular_factor(x.conj().T @ y, _defect(x, d))
        return nan_unless(jnp.all(jnp.diagonal(t).real > -1), d + y @ t)

    def fibre_derivative(self, x: Array, v: Array, w: Array) -> Array:
        y, r = self._factors(x, v)
        moved = _right_divide(w, r)
        inside = y.conj().T @ moved
        return y @ (2 * _skew(_triangle(inside))) + moved - y @ inside

    def differential_adjoint(self, x: Array, v: Array, xi: Array) -> Array:
        y, r = self._factors(x, v)
        inside = y.conj().T @ xi
        # The skew part, because <y s, xi> for a skew s does not see the symmetric one.
        turned = y @ _triangle(2 * _skew(inside)) + xi - y @ inside
        return self.manifold.projection(x, _right_divide(turned, r.conj().T))

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return comes_back(self, x, v)

    def _factors(self, x: Array, v: Array) -> tuple[Array, Array]:
        """``y`` and the upper triangular ``r`` of ``x + v = y r``."""
        y = qr_factor(x + v)
        return y, jnp.triu(y.conj().T @ (x + v))


@final
class StiefelCayley(DifferentiatedRetraction):
    r"""The Cayley retraction of frames, of second order for the canonical metric and of first order for the ambient
    metric.

    Parameters
    ----------
    manifold : Stiefel
        The manifold.

    Notes
    -----
    :math:`R(x, v) = (I - W/2)^{-1} (I + W/2) x` with :math:`W = P v x^T - x v^T P` and :math:`P = I - x x^T/2`; the
    geodesics of the canonical metric are :math:`\exp(W) x`. Eliminating the span of ``x`` leaves ``p x p`` matrices:
    with :math:`v = x\Omega + k` and :math:`x^T k = 0`,

    .. math::
        R(x, v) = (2x + k) s^{-1} - x, \quad s = I - \Omega/2 + k^T k/4.

    Inverse: :math:`2y (I + x^T y)^{-1} + 2x (I + y^T x)^{-1} - 2x`, since :math:`s = 2 (I + x^T y)^{-1}`. Its image is
    where :math:`x^T y` has no eigenvalue -1, its domain every tangent vector short enough for half of its digits to
    come back.

    References
    ----------
    Wen, Yin, A feasible method for optimization with orthogonality constraints, 2013; the inverse after Zhu, Sato,
    2020.

    Examples
    --------
    >>> Cayley(Stiefel(3, 2))
    StiefelCayley(manifold=Stiefel(n=3, p=2))
    """

    manifold: Stiefel

    def retract(self, x: Array, v: Array) -> Array:
        return self._sum(x, v)[0] - x

    def preimage(self, x: Array, y: Array) -> Array:
        # With w = x + y, d = y - x: I + x'y = (2 w'w + w'd - d'w) / 4, exact near x and near the edge of the image.
        w, d = x + y, y - x
        turn = _skew(w.conj().T @ d) / 2
        t = jnp.linalg.solve(w.conj().T @ w / 2 + turn, d.conj().T @ d / 2 - turn)
        inside = jnp.linalg.norm(w, -2) > SINGULAR_DISTANCE * jnp.finfo(x.dtype).eps
        return nan_unless(inside, d + d @ t + 2 * x @ symmetric(t))

    def fibre_derivative(self, x: Array, v: Array, w: Array) -> Array:
        total, k, inverse = self._sum(x, v)
        across = w - x @ (x.conj().T @ w)
        bend = (symmetric(k.conj().T @ across) - self.manifold.skew(x, w)) / 2
        return (across - total @ bend) @ inverse

    def differential_adjoint(self, x: Array, v: Array, xi: Array) -> Array:
        total, k, inverse = self._sum(x, v)
        pulled = xi @ inverse.conj().T
        z = total.conj().T @ pulled
        across = pulled - k @ symmetric(z) / 2
        return across - x @ (x.conj().T @ across) + x @ _skew(z) / 2

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return comes_back(self, x, v)

    def _sum(self, x: Array, v: Array) -> tuple[Array, Array, Array]:
        """``R(x, v) + x``, ``k`` and ``s^-1``, from the QR factorisation of ``[I; k/2]``, whose Gram matrix is ``sym
        s``."""
        p = x.shape[1]
        eye, k = jnp.eye(p, dtype=x.dtype), v - x @ (x.conj().T @ v)
        q = jnp.linalg.qr(jnp.concatenate([eye, k / 2]))[0]
        top, bottom = q[:p], q[p:]
        unwound = jnp.linalg.solve(eye - top.conj().T @ self.manifold.skew(x, v) @ top / 2, top.conj().T)
        return 2 * (x @ top + bottom) @ unwound, k, top @ unwound
