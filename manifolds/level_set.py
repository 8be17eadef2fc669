"""A manifold from one constraint function."""

from abc import abstractmethod
from math import prod

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .manifold import Manifold, default_tolerance, real
from .numerics.root import solve_small

RANDOM_STARTS = 20
GAUSS_NEWTON_STEPS = 30


class LevelSet(Manifold):
    """Regular level set ``{x : c(x) = 0}`` of a smooth function of arrays of one shape.

    Subclass it with ``constraint``; the tangent spaces, projections, random points and checks follow by automatic
    differentiation. The equations must be independent: where the Jacobian of ``c`` loses rank there is no manifold.
    """

    shape: tuple[int, ...] = eqx.field(static=True, converter=lambda s: (s,) if isinstance(s, int) else tuple(s))

    @abstractmethod
    def constraint(self, x: Array) -> Array:
        """Constraint ``c(x)``, any shape: zero on the manifold, smooth around it."""

    def equations(self, x: Array) -> Float[Array, " m"]:
        """The constraint as a vector of ``m`` equations."""
        return jnp.ravel(self.constraint(x))

    def jacobian(self, x: Array) -> Float[Array, "m N"]:
        """Jacobian of the equations with respect to the entries of ``x``, one row an equation."""
        return jax.jacrev(self.equations)(x).reshape(-1, prod(self.shape))

    @property
    def dimension(self) -> int:
        m = jax.eval_shape(self.equations, self.ambient).size
        return prod(self.shape) - m

    @property
    def ambient(self) -> jax.ShapeDtypeStruct:
        return real(self.shape)

    def projection(self, x: Array, a: Array) -> Array:
        j = self.jacobian(x)
        return a - (j.T @ solve_small(j @ j.T, j @ a.reshape(-1))).reshape(self.shape)

    def basis(self, x: Array) -> Array:
        j = self.jacobian(x)
        return jnp.linalg.qr(j.T, mode="complete")[0].T[j.shape[0] :].reshape(-1, *self.shape)

    def restore(self, x: Array) -> Array:
        j = self.jacobian(x)
        return x - (j.T @ solve_small(j @ j.T, self.equations(x))).reshape(self.shape)

    def violations(self, x: Array) -> dict[str, Array]:
        singular = jnp.linalg.svd(self.jacobian(x), compute_uv=False)
        lost = jnp.sum(singular <= default_tolerance() * singular[0])
        return {"max |constraint|": jnp.max(jnp.abs(self.equations(x))), "rank lost by the constraint's Jacobian": lost}

    def random_point(self, key: Array) -> Array:
        """A random ambient point moved to the level set by least squares; an error if 20 draws find none."""

        def draw(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            key, _, tries = state
            key, sub = jax.random.split(key)
            start = jax.random.normal(sub, self.shape)
            return key, jax.lax.fori_loop(0, GAUSS_NEWTON_STEPS, lambda _, x: self.restore(x), start), tries + 1

        def off(state: tuple[Array, Array, Array]) -> Array:
            _, x, tries = state
            return (tries < RANDOM_STARTS) & ~(jnp.max(jnp.abs(self.equations(x))) <= default_tolerance())

        nowhere = jnp.full(self.shape, jnp.nan, self.ambient.dtype)
        state = jax.lax.while_loop(off, draw, (key, nowhere, jnp.zeros((), int)))
        message = f"no point of {self} was found from {RANDOM_STARTS} random starts; check the constraint"
        return eqx.error_if(state[1], off((state[0], state[1], jnp.zeros((), int))), message)
