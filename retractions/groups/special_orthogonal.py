"""Retractions of the rotation group, all of the form ``R(x, x Omega) = x g(Omega)`` and hence left-equivariant.

[Absil, Mahony, Sepulchre 2008, example 4.1.2; Boumal 2023, 7.4; inverses of polar and QR: Kaneko, Fiori, Tanaka 2013.]
"""

from typing import final

import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds import SO
from ..differential import DifferentiatedRetraction
from ..retraction import comes_back, nan_unless
from ..rounding import is_seen_beside, keeps_half_the_digits, length
from .functions import rotations, unitary
from .group_map import GroupRetraction, SymmetricGroupRetraction


class _SymmetricRotation(SymmetricGroupRetraction):
    """Functions of rotations with ``g(-Omega) = g(Omega)'``."""

    manifold: SO

    def square_root(self, b: Array) -> Array:
        return rotations.rotation_sqrt(b)


@final
class SOCayley(_SymmetricRotation, DifferentiatedRetraction):
    r"""The Cayley transform of rotations, :math:`R(x, x\Omega) = x (I - \Omega/2)^{-1} (I + \Omega/2)`.

    Parameters
    ----------
    manifold : SO
        The group.

    Notes
    -----
    Inverse: :math:`2 (b - I)(b + I)^{-1}` with :math:`b = x^T y`, for rotations without the eigenvalue -1: a single
    step can rotate by less than 180 degrees. Domain: every :math:`\Omega` shorter than :math:`1/(4\sqrt\epsilon)`, or
    the root of this bound for n = 2, 3. Derivative: :math:`x h A h` for :math:`w = xA`, with
    :math:`h = (I - \Omega/2)^{-1}`.

    Examples
    --------
    >>> Cayley(SO(3))
    SOCayley(manifold=SO(n=3))
    """

    def group_map(self, a: Array) -> Array:
        return rotations.cayley(a)

    def group_map_inverse(self, b: Array) -> Array:
        # Nearer to -1 is rounding; a vector of the domain leads to a cosine that is twice as far from it.
        return nan_unless(rotations.smallest_cosine(b) > -1 + 64 * jnp.finfo(b.dtype).eps, rotations.cayley_inverse(b))

    def fibre_derivative(self, x: Array, v: Array, w: Array) -> Array:
        h = self._half_way(x, v)
        return x @ h @ self.manifold.left_trivialise(x, w) @ h

    def differential_adjoint(self, x: Array, v: Array, xi: Array) -> Array:
        h = self._half_way(x, v)
        return x @ self.manifold.algebra_part(h.T @ x.T @ xi @ h.T)

    def _half_way(self, x: Array, v: Array) -> Array:
        """``h``, which is half of ``I + g(Omega)``."""
        g = self.group_map(self.manifold.left_trivialise(x, v))
        return (jnp.eye(g.shape[0], dtype=g.dtype) + g) / 2

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        # Of angles near pi the inverse of a rotation in space sees the square of their distance from it.
        size = length(v)
        return keeps_half_the_digits(size * size if self.manifold.n <= 3 else size)


@final
class SOPolar(_SymmetricRotation, DifferentiatedRetraction):
    r"""The polar retraction of rotations: the nearest rotation to ``x + v``, its orthogonal polar factor.

    Parameters
    ----------
    manifold : SO
        The group.

    Notes
    -----
    Inverse: :math:`\Omega = (b + b^T)^{-1} (b - b^T)` with :math:`b = x^T y`, for angles below :math:`\pi/2`. Domain:
    every :math:`\Omega` shorter than :math:`1/(4\sqrt\epsilon)`. Derivative: :math:`y t` for :math:`w = xA`, with the
    skew ``t`` of :math:`s t + t s = g^T A + A g`, where :math:`I + \Omega = g s`.

    Examples
    --------
    >>> Polar(SO(3))
    SOPolar(manifold=SO(n=3))
    """

    def group_map(self, a: Array) -> Array:
        return nan_unless(is_seen_beside(a), rotations.polar(a))

    def group_map_inverse(self, b: Array) -> Array:
        return nan_unless(rotations.smallest_cosine(b) > 0, rotations.polar_inverse(b))

    def fibre_derivative(self, x: Array, v: Array, w: Array) -> Array:
        omega, a = self.manifold.left_trivialise(x, v), self.manifold.left_trivialise(x, w)
        g = self.group_map(omega)
        return x @ g @ rotations.polar_turn(omega, g, g.T @ a + a @ g)

    def differential_adjoint(self, x: Array, v: Array, xi: Array) -> Array:
        omega = self.manifold.left_trivialise(x, v)
        g = self.group_map(omega)
        t = rotations.polar_turn(omega, g, self.manifold.left_trivialise(x @ g, xi))
        return x @ self.manifold.algebra_part(g @ t + t @ g.T)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return keeps_half_the_digits(length(v))


@final
class SOQR(GroupRetraction):
    r"""The QR retraction of rotations: the orthogonal factor of ``x + v`` with a positive diagonal. First order.

    Parameters
    ----------
    manifold : SO
        The group.

    Notes
    -----
    Inverse: a triangular recursion, if its triangular factor has a positive diagonal. Domain: every :math:`\Omega`
    short enough for half of its digits to come back.

    Examples
    --------
    >>> QR(SO(3))
    SOQR(manifold=SO(n=3))
    """

    manifold: SO

    def group_map(self, a: Array) -> Array:
        return nan_unless(is_seen_beside(a), unitary.qr_factor(a))

    def group_map_inverse(self, b: Array) -> Array:
        omega, triangle = unitary.qr_inverse(b)
        return nan_unless(jnp.all(jnp.diagonal(triangle) > 0), omega)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return comes_back(self, x, v)
