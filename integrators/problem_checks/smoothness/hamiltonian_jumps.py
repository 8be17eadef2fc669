"""Jumps of a Hamiltonian that a trajectory passes: the momenta jump there too, and no derivative tells by how much."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array

from ....compute.jit_cache import call_in_chunks, compile_function
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....retractions import Retraction
from ....tracing import one_tracing
from .jumps import SMALLEST_JUMP, Jump, JumpSearch
from .step_primitives import find_step_primitives

CLOCK_SHARE = 0.1  # of a jump: what the clocks alone may leave of it
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
    """A jump: in which segment, where in it, by how much, between which states, and what computes it."""

    segment: int
    place: float
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
            "a step"
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
        ends = np.tile([0.0, 1.0], (count, 1))
        seen = search.at(None, segments, ends)
        found = search.crossings(None, segments, ends, seen, np.ones(seen.margins.shape[::2], bool))
        # In the order of segments, and in each the largest one first; what is rounding is told below.
        jumps = sorted(search.jumps(found, np.zeros(1)), key=lambda jump: (jump.line, -abs(jump.change)))
        change = np.diff(seen.values[:, :, 0], axis=1)[:, 0]
        jumps = [jump for jump in jumps if not apart or abs(change[jump.line]) > SEEN_BESIDE * abs(jump.change)]
        passed = {jump.line: jump for jump in reversed(self._significant_jumps(segments, jumps))}
        return [PassedJump(k, jump.place, jump.change, jump.point[0], steps) for k, jump in sorted(passed.items())]

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

    def _significant_jumps(self, segments: Segments, jumps: list[Jump]) -> list[Jump]:
        """The jumps that are no rounding of the terms of the Hamiltonian, and of which the trajectory feels."""
        if not jumps:
            return []
        places = np.array([[jump.place - jump.distance, jump.place + jump.distance] for jump in jumps])
        own = vec.taken(segments, [jump.line for jump in jumps])
        sizes, by_clocks = call_in_chunks(partial(_terms, *self), own, places)
        changes = np.array([jump.change for jump in jumps])
        # A time that is a coordinate: only its own momentum jumps, and nothing depends on that.
        in_time = np.abs(by_clocks - changes) < CLOCK_SHARE * np.abs(changes)
        felt = (np.abs(changes) > SMALLEST_JUMP * sizes) & ~in_time
        return [jump for jump, one in zip(jumps, felt, strict=True) if one]


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


@compile_function
def _terms(
    function: Callable[..., Any], system: Any, retraction: Retraction, segments: Segments, places: Array
) -> tuple[Array, Array]:
    """The sizes of the terms of the Hamiltonian at the first of two places of segments, and its change by the clocks.

    The clocks are the coordinates whose rates ``dH/dp`` nothing changes.
    """

    def one(segment: Segments, places: Array) -> tuple[Array, Array]:
        (*z, u), (later, *_) = (_along(retraction, segment, s) for s in places)
        value, slopes = jax.value_and_grad(lambda z: function(system, *z, u))(z)
        parts = jax.tree.map(lambda a, b: jnp.sum(jnp.abs(a * b)), z, slopes)
        timed = function(system, _advance_clocks(partial(function, system), z, later, u), z[1], u)
        return jnp.abs(value) + sum(jax.tree.leaves(parts)), timed - value

    return jax.vmap(one)(segments, places)


def _advance_clocks(hamiltonian: Callable[..., Array], state: Any, later: Ambient, control: Any) -> Ambient:
    """The point of a state, with the later values of the clocks."""
    (q, back), (after, _) = (ravel_pytree(point) for point in (state[0], later))
    if jnp.iscomplexobj(q):
        return state[0]

    def rates(q: Ambient, p: Ambient, u: Any) -> Array:
        return ravel_pytree(jax.grad(hamiltonian, 1)(q, p, u))[0]

    by_all = jax.tree.leaves(jax.jacfwd(rates, (0, 1, 2))(*state, control))
    steady = jnp.stack([jnp.all(a.reshape(q.size, -1) == 0, axis=1) for a in by_all]).all(axis=0)
    return back(jnp.where(steady, after, q))
