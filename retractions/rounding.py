"""Where rounding ends the domain of a retraction.

One rule for all: a tangent vector ``v`` is in the domain where the inverse gives it back to more than half of its
digits, that is to ``sqrt(eps)`` relative to ``1 + |v|``. Each retraction says in its own terms by how much its inverse
magnifies a rounding of the point, or has the round trip say it.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Shaped

from ..manifolds.numerics.tolerances import HALF

SINGULAR_DISTANCE = (
    8  # distance from a singular matrix, in rounding units, below which an inverse is taken to have none
)
POINT = 4  # rounding units to which a retraction computes a point


def keeps_half_the_digits(magnification: Array) -> Bool[Array, ""]:
    """Whether rounding of a point that is magnified so much stays below ``sqrt(eps)``; no magnification that is NaN
    does."""
    return jnp.abs(magnification) * POINT <= jnp.finfo(magnification.dtype).eps ** -HALF


def length(v: Shaped[Array, "..."]) -> Array:
    """Euclidean length ``|v|`` of an array, infinite where its square is no number."""
    return jnp.sqrt(jnp.sum(jnp.real(v * jnp.conj(v))))


def is_seen_beside(v: Shaped[Array, "..."]) -> Bool[Array, ""]:
    """Whether rounding of ``x + v``, ``x`` of size 1, leaves what is of ``x``: where ``v`` is shorter than
    ``1 / (SINGULAR_DISTANCE eps)``."""
    return length(jax.lax.stop_gradient(v)) * SINGULAR_DISTANCE * jnp.finfo(v.dtype).eps < 1
