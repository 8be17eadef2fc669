"""The steps of one trajectory as a loop that XLA compiles, and one step of it."""

from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...compute.jit_cache import compile_and_call, optimize_and_call
from ...manifolds.numerics.ambient import Ambient
from .integrator import Integrator
from .interruptible_loop import Steps


class Carry(NamedTuple):
    """The values that go from step to step; ``failed_step`` is -1, or the step after which no step runs."""

    q: Ambient
    p: Ambient
    unknowns: Any
    failed_step: Array


class Nodes(NamedTuple):
    """The kept states and stage controls, along the leading axis of every array, without the start."""

    q: Ambient
    p: Ambient
    controls: Any


def begin(system: Any, integrator: Integrator, start: tuple[Ambient, Ambient]) -> Carry:
    """The values before the first step."""
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
    """The kept values of a step."""
    return Nodes(carry.q, carry.p, integrator.control(carry.unknowns))


def _piece(
    system: Any,
    integrator: Integrator,
    first: Carry,
    step_size: Array,
    size: int,
    count: Array,
    phase: Array,
    every: Array,
) -> tuple[Carry, Nodes]:
    """``count`` steps, or as many as are solved; the state after the last step of each block of ``every`` steps in its
    row.

    ``phase`` is how many steps of a block lie behind. There are ``size`` rows; that of an unfinished block has its last
    state.
    """

    def is_unfinished(state: tuple[Array, Carry, Nodes]) -> Array:
        index, carry, _ = state
        return (index < count) & (carry.failed_step < 0)

    def step(state: tuple[Array, Carry, Nodes]) -> tuple[Array, Carry, Nodes]:
        index, carry, rows = state
        carry = advance(system, integrator, step_size, carry, index)
        row = (phase + index) // every
        put = jax.tree.map(
            lambda a, b: jax.lax.dynamic_update_index_in_dim(a, b, row, 0), rows, node(integrator, carry)
        )
        return index + 1, carry, put

    rows = jax.tree.map(lambda a: jnp.zeros((size, *jnp.shape(a)), a.dtype), node(integrator, first))
    _, last, rows = jax.lax.while_loop(is_unfinished, step, (jnp.zeros_like(count), first, rows))
    return last, rows


@final
class XlaSteps(Steps):
    """The steps of one trajectory, compiled by XLA."""

    def __init__(
        self, system: Any, integrator: Integrator, start: tuple[Ambient, Ambient], step_size: Array, reason: str
    ) -> None:
        self.evaluator = f"XLA: {reason}"
        self._system, self._integrator, self._step_size = system, integrator, step_size
        self._carry: Carry = compile_and_call(begin, system, integrator, start)[0]

    def kept_values(self) -> Nodes:
        return jax.device_get(node(self._integrator, self._carry))

    def piece(self, done: int, count: int, phase: int, every: int, size: int) -> tuple[Nodes, np.ndarray, float]:
        numbers = [jnp.asarray(n) for n in (count, phase, every)]
        arguments = self._system, self._integrator, self._carry, self._step_size, size, *numbers
        (self._carry, rows), _, seconds = optimize_and_call(_piece, *arguments)
        failed = np.asarray(self._carry.failed_step)
        return jax.device_get(rows), np.where(failed < 0, -1, done + failed), seconds
