"""Jumps of a Hamiltonian that a trajectory passes: the momenta jump there too, and no derivative tells by how much."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.at_points import evaluate_at_each
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....retractions import Retraction
from ....tracing import one_tracing
from .jumps import JumpSearch
from .step_primitives import find_step_primitives

# Of a jump: what the Hamiltonian changes by, at least, between states that are more than a step apart.
SEEN_BESIDE = 0.5


class Segments(NamedTuple):
    """States at both ends of K segments, ``(q, p)``, and a control between them, None where there is none."""

    first: tuple[Ambient, Ambient]
    last: tuple[Ambient, Ambient]
    control: Any

    @staticmethod
    def between(nodes: tuple[Ambient, Ambient], controls: Any) -> "Segments":
        """From each node to the next one, of trajectories along a leading axis, which are put one behind the other."""
        first, last = (jax.tree.map(_in_one, vec.taken(nodes, part)) for part in (np.s_[:, :-1], np.s_[:, 1:]))
        return Segments(first, last, jax.tree.map(_in_one, controls))


class PassedJump(NamedTuple):
    """A jump: on which segment, by how much, near which state, and what computes it."""

    segment: int
    change: float
    state: Ambient
    steps: list[str]

    def fact(self, where: str) -> str:
        """Words on the jump and its place."""
        q = ", ".join(np.array2string(np.asarray(leaf), precision=6) for leaf in jax.tree.leaves(self.state))
        return (
            f"the Hamiltonian jumps by {self.change:.3g} {where} q = {q}: it computes {' and '.join(self.steps)} from "
            "states, and no derivative tells of the jump"
        )

    def words(self) -> str:
        """The fact for a trajectory, and what can be done about it."""
        return (
            f"{self.fact('where the trajectory passes')}; expected a Hamiltonian without jumps there, because the "
            "momenta jump with it, and those of the trajectory do not; try jnp.tanh(x / a) with a small a instead of "
            "a step, or, for a step in time, integrate until then and from there on, each part with its own Hamiltonian"
        )


class Energy(NamedTuple):
    """A Hamiltonian ``H(system, q, p, control)`` with a retraction in whose charts segments are."""

    function: Callable[..., Any]
    system: Any
    retraction: Retraction

    def find_jumps(self, segments: Segments, apart: bool = False) -> list[PassedJump]:
        """The jumps on these segments, in their order, at most one of each.

        ``apart``: their ends are farther apart than states of one step, and the trajectory may be elsewhere between
        them.
        """
        count = len(jax.tree.leaves(segments.first)[0])
        steps = self._steps(segments) if count else []
        if not steps:
            return []
        search = JumpSearch(self._value, partial(_along, self.retraction), None, vec.taken(segments, 0))
        ends, every = np.tile([0.0, 1.0], (count, 1)), np.ones((count, 1), bool)
        found = search.crossings(None, segments, ends, every)
        if not np.any(found.compared):
            return []
        terms = evaluate_at_each(self._terms, search.points(found.points))
        change, passed = np.diff(found.ends.values[:, :, 0])[:, 0], dict[int, PassedJump]()
        for jump in sorted(search.jumps(found, terms), key=lambda jump: -abs(jump.change)):
            if not apart or abs(change[jump.line]) > SEEN_BESIDE * abs(jump.change):
                passed.setdefault(jump.line, PassedJump(jump.line, jump.change, jump.point[0], steps))
        return [passed[line] for line in sorted(passed)]

    def _value(self, _: None, *point: Any) -> Array:
        return jnp.reshape(self.function(self.system, *point), (1,))

    def _steps(self, segments: Segments) -> list[str]:
        """Names of the steps that the Hamiltonian computes, asked once in a reading."""
        z, u = jax.tree.map(np.zeros_like, vec.taken((segments.first, segments.control), 0))
        method = getattr(self.function, "__func__", self.function)
        search = lambda: find_step_primitives(lambda q, p: self.function(self.system, q, p, u), *z)  # noqa: E731
        with one_tracing() as reading:  # which keeps what has the number that is asked for
            key = "steps of", id(method), id(self.system)
            return reading.once(key, lambda: (search(), method, self.system))[0]

    def _terms(self, point: tuple[Ambient, Ambient, Any]) -> Array:
        """The size of the terms of the Hamiltonian, of which changes may be rounding."""
        *z, u = point
        value, slopes = jax.value_and_grad(lambda z: self.function(self.system, *z, u))(z)
        parts = jax.tree.map(lambda a, b: jnp.sum(jnp.abs(a * b)), z, slopes)
        return jnp.reshape(jnp.abs(value) + sum(jax.tree.leaves(parts)), (1,))


def _in_one(a: np.ndarray) -> np.ndarray:
    """The two leading axes in one."""
    members, steps, *rest = np.shape(a)
    return np.reshape(a, (members * steps, *rest))


def _along(retraction: Retraction, segment: Segments, s: Array) -> tuple[Ambient, Ambient, Any]:
    """The state, the costate and the control at a place of a segment."""
    (first, before), (last, after), control = segment
    q = retraction(first, vec.scale(s, retraction.preimage(first, last)))
    p = retraction.manifold.projection(q, vec.add(vec.scale(1 - s, before), vec.scale(s, after)))
    return q, p, control
