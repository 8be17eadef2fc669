"""Retractions of the unitary group by factorisations.

As for real matrices [Absil, Mahony, Sepulchre 2008, example 4.1.2; their inverses: Kaneko, Fiori, Tanaka 2013].
"""

from typing import final

import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds import U
from ..retraction import comes_back, nan_unless
from ..rounding import is_seen_beside, keeps_half_the_digits, length
from .functions import unitary
from .group_map import GroupRetraction, SymmetricGroupRetraction


@final
class UPolar(SymmetricGroupRetraction):
    r"""The polar retraction of unitary matrices: the nearest unitary matrix to ``x + v``.

    Parameters
    ----------
    manifold : U
        The group.

    Notes
    -----
    Inverse: :math:`(b + b^H)^{-1} (b - b^H)` with :math:`b = x^H y`, for angles below :math:`\pi/2`. Domain: every
    tangent vector shorter than :math:`1/(4\sqrt\epsilon)`.

    Examples
    --------
    >>> Polar(U(2))
    UPolar(manifold=U(n=2))
    """

    manifold: U

    def group_map(self, a: Array) -> Array:
        return nan_unless(is_seen_beside(a), unitary.polar(a))

    def group_map_inverse(self, b: Array) -> Array:
        return nan_unless(jnp.linalg.eigvalsh((b + b.conj().T) / 2)[0] > 0, unitary.polar_inverse(b))

    def square_root(self, b: Array) -> Array:
        return unitary.square_root(b)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return keeps_half_the_digits(length(v))


@final
class UQR(GroupRetraction):
    """The QR retraction of unitary matrices: the unitary factor of ``x + v`` with a positive diagonal. First order.

    Parameters
    ----------
    manifold : U
        The group.

    Notes
    -----
    Inverse: a triangular recursion, if its triangular factor has a positive diagonal. Domain: every tangent vector
    short enough for half of its digits to come back.

    Examples
    --------
    >>> QR(U(2))
    UQR(manifold=U(n=2))
    """

    manifold: U

    def group_map(self, a: Array) -> Array:
        return nan_unless(is_seen_beside(a), unitary.qr_factor(a))

    def group_map_inverse(self, b: Array) -> Array:
        skew, triangle = unitary.qr_inverse(b)
        return nan_unless(jnp.all(jnp.diagonal(triangle).real > 0), skew)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return comes_back(self, x, v)
