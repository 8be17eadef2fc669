"""Retractions of the rotation group, all of the form ``R(x, x Omega) = x f(Omega)`` and hence left-equivariant.

``Omega`` is made exactly skew from ``x'v`` before use: a skew part lost to rounding makes long products drift off the group.
"""

from abc import abstractmethod
from typing import final

import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds import SO
from ..retraction import MidpointRetraction, Retraction, nan_unless
from . import rotations


def _largest_angle(omega: Array) -> Array:
    return jnp.linalg.norm(omega, 2)


def _smallest_cosine(x: Array, y: Array) -> Array:
    """Cosine of the largest rotation angle of ``x'y``."""
    a = x.T @ y
    return (jnp.trace(a) - 1) / 2 if a.shape[0] == 3 else jnp.linalg.eigvalsh((a + a.T) / 2)[0]


class _SymmetricRotation(MidpointRetraction):
    """A map with ``f(-Omega) = f(Omega)'``: two points are symmetric about the square root of the rotation between them."""

    manifold: SO

    @abstractmethod
    def rotation(self, omega: Array) -> Array:
        """``f(Omega)``."""

    def __call__(self, x: Array, v: Array) -> Array:
        return x @ self.rotation(self.manifold.skew(x, v))

    def midpoint(self, x0: Array, x1: Array) -> Array:
        return x0 @ rotations.rotation_sqrt(x0.T @ x1)


@final
class SOExponential(_SymmetricRotation):
    """``R(x, x Omega) = x exp(Omega)``, the geodesics of the bi-invariant metric.

    Inverse: the principal logarithm, for rotations without the eigenvalue -1; domain: all angles of ``Omega`` below pi.
    """

    def rotation(self, omega: Array) -> Array:
        return rotations.exponential(omega)

    def preimage(self, x: Array, y: Array) -> Array:
        return nan_unless(_smallest_cosine(x, y) > -1, x @ rotations.logarithm(x.T @ y))

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return _largest_angle(self.manifold.skew(x, v)) < jnp.pi


@final
class SOCayley(_SymmetricRotation):
    """``R(x, x Omega) = x (I - Omega/2)^-1 (I + Omega/2)``.

    Inverse ``2 (a - I)(a + I)^-1`` with ``a = x'y``, for rotations without the eigenvalue -1; domain: every ``Omega``.
    """

    def rotation(self, omega: Array) -> Array:
        return rotations.cayley(omega)

    def preimage(self, x: Array, y: Array) -> Array:
        return nan_unless(_smallest_cosine(x, y) > -1, x @ rotations.cayley_inverse(x.T @ y))

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return jnp.all(jnp.isfinite(v))


@final
class SOPolar(_SymmetricRotation):
    """``R(x, v)`` = orthogonal polar factor of ``x + v``: the nearest rotation.

    Inverse ``Omega = (a + a')^-1 (a - a')`` with ``a = x'y``, for angles below pi/2; domain: every ``Omega``.
    """

    def rotation(self, omega: Array) -> Array:
        return rotations.polar(omega)

    def preimage(self, x: Array, y: Array) -> Array:
        return nan_unless(_smallest_cosine(x, y) > 0, x @ rotations.polar_inverse(x.T @ y))

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return jnp.all(jnp.isfinite(v))


@final
class SOQR(Retraction):
    """``R(x, v)`` = orthogonal factor of the QR factorisation of ``x + v`` with positive diagonal: first order.

    Inverse by a triangular recursion, where its triangular factor has a positive diagonal; domain: every ``Omega``.
    """

    manifold: SO

    def __call__(self, x: Array, v: Array) -> Array:
        return x @ rotations.qr_factor(self.manifold.skew(x, v))

    def preimage(self, x: Array, y: Array) -> Array:
        omega, triangle = rotations.qr_inverse(x.T @ y)
        return nan_unless(jnp.all(jnp.diagonal(triangle) > 0), x @ omega)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return jnp.all(jnp.isfinite(v))
