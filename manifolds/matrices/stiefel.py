"""Orthonormal frames."""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..groups.special_orthogonal import skew_basis
from ..manifold import HomogeneousSpace
from ..metric import Metric
from ..numerics import ambient as vec
from ..numerics.errors import InvalidInputError
from ..numerics.frames import complement, qr_factor
from ..numerics.precision import real
from ..numerics.sizes import are_whole, plain


@final
class Stiefel(HomogeneousSpace):
    """Stiefel manifold ``St(n, p) = {x : x'x = I}`` of ``p`` orthonormal columns in ``R^n``; points have shape ``(n,
    p)``.

    Tangent vectors are the ``v`` with ``x'v`` skew. ``St(n, 1)`` is the sphere, ``St(n, n)`` the orthogonal group with
    both its components. Rotations of ``R^n`` act from the left; their momentum is ``J_i = <p, e_i x>``, ``e_i`` the
    basis of skew matrices. The metric is that of the ambient space.
    """

    n: int = eqx.field(static=True, converter=plain)
    p: int = eqx.field(static=True, converter=plain)

    def __check_init__(self) -> None:
        if not are_whole(self.n, self.p) or not 1 <= self.p <= self.n:
            raise InvalidInputError(
                "Stiefel(n, p) holds p orthonormal columns in R^n, whole numbers 1 <= p <= n; "
                f"got n = {self.n!r}, p = {self.p!r}; try Stiefel(3, 2)"
            )

    @property
    def dimension(self) -> int:
        return self.n * self.p - self.p * (self.p + 1) // 2

    @property
    def ambient(self) -> jax.ShapeDtypeStruct:
        return real((self.n, self.p))

    def skew(self, x: Array, v: Array) -> Array:
        """Rotation of the frame in its own span, ``skew(x'v)``, shape ``(p, p)``; exactly skew for any ambient
        ``v``."""
        a = x.T @ v
        return (a - a.T) / 2

    def projection(self, x: Array, a: Array) -> Array:
        m = x.T @ a
        return a - x @ (m + m.T) / 2

    def basis(self, x: Array) -> Array:
        """Rotations of the frame in its span, then turns of each column towards each direction of the complement."""
        inside = x @ jnp.asarray(skew_basis(self.p) / np.sqrt(2), x.dtype)
        outside = jnp.einsum("ni,jk->ijnk", complement(x), jnp.eye(self.p, dtype=x.dtype))
        return jnp.concatenate([inside, outside.reshape(-1, self.n, self.p)])

    def restore(self, x: Array) -> Array:
        # Newton-Schulz: the polar factor to second order.
        return x @ (3 * jnp.eye(self.p, dtype=x.dtype) - x.T @ x) / 2

    def violations(self, x: Array) -> dict[str, Array]:
        return {"max |x'x - I|": vec.size(x.T @ x - jnp.eye(self.p, dtype=x.dtype))}

    def generators(self, x: Array) -> Array:
        return jnp.asarray(skew_basis(self.n), x.dtype) @ x

    def random_point(self, key: Array) -> Array:
        return qr_factor(jax.random.normal(key, (self.n, self.p)))


@final
class CanonicalMetric(Metric):
    """The metric ``g_x(v, w) = tr v'(I - xx'/2) w`` of the frames as a quotient of the rotations.

    A rotation of the frame in its own span counts half as much as in the ambient metric [Edelman, Arias, Smith 1998,
    2.4.1].

    >>> x = jnp.eye(3)[:, :2]
    >>> v = jnp.array([[0.0, -1.0], [1.0, 0.0], [0.0, 0.0]])
    >>> float(CanonicalMetric(Stiefel(3, 2)).inner_product(x, v, v))
    1.0
    """

    manifold: Stiefel

    def inner_product(self, x: Array, v: Array, w: Array) -> Array:
        return jnp.sum(v * w) - jnp.sum((x.T @ v) * (x.T @ w)) / 2

    def kinetic_energy(self, x: Array, p: Array) -> Array:
        p = self.manifold.projection(x, p)
        return (jnp.sum(p * p) + jnp.sum((x.T @ p) ** 2)) / 2
