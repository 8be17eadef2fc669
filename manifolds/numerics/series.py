"""Even functions of an angle as smooth functions of its square.

``sin(t)/t`` and its relatives are analytic in ``s = t^2``; written with a square root they lose every derivative at
``s = 0``. Each function below is a Taylor polynomial for ``s <= 1`` (entire functions: rounding accuracy) and the
closed form beyond, so derivatives of any order are right everywhere in every autodiff mode.
"""

from collections.abc import Callable
from fractions import Fraction
from math import factorial

import jax.numpy as jnp
from jaxtyping import Array

_TERMS = 11  # of a series, enough for double precision where the argument is small
_NEAR = 1e-2  # squares up to which the terms of the arcsine are enough
# Taylor coefficients of the arcsine of a root, over the root.
_ARCSINE = (1.0, 1 / 6, 3 / 40, 5 / 112, 35 / 1152, 63 / 2816, 231 / 13312, 143 / 10240, 6435 / 557056)


def _bernoulli(count: int) -> tuple[float, ...]:
    """``|B_2k| / (2k)!`` for ``k = 1 ... count``, the coefficients of ``1 - (t/2) cot(t/2)`` in ``t^2``."""
    sine = [Fraction((-1) ** k, 4**k * factorial(2 * k + 1)) for k in range(count + 1)]
    found: list[Fraction] = []
    for k in range(1, count + 1):
        found.append(-2 * k * sine[k] - sum(a * b for a, b in zip(sine[1:k], reversed(found), strict=True)))
    return tuple(map(float, found))


_BERNOULLI = _bernoulli(_TERMS)


def _switch(s: Array, radius: float, coefficients: tuple[float, ...], closed: Callable[[Array], Array]) -> Array:
    """Polynomial in ``s`` below ``radius``, closed form above; neither branch meets the other's singularity."""
    near = s < radius
    polynomial = jnp.polyval(jnp.asarray(coefficients[::-1], s.dtype), jnp.where(near, s, 0.0))
    return jnp.where(near, polynomial, closed(jnp.where(near, radius, s)))


def _entire(offset: int) -> tuple[float, ...]:
    return tuple((-1.0) ** k / factorial(2 * k + offset) for k in range(_TERMS))


def cosine(s: Array) -> Array:
    """``cos(sqrt(s))``."""
    return _switch(s, 1.0, _entire(0), lambda s: jnp.cos(jnp.sqrt(s)))


def sinc(s: Array) -> Array:
    """``sin(sqrt(s)) / sqrt(s)``."""
    return _switch(s, 1.0, _entire(1), lambda s: jnp.sin(jnp.sqrt(s)) / jnp.sqrt(s))


def cosc(s: Array) -> Array:
    """``(1 - cos(sqrt(s))) / s``."""
    return _switch(s, 1.0, _entire(2), lambda s: 2 * jnp.sin(jnp.sqrt(s) / 2) ** 2 / s)


def hyperbolic_cosine(s: Array) -> Array:
    """``cosh(sqrt(s))``."""
    return _switch(s, 1.0, tuple(map(abs, _entire(0))), lambda s: jnp.cosh(jnp.sqrt(s)))


def sinhc(s: Array) -> Array:
    """``sinh(sqrt(s)) / sqrt(s)``."""
    return _switch(s, 1.0, tuple(map(abs, _entire(1))), lambda s: jnp.sinh(jnp.sqrt(s)) / jnp.sqrt(s))


def arsinhc(s: Array) -> Array:
    """``arsinh(sqrt(s)) / sqrt(s)``."""
    coefficients = tuple((-1.0) ** k * c for k, c in enumerate(_ARCSINE))
    return _switch(s, _NEAR, coefficients, lambda s: jnp.arcsinh(jnp.sqrt(s)) / jnp.sqrt(s))


def sine_remainder(s: Array) -> Array:
    """``(sqrt(s) - sin(sqrt(s))) / sqrt(s)^3``."""
    return _switch(s, 1.0, _entire(3), lambda s: (1 - jnp.sin(jnp.sqrt(s)) / jnp.sqrt(s)) / s)


def cotangent_remainder(s: Array) -> Array:
    """``(1 - (t/2) cot(t/2)) / t^2`` with ``t = sqrt(s)`` below ``2 pi``."""

    def closed(s: Array) -> Array:
        half = jnp.sqrt(s) / 2
        return (1 - half / jnp.tan(half)) / s

    return _switch(s, 1.0, _BERNOULLI, closed)


def angle_over_sine(s: Array, cosine_of_angle: Array) -> Array:
    """``t / sin(t)`` for ``t`` in [0, pi), from ``s = sin(t)^2`` and ``cos(t)``: accurate from 0 to the edge."""
    near = (s < _NEAR) & (cosine_of_angle > 0)
    small = jnp.polyval(jnp.asarray(_ARCSINE[::-1], s.dtype), jnp.where(near, s, 0.0))
    safe, c = jnp.where(near, 1.0, s), jnp.where(near, 0.0, cosine_of_angle)
    root = jnp.sqrt(jnp.where(safe > 0, safe, 1.0))
    return jnp.where(near, small, jnp.where(safe > 0, jnp.arctan2(root, c) / root, jnp.nan))
