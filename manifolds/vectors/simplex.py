"""The interior of the probability simplex."""

from typing import final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .hypersurface import Hypersurface


@final
class Simplex(Hypersurface):
    r"""The interior of the simplex, :math:`\{x : x_0 + \dots + x_n = 1,\ x_i > 0\}`.

    Parameters
    ----------
    n : int
        The dimension; points have shape ``(n + 1,)``.

    Examples
    --------
    >>> Simplex(3).dimension, bool(Simplex(3).contains(jnp.full(4, 0.25)))
    (3, True)
    """

    def projection(self, x: Array, a: Array) -> Array:
        return a - jnp.mean(a)

    def basis(self, x: Array) -> Float[Array, "n n+1"]:
        # The reflection that takes the first axis to the diagonal, up to sign.
        w = jnp.full_like(x, (self.n + 1) ** -0.5).at[0].add(1.0)
        return (jnp.eye(self.n + 1, dtype=x.dtype) - 2 * jnp.outer(w, w) / (w @ w))[1:]

    def restore(self, x: Array) -> Array:
        """``x`` over its sum, which keeps every entry positive."""
        return x / jnp.sum(x)

    def violations(self, x: Array) -> dict[str, Array]:
        return {"|sum of the entries - 1|": jnp.abs(jnp.sum(x) - 1), "number of entries not positive": jnp.sum(x <= 0)}

    def random_point(self, key: Array) -> Array:
        return jax.nn.softmax(jax.random.normal(key, (self.n + 1,)))
