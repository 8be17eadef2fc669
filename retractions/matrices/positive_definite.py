"""Retractions of the symmetric positive definite matrices.

With ``x = l l'`` (Cholesky) the action of ``l`` takes the identity to ``x``: what is invariant is computed at the
identity, on ``m = l^-1 v l^-T``.
"""

from typing import final

import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Bool

from ...manifolds import SPD
from ...manifolds.numerics.matrices import spd_log, spd_sqrt, sym_exp, symmetric
from ..differential import DifferentiatedRetraction
from ..retraction import MidpointRetraction, comes_back, nan_unless
from ..rounding import SINGULAR_DISTANCE, keeps_half_the_digits


def _to_identity(factor: Array, a: Array) -> Array:
    """``l^-1 a l^-T`` for a symmetric ``a``."""
    half = solve_triangular(factor, a, lower=True)
    return symmetric(solve_triangular(factor, half.T, lower=True))


def _spread_is_known(logarithm: Array) -> Bool[Array, ""]:
    """Whether the smallest eigenvalue of an exponential keeps half of its digits beside the rounding of the largest."""
    values = jnp.linalg.eigvalsh(logarithm)
    return keeps_half_the_digits(jnp.exp(values[-1] - values[0]))


def _in_cone(y: Array) -> Array:
    """The matrix ``y`` if its eigenvalues exceed the rounding of ``y``, otherwise NaN."""
    fixed = jax.lax.stop_gradient(y)
    rounding = SINGULAR_DISTANCE * jnp.finfo(y.dtype).eps * jnp.trace(fixed)
    factor = jnp.linalg.cholesky(fixed - rounding * jnp.eye(y.shape[0], dtype=y.dtype))
    return nan_unless(jnp.all(jnp.isfinite(factor)), y)


@final
class SPDExponential(MidpointRetraction):
    r"""The exponential map of ``AffineInvariantMetric`` on positive definite matrices.

    Parameters
    ----------
    manifold : SPD
        The manifold.

    Notes
    -----
    :math:`R(x, v) = l \exp(l^{-1} v l^{-T}) l^T` with :math:`x = l l^T`. Inverse: :math:`l \log(l^{-1} y l^{-T}) l^T`.
    Its image is the manifold. Its domain is every tangent vector short enough for half of its digits to come back:
    eigenvalues of :math:`l^{-1} v l^{-T}` at most about 16 apart, 6 in single precision. Entries are NaN if an
    eigenvalue of the value is rounding of the largest one: from about 34 apart, 14 in single precision.

    References
    ----------
    Bhatia, Positive Definite Matrices, 2007, chapter 6.

    Examples
    --------
    >>> Exponential(SPD(3))
    SPDExponential(manifold=SPD(n=3))
    """

    manifold: SPD

    def retract(self, x: Array, v: Array) -> Array:
        factor = jnp.linalg.cholesky(x)
        return _in_cone(symmetric(factor @ sym_exp(_to_identity(factor, v)) @ factor.T))

    def preimage(self, x: Array, y: Array) -> Array:
        factor = jnp.linalg.cholesky(x)
        return symmetric(factor @ spd_log(_to_identity(factor, y)) @ factor.T)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return _spread_is_known(_to_identity(jnp.linalg.cholesky(x), v)) & comes_back(self, x, v)

    def midpoint(self, x0: Array, x1: Array) -> Array:
        factor = jnp.linalg.cholesky(x0)
        return symmetric(factor @ spd_sqrt(_to_identity(factor, x1)) @ factor.T)


@final
class SPDSecondOrder(DifferentiatedRetraction):
    r"""The quadratic retraction :math:`R(x, v) = x + v + v x^{-1} v / 2`, of second order for
    ``AffineInvariantMetric``.

    Parameters
    ----------
    manifold : SPD
        The manifold.

    Notes
    -----
    It equals :math:`x/2 + (x + v) x^{-1} (x + v)/2` and is positive definite for every ``v``; NaN if an eigenvalue is
    rounding of the largest one. Inverse: :math:`l (\sqrt{2 l^{-1} y l^{-T} - I} - I) l^T` for :math:`y > x/2`. Domain:
    :math:`v > -x`, by :math:`4\sqrt\epsilon`. At the edge of the domain the image folds: a relative change ``e`` of
    ``y`` changes the inverse by :math:`\sqrt e`.

    References
    ----------
    Jeuris, Vandebril, Vandereycken, A survey and comparison of contemporary algorithms for computing the matrix
    geometric mean, 2012.

    Examples
    --------
    >>> I = jnp.eye(2)
    >>> SPDSecondOrder(SPD(2))(I, I).tolist()
    [[2.5, 0.0], [0.0, 2.5]]
    """

    manifold: SPD

    def retract(self, x: Array, v: Array) -> Array:
        half = solve_triangular(jnp.linalg.cholesky(x), v, lower=True)
        return _in_cone(symmetric(x + v + half.T @ half / 2))

    def preimage(self, x: Array, y: Array) -> Array:
        factor = jnp.linalg.cholesky(x)
        eye, rounding = jnp.eye(x.shape[0], dtype=x.dtype), 1e3 * float(jnp.finfo(x.dtype).eps)
        return symmetric(factor @ (spd_sqrt(2 * _to_identity(factor, y) - eye, rounding) - eye) @ factor.T)

    def fibre_derivative(self, x: Array, v: Array, w: Array) -> Array:
        return w + symmetric(v @ jnp.linalg.solve(x, w))

    def differential_adjoint(self, x: Array, v: Array, xi: Array) -> Array:
        xi = symmetric(xi)
        return xi + symmetric(jnp.linalg.solve(x, v @ xi))

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        stretches = 1 + jnp.linalg.eigvalsh(_to_identity(jnp.linalg.cholesky(x), v))
        magnified = jnp.maximum(jnp.abs(stretches[-1]), 1) / stretches[0]
        return (stretches[0] > 0) & keeps_half_the_digits(magnified) & jnp.all(jnp.isfinite(self(x, v)))


@final
class SPDLogEuclidean(MidpointRetraction):
    r"""The exponential map of the log-Euclidean metric on positive definite matrices.

    Parameters
    ----------
    manifold : SPD
        The manifold.

    Notes
    -----
    :math:`R(x, v) = \exp(\log x + D\log(x)[v])`. Inverse: :math:`D\exp(\log x)[\log y - \log x]`. Its image is the
    manifold, its domain every tangent vector short enough for half of its digits to come back. Entries are NaN if an
    eigenvalue of the value is rounding of the largest one.

    References
    ----------
    Arsigny, Fillard, Pennec, Ayache, Geometric means in a novel vector space structure on symmetric positive-definite
    matrices, 2007.

    Examples
    --------
    >>> SPDLogEuclidean(SPD(3)).manifold
    SPD(n=3)
    """

    manifold: SPD

    def retract(self, x: Array, v: Array) -> Array:
        return _in_cone(symmetric(sym_exp(self._logarithm_of_value(x, v))))

    def _logarithm_of_value(self, x: Array, v: Array) -> Array:
        log, rate = jax.jvp(spd_log, (x,), (v,))
        return symmetric(log + rate)

    def preimage(self, x: Array, y: Array) -> Array:
        log = spd_log(x)
        return symmetric(jax.jvp(sym_exp, (log,), (spd_log(y) - log,))[1])

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return _spread_is_known(self._logarithm_of_value(x, v)) & comes_back(self, x, v)

    def midpoint(self, x0: Array, x1: Array) -> Array:
        return symmetric(sym_exp((spd_log(x0) + spd_log(x1)) / 2))
