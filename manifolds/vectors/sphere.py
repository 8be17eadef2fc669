"""The unit sphere."""

from typing import final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..groups.special_orthogonal import skew_basis
from ..manifold import HomogeneousSpace
from .hypersurface import Hypersurface


@final
class Sphere(Hypersurface, HomogeneousSpace):
    r"""The unit sphere :math:`\{x : |x| = 1\}`, on which rotations of space act.

    Parameters
    ----------
    n : int
        The dimension; points have shape ``(n + 1,)``.

    Examples
    --------
    >>> Sphere(2).dimension, Sphere(2).ambient.shape
    (2, (3,))
    """

    def projection(self, x: Array, a: Array) -> Array:
        return a - jnp.sum(x * a) * x  # half the time of a product of matrices in large batches

    def basis(self, x: Array) -> Float[Array, "n n+1"]:
        # The reflection that takes the first axis to -sign(x_0) x takes the other axes to the tangent space. Beside the
        # sphere it is that of x / |x|: the span must not jump with the sign.
        x = x / jnp.linalg.norm(x)
        w = jnp.asarray(x).at[0].add(jnp.where(x[0] < 0, -1.0, 1.0))
        return (jnp.eye(self.n + 1, dtype=x.dtype) - 2 * jnp.outer(w, w) / (w @ w))[1:]

    def restore(self, x: Array) -> Array:
        return x * (3 - x @ x) / 2

    def violations(self, x: Array) -> dict[str, Array]:
        return {"||x|^2 - 1|": jnp.abs(x @ x - 1)}

    def generators(self, x: Array) -> Array:
        return jnp.asarray(skew_basis(self.n + 1), x.dtype) @ x

    def random_point(self, key: Array) -> Array:
        a = jax.random.normal(key, (self.n + 1,))
        return a / jnp.linalg.norm(a)
