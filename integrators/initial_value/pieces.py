"""Long integrations outside of JAX's transformations: pieces of one compiled loop, between which Ctrl-C is heard."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...manifolds.numerics.ambient import Ambient
from ..compilation import call_compiled
from .integrator import Integrator

FIRST_PIECE = 8  # steps, before it is known how long one takes
PIECE_SECONDS = 0.1  # what a piece should take: two hundred times its call, and too short to wait for
MOST_GROWTH = 16  # of the number of steps from one piece to the next: the time of a short piece says little
PIECE_NODES, PIECE_BYTES = 4096, 2**22  # the nodes that a piece can keep, fewer if they need more memory than this


class Carry(NamedTuple):
    """What goes from step to step; ``failed_step`` is -1, or the step at which all the rest stopped."""

    q: Ambient
    p: Ambient
    unknowns: Any
    failed_step: Array


class Nodes(NamedTuple):
    """States and stage controls that are kept, along the leading axis of every array, without those of the start."""

    q: Ambient
    p: Ambient
    controls: Any


def begin(system: Any, integrator: Integrator, start: tuple[Ambient, Ambient]) -> Carry:
    """What the first step starts from."""
    q0, p0 = start[0], integrator.manifold.projection(*start)
    return Carry(q0, p0, integrator.begin(system, q0, p0), jnp.array(-1))


def advance(system: Any, integrator: Integrator, step_size: Array, carry: Carry, index: Array) -> Carry:
    """One step further; from the first step on that is not solved, no further."""
    new = integrator.step(system, step_size, carry.q, carry.p, carry.unknowns)
    good = new.converged & (carry.failed_step < 0)
    moved = Carry(new.q, new.p, new.unknowns, carry.failed_step)
    stopped = carry._replace(failed_step=jnp.where(carry.failed_step < 0, index, carry.failed_step))
    return jax.tree.map(lambda a, b: jnp.where(good, a, b), moved, stopped)


def node(integrator: Integrator, carry: Carry) -> Nodes:
    """What is kept of a step."""
    return Nodes(carry.q, carry.p, integrator.control(carry.unknowns))


def _piece(
    system: Any, integrator: Integrator, first: Carry, step_size: Array, size: int, count: Array, phase: Array, every: Array
) -> tuple[Carry, Nodes]:
    """``count`` steps, or as many as are solved; the state after the last step of each block of ``every`` steps in its row.

    ``phase`` is how many steps of a block lie behind. There are ``size`` rows; that of an unfinished block has its last state.
    """

    def unfinished(state: tuple[Array, Carry, Nodes]) -> Array:
        index, carry, _ = state
        return (index < count) & (carry.failed_step < 0)

    def step(state: tuple[Array, Carry, Nodes]) -> tuple[Array, Carry, Nodes]:
        index, carry, rows = state
        carry = advance(system, integrator, step_size, carry, index)
        row = (phase + index) // every
        put = jax.tree.map(lambda a, b: jax.lax.dynamic_update_index_in_dim(a, b, row, 0), rows, node(integrator, carry))
        return index + 1, carry, put

    rows = jax.tree.map(lambda a: jnp.zeros((size, *jnp.shape(a)), a.dtype), node(integrator, first))
    _, last, rows = jax.lax.while_loop(unfinished, step, (jnp.zeros_like(count), first, rows))
    return last, rows


class Outcome(NamedTuple):
    """What a run came to: its nodes in NumPy arrays, with the start; the failed step or -1; what interrupted it."""

    nodes: Nodes
    failed_step: int
    interrupt: KeyboardInterrupt | None


def run(system: Any, integrator: Integrator, start: tuple[Ambient, Ambient], step_size: Array, saves: int, every: int) -> Outcome:
    """Integrate over ``saves`` blocks of ``every`` steps, piece after piece. If interrupted, the nodes are those reached."""
    carry: Carry = call_compiled(begin, system, integrator, start)[0]
    first = node(integrator, carry)
    q, p = jax.tree.map(lambda a: np.empty((saves + 1, *a.shape), a.dtype), (first.q, first.p))
    controls = jax.tree.map(lambda a: np.empty((saves, *a.shape), a.dtype), first.controls)
    nodes, ends = Nodes(q, p, controls), jax.tree.map(lambda a: a[1:], (q, p))
    later = Nodes(ends[0], ends[1], controls)
    _put((q, p), slice(0, 1), (first.q, first.p))
    size = min(PIECE_NODES, max(1, PIECE_BYTES // max(1, sum(leaf.nbytes for leaf in jax.tree.leaves(first)))))
    done, count, total = 0, FIRST_PIECE, saves * every
    try:
        while done < total:
            row, phase = divmod(done, every)
            count = min(count, total - done, size * every - phase)
            numbers = [jnp.asarray(n) for n in (count, phase, every)]
            (carry, rows), _, seconds = call_compiled(_piece, system, integrator, carry, step_size, size, *numbers)
            failed = int(carry.failed_step)
            known = 1 + (phase + (count - 1 if failed < 0 else failed)) // every
            _put(later, slice(row, row + known), jax.tree.map(lambda a, n=known: a[:n], jax.device_get(rows)))
            if failed >= 0:
                _put(later, slice(row + known, None), node(integrator, carry))
                return Outcome(nodes, done + failed, None)
            done += count
            count = 1 + int(count * min(MOST_GROWTH, PIECE_SECONDS / max(seconds, 1e-9)))
    except KeyboardInterrupt as interrupt:
        reached = done // every
        q, p = jax.tree.map(lambda a: a[: reached + 1], (q, p))
        return Outcome(Nodes(q, p, jax.tree.map(lambda a: a[:reached], controls)), -1, interrupt)
    return Outcome(nodes, -1, None)


def _put(arrays: Any, where: slice, values: Any) -> None:
    """Write values into a part of NumPy arrays."""
    for array, value in zip(jax.tree.leaves(arrays), jax.tree.leaves(values), strict=True):
        array[where] = value
