"""Addition, the retraction of a vector space."""

from typing import final

import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds import Euclidean
from ..retraction import MidpointRetraction


@final
class Addition(MidpointRetraction):
    """The retraction of a Euclidean space, ``R(x, v) = x + v``, with inverse ``y - x``.

    Parameters
    ----------
    manifold : Euclidean
        The space.

    Examples
    --------
    >>> float(Addition(Euclidean(1))(jnp.ones(1), jnp.ones(1))[0])
    2.0
    """

    manifold: Euclidean

    def retract(self, x: Array, v: Array) -> Array:
        return x + v

    def frame(self, x: Array) -> None:
        return None  # the entries themselves

    def chart(self, x: Array, frame: None, c: Array) -> Array:
        return x + c.reshape(x.shape)

    def both_ways(self, x: Array, v: Array) -> tuple[Array, Array]:
        return x - v, x + v

    def preimage(self, x: Array, y: Array) -> Array:
        return y - x

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return jnp.all(jnp.isfinite(x + v))

    def midpoint(self, x0: Array, x1: Array) -> Array:
        return (x0 + x1) / 2
