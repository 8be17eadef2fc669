"""First guesses of a trajectory."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ...manifolds import DomainError
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...retractions import DiscretizationMap
from ..compilation import call_compiled
from ..initial_value.integrator import resting_control
from ..problem import OptimalControlProblem


class Guess(NamedTuple):
    """A guess for ``solve``: states and controls at the N stages, and costates at the N + 1 nodes (None: zero).

    Leaves carry the stages or nodes along their leading axis.
    """

    states: Ambient
    controls: Any
    costates: Any = None


def default_guess(
    problem: OptimalControlProblem, discretization: DiscretizationMap, start: Ambient, end: Ambient, steps: int
) -> Guess:
    """Guess along the curve of the retraction from start to end, or, outside its image, along a walk towards the end.

    Controls rest, costates are zero. Raises ``DomainError`` if neither curve arrives near the end: the two points are
    opposite to each other, and the user has to say which way round.
    """
    (guess, arrived), *_ = call_compiled(_curve, problem, discretization, start, end, steps)
    if not arrived:
        (guess, arrived), *_ = call_compiled(_walk, problem, discretization, start, end, steps)
    if not arrived:
        raise DomainError(
            "no default guess: the end is opposite to the start (for rotations: half a turn away), so no direction leads "
            "to it; pass a guess, for instance one that goes through a point between them"
        )
    return guess


def _curve(
    problem: OptimalControlProblem, discretization: DiscretizationMap, start: Ambient, end: Ambient, steps: int
) -> tuple[Guess, Array]:
    """Points of ``s -> R(start, s v)``, ``R(start, v) = end``, at the stages; and whether there is such a ``v``."""
    retraction = discretization.retraction
    v = retraction.preimage(start, end)
    times = (jnp.arange(steps) + discretization.theta) / steps
    states = jax.vmap(lambda s: retraction(start, vec.scale(s, v)))(times)
    return _at_rest(problem, states, steps), jnp.isfinite(vec.size(v))


def _walk(
    problem: OptimalControlProblem, discretization: DiscretizationMap, start: Ambient, end: Ambient, steps: int
) -> tuple[Guess, Array]:
    """A walk that covers, at step k of N, the fraction ``1/(N - k)`` of the chord's tangential part; and whether it arrives."""
    manifold, retraction = discretization.manifold, discretization.retraction

    def step(x: Ambient, k: Array) -> tuple[Ambient, Ambient]:
        chord = manifold.projection(x, vec.subtract(end, x))
        ahead = retraction(x, vec.scale(1 / (steps - k), chord))
        return ahead, ahead

    last, states = jax.lax.scan(step, start, jnp.arange(steps))
    arrived = vec.size(vec.subtract(last, end)) < vec.size(vec.subtract(start, end)) / 2
    return _at_rest(problem, states, steps), arrived


def _at_rest(problem: OptimalControlProblem, states: Ambient, steps: int) -> Guess:
    """The guess with given states, resting controls and zero costates."""
    rest = resting_control(problem.controls)
    controls = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (steps, *leaf.shape)), rest)
    costates = jax.tree.map(lambda s: jnp.zeros((steps + 1, *s.shape), s.dtype), problem.manifold.ambient)
    return Guess(states, controls, costates)
