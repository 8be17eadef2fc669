"""Levenberg's method: the one loop of damped Gauss-Newton steps under ``jit``, with its rule of damping."""

from collections.abc import Callable
from typing import NamedTuple, final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import ambient as vec
from .newton import Vector

Equations = Callable[[Vector], Float[Array, " m"]]
Step = Callable[[Float[Array, "m k"], Float[Array, " m"], Array], Vector]


@final
class Damping(NamedTuple):
    """The first damping, the factor by which it falls after a step that is taken and grows after one that is not, and
    the largest one, at which the method ends; ``solved``: the largest equation at which it ends."""

    first: float
    factor: float
    largest: float
    solved: float
    steps: int = 60


def levenberg(equations: Equations, start: Vector, step: Step, damping: Damping) -> tuple[Vector, Float[Array, " m"]]:
    """Where the method ends, and the equations there; ``step``: what is added for a Jacobian, equations and a damping.

    A step that does not make ``|equations|`` less is not taken [Nocedal, Wright 2006, 10.3].
    """

    def once(state: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        x, r, shift, count = state
        tried = x + step(jax.jacfwd(equations)(x), r, shift)
        missed = equations(tried)
        better = missed @ missed < r @ r
        shift = shift * jnp.where(better, 1 / damping.factor, damping.factor)
        return jnp.where(better, tried, x), jnp.where(better, missed, r), shift, count + 1

    def going(state: tuple[Array, Array, Array, Array]) -> Array:
        _, r, shift, count = state
        return (vec.largest(r) > damping.solved) & (shift < damping.largest) & (count < damping.steps)

    first = equations(start)
    if not first.size:
        return start, first
    state = start, first, jnp.asarray(damping.first, start.dtype), jnp.zeros((), int)
    x, r, _, _ = jax.lax.while_loop(going, once, state)
    return x, r
