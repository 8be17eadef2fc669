"""Retractions of hyperbolic space, computed at the apex of the hyperboloid, where nothing cancels.

[Boumal 2023, 7.6; the models of hyperbolic space: Cannon, Floyd, Kenyon, Parry, "Hyperbolic geometry", 1997.]
"""

from typing import final

import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds import Hyperbolic
from ...manifolds.numerics import series
from ..differential import DifferentiatedRetraction
from ..retraction import MidpointRetraction, nan_unless
from ..rounding import keeps_half_the_digits


def _middle(manifold: Hyperbolic, x0: Array, x1: Array) -> Array:
    cosine, _ = manifold.seen_from(x0, x1)
    return (x0 + x1) / jnp.sqrt(2 * (1 + cosine))


@final
class HyperbolicExponential(MidpointRetraction):
    r"""The exponential map of hyperbolic space, of curvature -1.

    Parameters
    ----------
    manifold : Hyperbolic
        The manifold.

    Notes
    -----
    :math:`R(x, v) = \cosh|v|\, x + (\sinh|v| / |v|)\, v` with the Lorentz length :math:`|v|`. Inverse:
    :math:`(d / \sinh d)(y - \cosh d\, x)` with :math:`\cosh d = -\langle x, y \rangle_L`. Its image is the whole space.
    Its domain is every tangent vector short enough for its value, and the square of its value, to be finite; outside it
    entries are NaN.

    Examples
    --------
    >>> Exponential(Hyperbolic(2))
    HyperbolicExponential(manifold=Hyperbolic(n=2))
    """

    manifold: Hyperbolic

    def retract(self, x: Array, v: Array) -> Array:
        u = self.manifold.at_apex(x, v)
        s = u @ u
        # Through u again: the rounding of v, which is magnified by x_0, would not be that of its length.
        y = series.hyperbolic_cosine(s) * x + self.manifold.from_apex(x, series.sinhc(s) * u)
        return nan_unless(jnp.isfinite(y @ y), y)

    def preimage(self, x: Array, y: Array) -> Array:
        _, u = self.manifold.seen_from(x, y)
        return self.manifold.from_apex(x, series.arsinhc(u @ u) * u)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        # The squares of the value's coordinates are to be numbers too; the boost from x magnifies rounding by x_0^2.
        y = self(x, v)
        return jnp.isfinite(y @ y) & keeps_half_the_digits(x[0] ** 2)

    def midpoint(self, x0: Array, x1: Array) -> Array:
        return _middle(self.manifold, x0, x1)


@final
class HyperbolicProjection(MidpointRetraction, DifferentiatedRetraction):
    r"""The central projection of ``x + v`` on hyperbolic space; ``v`` is a point of Klein's model centred at ``x``.

    Parameters
    ----------
    manifold : Hyperbolic
        The manifold.

    Notes
    -----
    :math:`R(x, v) = (x + v) / \sqrt{1 - |v|^2}` with the Lorentz length :math:`|v| < 1`. Inverse:
    :math:`-y / \langle x, y \rangle_L - x`. Its image is the whole space, its domain :math:`|v| < 1`; entries are NaN
    outside the domain. Derivative: :math:`(w + \langle y, w \rangle_L y) / \sqrt{1 - |v|^2}` with :math:`y = R(x, v)`.

    Examples
    --------
    >>> Projection(Hyperbolic(2))
    HyperbolicProjection(manifold=Hyperbolic(n=2))
    """

    manifold: Hyperbolic

    def retract(self, x: Array, v: Array) -> Array:
        u = self.manifold.at_apex(x, v)
        return self.manifold.restore((x + v) / jnp.sqrt(1 - u @ u))

    def preimage(self, x: Array, y: Array) -> Array:
        cosine, u = self.manifold.seen_from(x, y)
        return self.manifold.from_apex(x, u / cosine)

    def fibre_derivative(self, x: Array, v: Array, w: Array) -> Array:
        u, root, y = self._parts(x, v)
        space = w[1:] / root + (u @ self.manifold.at_apex(x, w)) / root**2 * y[1:]
        return jnp.concatenate([(y[1:] @ space / y[0])[None], space])

    def differential_adjoint(self, x: Array, v: Array, xi: Array) -> Array:
        u, root, y = self._parts(x, v)
        space = xi[1:] + xi[0] / y[0] * y[1:]
        pulled = space / root + (space @ y[1:]) / root**2 * u
        time = -(space @ y[1:]) / root**2 * (u @ x[1:]) / (1 + x[0])
        return self.manifold.projection(x, jnp.concatenate([time[None], pulled]))

    def _parts(self, x: Array, v: Array) -> tuple[Array, Array, Array]:
        """``v`` at the apex, ``sqrt(1 - |v|^2)`` and ``R(x, v)``."""
        u = self.manifold.at_apex(x, v)
        return u, jnp.sqrt(1 - u @ u), self(x, v)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        u = self.manifold.at_apex(x, v)
        return (u @ u < 1) & keeps_half_the_digits(x[0] ** 2)

    def midpoint(self, x0: Array, x1: Array) -> Array:
        return _middle(self.manifold, x0, x1)
