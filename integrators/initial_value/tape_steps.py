"""The steps of trajectories as programs on the machine of tapes: nothing is compiled for a system."""

import math
import time
from functools import partial
from typing import Any, final

import jax
import numpy as np

from ...compute.core import PARTS_ON_CORE
from ...compute.integration import Integration
from ...compute.jit_cache import call_compiled
from ...compute.threads import in_threads
from ...manifolds.numerics.ambient import Ambient
from ...tape import NotTraceableError, Tape
from ...tape.trace import flat
from .integrator import Integrator
from .interruptible_loop import Steps
from .step_programs import pack, rows, step_programs, unpack
from .xla_steps import Nodes

PARTS = set(PARTS_ON_CORE)
EVALUATIONS = 4  # of the equations of a step
FEW_TRAJECTORIES = 6  # trajectories that are faster one after the other than on lanes side by side


@final
class TracedSteps:
    """The steps of an integrator for a system, and what comes before the first of them, as programs.

    Raises ``NotTraceableError`` where a step cannot be written as scalar instructions.
    """

    def __init__(self, system: Any, integrator: Integrator) -> None:
        from . import step_kernels

        self.kernels, self.system, (self.single, self.parts) = step_kernels, system, integrator.substeps()
        ambient = jax.tree.map(lambda s: np.zeros(s.shape, s.dtype), integrator.manifold.ambient)
        begun = flat(self._begun, (ambient, ambient))
        try:
            self._first = Tape.read(begun)
        except NotTraceableError:  # a control, say, that is found by iteration
            self._first = None
        self.like = begun.zeros()
        self.control = self.single.control(self.like[0])
        y, q, p = self.like
        self.programs = step_programs(self.single, system, y, q, p, self.parts.size)
        stage = self.single.stage(system, 1.0)
        self.inverse = None if stage is None else stage.small_step_inverse()

    def begin(self, starts: tuple[Ambient, Ambient]) -> tuple[Any, Ambient, Ambient]:
        """The unknowns before the first step, points and covectors, with a leading axis."""
        if self._first is None:
            return jax.device_get(call_compiled(_begin_all, self.system, self.single, starts)[0])
        last = self._first(jax.tree.map(lambda a: np.moveaxis(np.asarray(a), 0, -1), starts))
        return jax.tree.map(lambda a: np.moveaxis(a, -1, 0), last)

    def _begun(self, start: tuple[Ambient, Ambient]) -> tuple[Any, Ambient, Ambient]:
        return _begin(self.system, self.single, start)


@final
class TapeSteps(Steps):
    """The steps of ``B`` trajectories: starts with a leading axis, step sizes of shape ``(B,)``."""

    def __init__(self, traced: TracedSteps, starts: tuple[Ambient, Ambient], step_sizes: np.ndarray) -> None:
        self.evaluator = "tape"
        self._step_sizes, self._parts = np.array(step_sizes, float), traced.parts
        self._like, self._control = traced.like, traced.control
        unknowns, q, p = traced.begin(starts)
        count = len(step_sizes)
        controls = pack(traced.single.control(unknowns)) if rows(self._control) else np.zeros((0, count))
        self._carry = np.ascontiguousarray(np.concatenate([pack((unknowns, q, p)), *[controls] * self._parts.size]))
        if "integrate" in PARTS:
            self._core = Integration(traced.programs.method, self._carry, self._step_sizes, np.ascontiguousarray(self._parts.ravel()),
                None if traced.inverse is None else np.ascontiguousarray(traced.inverse, float), len(self._carry) - rows(self._like[0]))
            return
        self._core = None
        self._failed = np.full(count, -1)
        self._workspace = _Workspace(traced, count)

    def kept(self) -> np.ndarray:
        return self._carry[rows(self._like[0]) :].copy()

    def piece(self, done: int, count: int, phase: int, every: int, size: int) -> tuple[np.ndarray, np.ndarray, float]:
        if self._core is not None:
            began = time.perf_counter()
            record = self._core.run(done, count, phase, every)
            return record, self._core.failed.copy(), time.perf_counter() - began
        record = np.zeros((1 + (phase + count - 1) // every, *self.kept().shape))
        began = time.perf_counter()
        numbers = done, count, phase, every
        self._workspace.run(self._carry, self._failed, record, self._parts.ravel(), self._step_sizes, numbers)
        return record, self._failed.copy(), time.perf_counter() - began

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


class _Workspace:
    """Programs and memory of the compiled loops."""

    def __init__(self, traced: TracedSteps, count: int) -> None:
        from .machine_kernels import machine

        kernels, programs, substeps, inverse = traced.kernels, traced.programs, traced.parts.size, traced.inverse
        self._lanes = lanes = 1 if count <= FEW_TRAJECTORIES else kernels.LANES
        blocks, m = -(-count // lanes), programs.unknowns
        self._integrate, self._programs, self._blocks = partial(kernels.integrate, machine()), programs, blocks
        self._points = EVALUATIONS * substeps * lanes * blocks
        inverses, spent = np.zeros((blocks, substeps, m, m, lanes)), np.full((blocks, substeps), np.inf)
        differences = np.zeros((blocks, substeps, kernels.ORDERS, m, lanes))
        small = np.zeros((0, 0)) if inverse is None else np.ascontiguousarray(inverse)
        self._known = inverses, spent, differences, small

    def run(self, carry: np.ndarray, failed: np.ndarray, record: np.ndarray, *numbers: Any) -> None:
        """Integrate over a piece, blocks of lanes side by side on all processors."""
        programs, code = self._programs, self._programs.code
        lists = code.codes, code.operands, code.values, code.ranges, code.reads, code.writes, programs.places
        memory = programs.rows, code.registers, self._lanes, code.native

        def share(blocks: range) -> None:
            self._integrate(*lists, memory, carry, failed, record, self._known, *numbers, (blocks.start, blocks.stop))

        in_threads(share, self._blocks, math.inf)
        programs.ran(self._points * numbers[-1][1])
