"""Retractions of the unit sphere [Absil, Mahony, Sepulchre 2008, 4.1.1 and 5.4.1]."""

from typing import final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds import Sphere
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics import series
from ..differential import DifferentiatedRetraction
from ..retraction import MidpointRetraction, nan_unless
from ..rounding import keeps_half_the_digits, length


def _middle(x0: Array, x1: Array) -> Array:
    return (x0 + x1) / jnp.linalg.norm(x0 + x1)


@final
class SphereExponential(MidpointRetraction, DifferentiatedRetraction):
    r"""The exponential map of the sphere: great circles.

    Parameters
    ----------
    manifold : Sphere
        The manifold.

    Notes
    -----
    :math:`R(x, v) = \cos|v|\, x + (\sin|v| / |v|)\, v`. Inverse: :math:`(t / \sin t)(y - \cos t\, x)` with
    :math:`\cos t = \langle x, y \rangle`. Its image is all points except the antipode, its domain :math:`|v| < \pi`
    except the last :math:`4\pi\sqrt\epsilon`.

    Examples
    --------
    >>> Exponential(Sphere(2))
    SphereExponential(manifold=Sphere(n=2))
    """

    manifold: Sphere

    def retract(self, x: Array, v: Array) -> Array:
        s = v @ v
        return series.cosine(s) * x + series.sinc(s) * v

    def preimage(self, x: Array, y: Array) -> Array:
        c = x @ y
        w = y - c * x
        w = w - (x @ w) * x  # near the antipode the first subtraction leaves more normal part than tangent
        antipodal = (c < 0) & (w @ w <= (8 * jnp.finfo(w.dtype).eps) ** 2)
        return nan_unless(~antipodal, series.angle_over_sine(w @ w, c) * w)

    def fibre_derivative(self, x: Array, v: Array, w: Array) -> Array:
        sinc, turned = self._rate(x, v)
        return sinc * w - (v @ w) * turned

    def differential_adjoint(self, x: Array, v: Array, xi: Array) -> Array:
        sinc, turned = self._rate(x, v)
        return self.manifold.projection(x, sinc * xi - (turned @ xi) * v)

    def _rate(self, x: Array, v: Array) -> tuple[Array, Array]:
        """``sin t / t`` and the ``a`` of ``DR[w] = (sin t / t) w - <v, w> a``, with ``t = |v|``."""
        s = v @ v
        sinc = series.sinc(s)
        return sinc, sinc * x + (series.cosc(s) - series.sine_remainder(s)) * v

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        gap = jnp.pi - length(v)  # near the antipode rounding turns the direction: magnified by pi / gap
        return (gap > 0) & keeps_half_the_digits(jnp.pi / gap)

    def midpoint(self, x0: Array, x1: Array) -> Array:
        return _middle(x0, x1)


@final
class SphereProjection(MidpointRetraction, DifferentiatedRetraction):
    r"""The nearest point of the sphere to ``x + v``.

    Parameters
    ----------
    manifold : Sphere
        The manifold.

    Notes
    -----
    :math:`R(x, v) = (x + v) / |x + v|`. Inverse: :math:`y / \langle x, y \rangle - x`. Its image is the open hemisphere
    around ``x``, its domain every tangent vector shorter than :math:`1/(4\sqrt\epsilon)`.

    Examples
    --------
    >>> Projection(Sphere(2))
    SphereProjection(manifold=Sphere(n=2))
    """

    manifold: Sphere

    def retract(self, x: Array, v: Array) -> Array:
        # Scaled, so that the square of a long vector is a number.
        y = (x + v) / jax.lax.stop_gradient(jnp.maximum(vec.size(x + v), 1.0))
        return y / jnp.sqrt(y @ y)

    def preimage(self, x: Array, y: Array) -> Array:
        # Written with the tangential part of y, which keeps its relative accuracy for y near x.
        c = x @ y
        return nan_unless(c > 8 * jnp.finfo(c.dtype).eps, (y - c * x) / c)

    def fibre_derivative(self, x: Array, v: Array, w: Array) -> Array:
        y = self(x, v)
        return (w - (y @ w) * y) / jnp.sqrt((x + v) @ (x + v))

    def differential_adjoint(self, x: Array, v: Array, xi: Array) -> Array:
        y = self(x, v)
        return self.manifold.projection(x, xi - (y @ xi) * y) / jnp.sqrt((x + v) @ (x + v))

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return keeps_half_the_digits(length(v))

    def midpoint(self, x0: Array, x1: Array) -> Array:
        return _middle(x0, x1)
