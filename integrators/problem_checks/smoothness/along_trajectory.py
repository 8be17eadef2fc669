"""Jumps of a Hamiltonian that a trajectory passes: the momenta jump there too, and no derivative tells by how much."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array

from ....compute.jit_cache import CHUNK, chunked, compile_function
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....retractions import Retraction
from ....tracing import one_tracing
from .kinks import SMALLEST_JUMP, Zoom, close_in, is_jump
from .step_primitives import find_step_primitives

LARGE_CHUNK = (
    4096  # segments of one call where there are more than of a chunk: two programs, whatever the number of nodes
)
MOST_SEARCHED = 4096  # segments in which a jump is looked for more closely
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
            "momenta jump with it, and those of the trajectory do not; try jnp.tanh(x / a) with a small a in place of "
            "a step"
        )


class Energy(NamedTuple):
    """A Hamiltonian ``H(system, q, p, control)`` with a retraction in whose charts segments are."""

    # Not one of the ``DiscontinuitySearch``, which look at the margins of the steps in a function, at a few places of
    # each: every member of a batch has a result of its own here, and a function with a derivative of its own may
    # compute its steps where no margins are known, as in a loop of unknown length. Values tell of all of them.

    function: Callable[..., Array | None]
    system: Any
    retraction: Retraction

    def passed(self, segments: Segments, apart: bool = False) -> list[PassedJump]:
        """The jumps on these segments, in their order, at most one of each.

        ``apart``: their ends are farther apart than states of one step, and the trajectory may be elsewhere between
        them.
        """
        if not len(jax.tree.leaves(segments.first)[0]):
            return []
        steps = self._steps(segments)
        if not steps:
            return []
        with np.errstate(all="ignore"):
            ends, slopes, sizes = self._ends(segments)
            changes = ends[:, 1] - ends[:, 0]
            share = np.nan_to_num(np.where(sizes > 0, np.abs(changes - slopes.mean(axis=1)) / sizes, 0.0))
            where = np.argsort(share, kind="stable")[::-1][:MOST_SEARCHED]
            where = np.sort(where[share[where] > SMALLEST_JUMP])
            found = self._jumps(segments, where, sizes, steps) if len(where) else []
        return [jump for jump in found if not apart or abs(changes[jump.segment]) > SEEN_BESIDE * abs(jump.change)]

    def _steps(self, segments: Segments) -> list[str]:
        """Names of the steps that the Hamiltonian computes, asked once in a reading."""
        z, u = jax.tree.map(np.zeros_like, vec.taken((segments.first, segments.control), 0))
        method = getattr(self.function, "__func__", self.function)
        with one_tracing() as reading:  # which keeps what has the number that is asked for
            found = reading.once(
                ("steps of", id(method), id(self.system)),
                lambda: (
                    find_step_primitives(lambda q, p: self.function(self.system, q, p, u), *z),
                    method,
                    self.system,
                ),
            )
        return found[0]

    def _jumps(self, segments: Segments, where: np.ndarray, sizes: np.ndarray, steps: list[str]) -> list[PassedJump]:
        """The jumps on the segments with these indices."""
        own, found = vec.taken(segments, where), list[PassedJump]()
        zoom, states, by_clocks = chunked(partial(_closer, *self), *own)
        for k, i in enumerate(where):
            change = float(zoom.changes[k, -1])
            # A time that is a coordinate: only its own momentum jumps, and nothing depends on that.
            in_time = abs(by_clocks[k] - change) < CLOCK_SHARE * abs(change)
            if is_jump(zoom.widths[k], zoom.changes[k], float(sizes[i])) and not in_time:
                state = vec.taken(states, k)
                found.append(PassedJump(int(i), float(zoom.places[k, -1]), change, state, steps))
        return found

    def _ends(self, segments: Segments) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values and slopes at both ends of segments, shape ``(K, 2)``, and the sizes of their terms, ``(K,)``."""
        many = len(jax.tree.leaves(segments.first)[0]) > CHUNK
        return chunked(partial(_ends, *self), *segments, size=LARGE_CHUNK if many else CHUNK)


def _in_one(a: np.ndarray) -> np.ndarray:
    """The two leading axes in one."""
    members, steps, *rest = np.shape(a)
    return np.reshape(a, (members * steps, *rest))


def _along(
    function: Callable[..., Any], system: Any, retraction: Retraction, first: Any, last: Any, control: Any
) -> tuple[Callable[[Array], Array], Callable[[Array], Any]]:
    """The Hamiltonian along a segment, and the state there."""
    way = retraction.preimage(first[0], last[0])

    def state(s: Array) -> Any:
        q = retraction(first[0], vec.scale(s, way))
        return q, retraction.manifold.projection(q, vec.add(vec.scale(1 - s, first[1]), vec.scale(s, last[1])))

    return lambda s: function(system, *state(s), control), state


@compile_function
def _ends(
    function: Callable[..., Any], system: Any, retraction: Retraction, *segments: Any
) -> tuple[Array, Array, Array]:
    """Values and slopes at both ends, and the size of the terms of the values there, because terms may cancel."""

    def one(*segment: Any) -> tuple[Array, Array, Array]:
        value, state = _along(function, system, retraction, *segment)
        values, slopes = jax.vmap(lambda s: jax.jvp(value, (s,), (jnp.ones_like(s),)))(jnp.array([0.0, 1.0]))
        z = state(jnp.ones(()))
        parts = jax.tree.map(
            lambda a, b: jnp.sum(jnp.abs(a * b)), z, jax.grad(lambda z: function(system, *z, segment[-1]))(z)
        )
        return values, slopes, jnp.max(jnp.abs(values)) + sum(jax.tree.leaves(parts))

    return jax.vmap(one)(*segments)


@compile_function
def _closer(
    function: Callable[..., Any], system: Any, retraction: Retraction, *segments: Any
) -> tuple[Zoom, Ambient, Array]:
    """Intervals that close in on where the Hamiltonian changes, of a segment each.

    With the points at their lower ends, and what the Hamiltonian changes by with the clocks alone, the coordinates
    whose rates nothing changes.
    """

    def one(*segment: Any) -> tuple[Zoom, Ambient, Array]:
        value, state = _along(function, system, retraction, *segment)
        zoom = close_in(lambda s: jax.jvp(value, (s,), (jnp.ones_like(s),)), jnp.zeros(()), jnp.ones(()))
        before, after = state(zoom.places[-1]), state(zoom.places[-1] + zoom.widths[-1])
        timed = function(
            system, _clocked(partial(function, system), before, after, segment[-1]), before[1], segment[-1]
        )
        return zoom, before[0], timed - function(system, *before, segment[-1])

    return jax.vmap(one)(*segments)


def _clocked(hamiltonian: Callable[[Ambient, Ambient, Any], Array], before: Any, after: Any, control: Any) -> Ambient:
    """The point before, with the later values of the coordinates whose rates ``dH/dp`` are constant."""
    (q, back), (later, _) = (ravel_pytree(z[0]) for z in (before, after))
    if jnp.iscomplexobj(q):
        return before[0]

    def rates(q: Ambient, p: Ambient, u: Any) -> Array:
        return ravel_pytree(jax.grad(hamiltonian, 1)(q, p, u))[0]

    by_all = jax.tree.leaves(jax.jacfwd(rates, (0, 1, 2))(*before, control))
    steady = jnp.stack([jnp.all(a.reshape(q.size, -1) == 0, axis=1) for a in by_all]).all(axis=0)
    return back(jnp.where(steady, later, q))
