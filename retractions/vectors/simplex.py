"""A retraction of the interior of the simplex."""

from typing import final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds import Simplex
from ..retraction import Retraction, nan_unless


@final
class SimplexExponential(Retraction):
    """``R(x, v)`` proportional to ``x exp(v/x)``, entry by entry: the exponential families through ``x``, always
    positive.

    They are the geodesics of the e-connection [Amari 1985], not of a metric: ``SecondOrder`` makes them agree with one
    to second order. Inverse ``v = x (log(y/x) - sum x log(y/x))``; its image is the manifold, its domain every tangent
    vector whose value has no entry that underflows or has lost digits there (2e-308 in double precision); NaN outside
    it.

    >>> Exponential(Simplex(3))
    SimplexExponential(manifold=Simplex(n=3))
    """

    manifold: Simplex

    def retract(self, x: Array, v: Array) -> Array:
        logs = jnp.log(x) + v / x
        # Relative to the largest, of which derivatives would be multiplied by 1 - y, a difference, where y is nearly 1.
        y = jax.nn.softmax(logs - logs[jnp.argmax(logs)])
        return nan_unless(jnp.all(y >= jnp.finfo(y.dtype).tiny), y)

    def preimage(self, x: Array, y: Array) -> Array:
        logs = jnp.log(y / x)
        return x * (logs - x @ logs)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return jnp.all(jnp.isfinite(self(x, v)))
