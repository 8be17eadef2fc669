"""Levenberg's method: the loop of damped Gauss-Newton steps under ``jit``, and the rule of damping of all such
loops."""

from collections.abc import Callable
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import ambient as vec
from .chord_newton import Vector

Equations = Callable[[Vector], Float[Array, " m"]]
Step = Callable[[Float[Array, "m k"], Float[Array, " m"], Array], Vector]


MOST_TRIALS = 60  # steps that are tried


@final
class Damping(NamedTuple):
    """The rule for the damping of steps.

    Damping falls by a factor after an accepted step, from ``least`` or below to zero. It grows by a factor after a
    rejected step, from zero to ``least``; beyond ``largest`` a method ends.
    """

    grows: float
    falls: float
    first: float = 0.0
    least: float = 0.0
    largest: float = float("inf")

    def after(self, damping: Any, better: Any) -> Any:
        """The damping after a step that was ``better``, and taken, or not: numbers, or arrays of NumPy or JAX."""
        fallen = damping / self.falls * (damping > self.least)
        grown = damping * self.grows + self.least * (damping == 0)
        return better * fallen + (1 - better) * grown


APPROACH = Damping(grows=4.0, falls=4.0, first=0.1)  # of squares of singular values
RELATIVE_DAMPING = Damping(grows=10.0, falls=10.0, least=1e-4, largest=1e2)  # in units of the largest singular value
SHORTENING = Damping(grows=2.0, falls=float("inf"), least=2.0, largest=1e3)  # what a step is divided by, zero for one


def levenberg(
    equations: Equations, start: Vector, step: Step, damping: Damping, solved: float
) -> tuple[Vector, Float[Array, " m"]]:
    """Where the method ends, and the equations there, the largest of which is not above ``solved`` where it arrives.

    ``step``: what is added for a Jacobian, equations and a damping.

    A step that does not make ``|equations|`` less is not taken [Nocedal, Wright 2006, 10.3].
    """

    def once(state: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        x, r, shift, count = state
        tried = x + step(jax.jacfwd(equations)(x), r, shift)
        missed = equations(tried)
        better = missed @ missed < r @ r
        return jnp.where(better, tried, x), jnp.where(better, missed, r), damping.after(shift, better), count + 1

    def going(state: tuple[Array, Array, Array, Array]) -> Array:
        _, r, shift, count = state
        return (vec.largest(r) > solved) & (shift <= damping.largest) & (count < MOST_TRIALS)

    first = equations(start)
    if not first.size:
        return start, first
    state = start, first, jnp.asarray(damping.first, start.dtype), jnp.zeros((), int)
    x, r, _, _ = jax.lax.while_loop(going, once, state)
    return x, r
