"""The rotation group."""

from itertools import combinations
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..manifold import HomogeneousSpace, real
from ..numerics import ambient as vec


def skew_basis(n: int) -> np.ndarray:
    """Basis ``e_i`` of the skew ``n x n`` matrices, shape ``(n(n-1)/2, n, n)``: ``hat`` of the axes for n = 3."""
    planes = [(1, 2), (2, 0), (0, 1)] if n == 3 else list(combinations(range(n), 2))
    out = np.zeros((len(planes), n, n))
    for k, (i, j) in enumerate(planes):
        out[k, j, i], out[k, i, j] = 1.0, -1.0
    return out


def hat(w: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Skew matrix of a vector: ``hat(w) y = w x y``."""
    return jnp.tensordot(w, jnp.asarray(skew_basis(3), w.dtype), 1)


def vee(a: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """Vector of the skew part of a matrix: ``vee(hat(w)) = w``."""
    return jnp.tensordot(jnp.asarray(skew_basis(3) / 2, a.dtype), a, 2)


@final
class SO(HomogeneousSpace):
    """Rotations ``SO(n) = {x : x'x = I, det x = 1}``; points have shape ``(n, n)``, tangent vectors are ``x Omega``, Omega skew.

    The group acts by multiplication from the left. With ``e_i`` the basis of skew matrices (``hat`` of the axes for
    n = 3), ``body_i = <p, x e_i>`` is the left-trivialised covector, ``spatial_i = <p, e_i x>`` the momentum of the action.
    """

    n: int = eqx.field(static=True)

    @property
    def dimension(self) -> int:
        return self.n * (self.n - 1) // 2

    @property
    def ambient(self) -> jax.ShapeDtypeStruct:
        return real((self.n, self.n))

    def skew(self, x: Array, v: Array) -> Array:
        """Left-trivialised tangent vector ``Omega = skew(x'v)``, exactly skew for any ambient ``v``."""
        a = x.T @ v
        return (a - a.T) / 2

    def projection(self, x: Array, a: Array) -> Array:
        return x @ self.skew(x, a)

    def basis(self, x: Array) -> Array:
        return x @ jnp.asarray(skew_basis(self.n) / np.sqrt(2), x.dtype)

    def restore(self, x: Array) -> Array:
        # Newton-Schulz: the polar factor to second order.
        return x @ (3 * jnp.eye(self.n, dtype=x.dtype) - x.T @ x) / 2

    def violations(self, x: Array) -> dict[str, Array]:
        gram = jnp.max(jnp.abs(x.T @ x - jnp.eye(self.n, dtype=x.dtype)))
        return {"max |x'x - I|": gram, "|det x - 1|": jnp.abs(jnp.linalg.det(x) - 1)}

    def generators(self, x: Array) -> Array:
        return jnp.asarray(skew_basis(self.n), x.dtype) @ x

    def body(self, x: Array, p: Array) -> Array:
        """Body covector ``<p, x e_i>``; for n = 3 the vector ``mu`` with ``<p, x hat(w)> = mu . w``."""
        return vec.components(x @ jnp.asarray(skew_basis(self.n), x.dtype), p)

    def spatial(self, x: Array, p: Array) -> Array:
        """Spatial covector ``<p, e_i x>``: the momentum of left multiplication, ``x mu`` for n = 3."""
        return self.momentum(x, p)

    def covector(self, x: Array, mu: Array) -> Array:
        """Ambient covector at ``x`` whose body covector is ``mu``, shape ``(dimension,)``."""
        return x @ jnp.tensordot(mu, jnp.asarray(skew_basis(self.n), x.dtype), 1) / 2

    def random_point(self, key: Array) -> Array:
        q, r = jnp.linalg.qr(jax.random.normal(key, (self.n, self.n)))
        q = q * jnp.where(jnp.diagonal(r) < 0, -1.0, 1.0)
        return q.at[:, 0].multiply(jnp.where(jnp.linalg.det(q) < 0, -1.0, 1.0))
