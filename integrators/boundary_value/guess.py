"""First guesses of a trajectory."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...manifolds import DomainError
from ...manifolds.manifold import default_tolerance
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...retractions import DiscretizationMap, Retraction, default_retraction
from ..compilation import call_compiled
from ..evaluation import at_each
from ..problem import OptimalControlProblem, resting_control
from ..records import shapes

ASIDE = 0.05  # of the chord
UNEVEN = 2.0  # times the mean step: the Cayley map takes most of a turn by nearly 180 degrees in its first steps


class Guess(NamedTuple):
    """A guess for ``solve``: states and controls at the N stages, and costates at the N + 1 nodes (None: zero).

    Leaves carry the stages or nodes along their leading axis.
    """

    states: Ambient
    controls: Any
    costates: Any = None

    def __repr__(self) -> str:
        return f"Guess(states={shapes(self.states)}, controls={shapes(self.controls)}, costates={shapes(self.costates)})"


def default_guess(
    problem: OptimalControlProblem, discretization: DiscretizationMap, start: Ambient, end: Ambient, steps: int
) -> Guess:
    """Guess along the curve of a retraction from start to end, or, outside its image, a walk to the end.

    The retraction is the discretization's own; where its curve does not arrive, or in very unequal steps, the default one of the
    manifold. Where the two points are opposite to each other, as attitudes half a turn apart, the walk sets out
    in a direction that is random but always the same: there are several ways round, and this is one of them. Controls rest,
    costates are zero. Raises ``DomainError`` if no curve arrives near the end.
    """
    given = discretization.retraction
    fractions = (np.arange(steps) + float(discretization.theta)) / steps
    for retraction in (given, default_retraction(problem.manifold)):
        states, lengths = at_each(partial(_on_curve, retraction), fractions, start, end)
        if np.all(np.isfinite(lengths)) and all(_is_even(leaf.reshape(steps, -1)) for leaf in jax.tree.leaves(states)):
            return _at_rest(problem, states, steps)
    states, arrived = call_compiled(_walk, given, start, end, steps)[0]
    if arrived:
        return _at_rest(problem, states, steps)
    raise DomainError(
        "no default guess: the walk from start to end does not arrive; pass a guess that goes through points between"
    )


def _on_curve(retraction: Retraction, s: Array, start: Ambient, end: Ambient) -> tuple[Ambient, Array]:
    """The point ``R(start, s v)``, ``R(start, v) = end``, and the length of ``v``."""
    v = retraction.preimage(start, end)
    return retraction(start, vec.scale(s, v)), vec.size(v)


def _is_even(points: np.ndarray) -> bool:
    """Whether the largest step between points, shape ``(steps, entries)``, is no more than ``UNEVEN`` mean ones."""
    lengths = np.linalg.norm(points[1:] - points[:-1], axis=1)
    rounding = default_tolerance() * np.max(np.abs(points), initial=0.0)
    return bool(np.max(lengths, initial=0.0) <= UNEVEN * np.sum(lengths) / max(len(lengths), 1) + rounding)


def _walk(retraction: Retraction, start: Ambient, end: Ambient, steps: int) -> tuple[Ambient, Array]:
    """A walk along the chord's tangential part, at step k of N the fraction ``1/(N - k)`` of its length; and whether it arrives.

    It begins a little beside the start, because the chord to an opposite point has no tangential part.
    """
    manifold = retraction.manifold
    chord = vec.subtract(end, start)
    aside = manifold.random_tangent(jax.random.key(0), start)
    aside = manifold.projection(start, jax.tree.map(lambda a, c: ASIDE * vec.size(c) * a, aside, chord))

    def as_long(v: Array, chord: Array) -> Array:
        length = jnp.linalg.norm(v)
        return jnp.where(length > 0, jnp.linalg.norm(chord) / jnp.where(length > 0, length, 1.0), 0.0) * v

    def step(x: Ambient, k: Array) -> tuple[Ambient, Ambient]:
        chord = vec.subtract(end, x)
        along = manifold.projection(x, jax.tree.map(as_long, manifold.projection(x, chord), chord))
        ahead = retraction(x, vec.scale(1 / (steps - k), along))
        return ahead, ahead

    last, states = jax.lax.scan(step, retraction(start, aside), jnp.arange(steps))
    arrived = vec.size(vec.subtract(last, end)) < vec.size(chord) / 2
    return states, arrived


def _at_rest(problem: OptimalControlProblem, states: Ambient, steps: int) -> Guess:
    """The guess with given states, resting controls and zero costates."""
    rest = resting_control(problem.controls)
    controls = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (steps, *leaf.shape)), rest)
    costates = jax.tree.map(lambda s: jnp.zeros((steps + 1, *s.shape), s.dtype), problem.manifold.ambient)
    return Guess(states, controls, costates)
