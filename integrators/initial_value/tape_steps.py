"""The steps of trajectories as programs on the machine of tapes: nothing is compiled for a system."""

import time
from functools import partial
from typing import Any, final

import jax
import numpy as np

from ...compute.binding.integration import Integration
from ...compute.jit_cache import compile_and_call
from ...manifolds.numerics.ambient import Ambient
from ...tape import NotTraceableError, Tape
from ...tape.trace import flat
from .integrator import Integrator
from .interruptible_loop import Steps
from .step_programs import pack, rows, step_programs, unpack
from .xla_steps import Nodes


@final
class TracedSteps:
    """The steps of an integrator for a system, and what comes before the first of them, as programs.

    Raises ``NotTraceableError`` where a step cannot be written as scalar instructions.
    """

    def __init__(self, system: Any, integrator: Integrator) -> None:
        self.system, (self.single, self.parts) = system, integrator.substeps()
        ambient = jax.tree.map(lambda s: np.zeros(s.shape, s.dtype), integrator.manifold.ambient)
        begun = flat(self._begin_one, (ambient, ambient))
        try:
            self._first = Tape.read(begun)
        except NotTraceableError:  # a control, say, that is found by iteration
            self._first = None
        self.like = begun.zeros()
        self.control = self.single.control(self.like[0])
        y, q, p = self.like
        self.method = step_programs(self.single, system, y, q, p)
        stage = self.single.stage(system, 1.0)
        inverse = None if stage is None else stage.small_step_inverse()
        self.inverse = None if inverse is None else np.array(inverse, float)

    def begin(self, starts: tuple[Ambient, Ambient]) -> tuple[Any, Ambient, Ambient]:
        """The unknowns before the first step, points and covectors, with a leading axis."""
        if self._first is None:
            return jax.device_get(compile_and_call(_begin_all, self.system, self.single, starts)[0])
        last = self._first(jax.tree.map(lambda a: np.moveaxis(np.asarray(a), 0, -1), starts))
        return jax.tree.map(lambda a: np.moveaxis(a, -1, 0), last)

    def _begin_one(self, start: tuple[Ambient, Ambient]) -> tuple[Any, Ambient, Ambient]:
        return _begin(self.system, self.single, start)


@final
class TapeSteps(Steps):
    """The steps of ``B`` trajectories: starts with a leading axis, step sizes of shape ``(B,)``."""

    def __init__(self, traced: TracedSteps, starts: tuple[Ambient, Ambient], step_sizes: np.ndarray) -> None:
        self.evaluator = "tape"
        self._parts, self._like, self._control = traced.parts, traced.like, traced.control
        unknowns, q, p = traced.begin(starts)
        controls = pack(traced.single.control(unknowns)) if rows(self._control) else np.zeros((0, len(step_sizes)))
        carry = np.ascontiguousarray(np.concatenate([pack((unknowns, q, p)), *[controls] * self._parts.size]))
        kept = len(carry) - rows(self._like[0])
        sizes, parts = np.array(step_sizes, float), np.array(self._parts, float).ravel()
        self._integration = Integration(traced.method, carry, sizes, parts, traced.inverse, kept)

    def kept_values(self) -> np.ndarray:
        return self._integration.kept.copy()

    def piece(self, done: int, count: int, phase: int, every: int, size: int) -> tuple[np.ndarray, np.ndarray, float]:
        began = time.perf_counter()
        record = self._integration.run(done, count, phase, every)
        return record, self._integration.failed.copy(), time.perf_counter() - began

    def nodes(self, kept: np.ndarray) -> Nodes:
        """States of all nodes, the start first, and controls of the steps, with leading axes ``(trajectories,
        nodes)``."""
        _, q, p = self._like
        ends = np.cumsum([0, rows(q), rows(p)])
        points, covectors = (unpack(kept[:, a:b], like) for a, b, like in zip(ends, ends[1:], (q, p), strict=False))
        later = kept[1:, ends[-1] :]
        controls = later.reshape(len(later) * self._parts.size, rows(self._control), kept.shape[-1])
        shape = kept.shape[-1], len(later), *self._parts.shape
        each = jax.tree.map(lambda a: a.reshape(*shape, *a.shape[2:]), unpack(controls, self._control))
        return Nodes(points, covectors, each)


def _begin(system: Any, integrator: Integrator, start: tuple[Ambient, Ambient]) -> tuple[Any, Ambient, Ambient]:
    q, p = start[0], integrator.manifold.projection(*start)
    return integrator.begin(system, q, p), q, p


def _begin_all(system: Any, integrator: Integrator, starts: tuple[Ambient, Ambient]) -> tuple[Any, Ambient, Ambient]:
    return jax.vmap(partial(_begin, system, integrator))(starts)
