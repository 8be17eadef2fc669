"""Integration of trajectories by the compiled core."""

import math
from ctypes import byref, c_ssize_t
from typing import NamedTuple, final

import numpy as np

from ...errors import InvalidInputError
from ..threads import in_threads
from ..working_memory import scratch
from .library import BYTES, FLOAT, PLACE, address_of, best_instruction_set, library
from .structs import STEP_ROWS, IntegrationStruct, MethodStruct
from .tape_machine import VECTOR, MachineProgram

MOST_LANES = 64  # trajectories side by side, enough to hide the choice of an instruction
ORDERS = 6  # of the differences by which predictions are corrected
PUSH = 2  # place of the function that has directions


@final
class StepFunction(NamedTuple):
    """A function of a step, with the rows of the memory that it reads and writes."""

    program: MachineProgram
    reads: np.ndarray
    writes: np.ndarray


@final
class StepMethod(NamedTuple):
    """The functions of a substep of a method, and the memory that they share; ``retrax_core.h`` explains them.

    ``functions``: prepare, residual, push and end; ``first``: the first row of each part of the memory, in the order of
    ``retrax_step_rows``; ``unknowns``, ``states``, ``controls``, ``rows``: numbers of rows. The direction stands in the
    rows behind the memory, and derivatives along it in rows of their own, from 0 on.
    """

    functions: tuple[StepFunction, ...]
    first: tuple[int, ...]
    unknowns: int
    states: int
    controls: int
    rows: int

    def require_sound(self) -> None:
        """Raise ``InvalidInputError`` unless all parts of the memory, and all that functions read and write, are within
        it."""
        m = self.unknowns
        sizes = m, 1, self.states, m, m, m, self.states, self.controls, 1
        if m < 1 or any(not 0 <= row <= self.rows - size for row, size in zip(self.first, sizes, strict=True)):
            raise InvalidInputError(
                f"parts of {sizes} rows in a memory of {self.rows} rows, got the first rows {self.first}"
            )
        for k, (program, *both) in enumerate(self.functions):
            ends = (self.rows + m, m) if k == PUSH else (self.rows, self.rows)
            for rows, count, end in zip(both, program.sizes, ends, strict=False):
                if len(rows) != count or (count and not (rows.min() >= 0 and rows.max() < end)):
                    raise InvalidInputError(f"function {k} of a step has {count} rows from 0 to {end - 1}, got {rows}")

    def places(self, k: int, lanes: int) -> tuple[np.ndarray, np.ndarray]:
        """Where the lanes of what a function reads and writes begin, and how far the next lane is."""
        _, reads, writes = self.functions[k]
        points, apart = self.points(lanes)[k], 1 if lanes > 1 or k != PUSH else 0
        steps = np.where(reads < self.rows, apart, 1)
        begins = np.where(reads < self.rows, lanes * reads, lanes * self.rows + points * (reads - self.rows))
        ends = lanes * writes * (self.unknowns if k == PUSH else 1)
        pairs = (begins, steps), (ends, np.ones_like(ends))
        sources, targets = (np.ascontiguousarray(np.stack(pair, axis=1), PLACE) for pair in pairs)
        return sources, targets

    def points(self, lanes: int) -> tuple[int, int, int, int]:
        """The numbers of points at which the functions are evaluated."""
        return lanes, lanes, self.unknowns if lanes == 1 else lanes, lanes


@final
class Integration:
    """Trajectories that begin together, and what the core keeps from step to step.

    ``carry``, shape ``(states + substeps * controls, T)``: states, and controls of the last step; ``step_sizes``, shape
    ``(T,)``; ``parts``: those of a step that its substeps are; ``inverse``: the inverse Jacobian of small steps, or
    None; ``recorded``: rows of the carry that are recorded, the last ones. ``failed``: -1 or the step at which a
    trajectory has stopped.
    """

    def __init__(
        self,
        method: StepMethod,
        carry: np.ndarray,
        step_sizes: np.ndarray,
        parts: np.ndarray,
        inverse: np.ndarray | None,
        recorded: int,
    ) -> None:
        count, substeps, m = len(step_sizes), len(parts), method.unknowns
        shape = method.states + substeps * method.controls, count
        if not (count and substeps and 0 <= recorded <= shape[0]):
            raise InvalidInputError(
                f"{count} trajectories with {substeps} substeps, {recorded} of {shape[0]} rows kept"
            )
        method.require_sound()
        blocks = math.ceil(count / MOST_LANES)
        self._lanes = lanes = 1 if count == 1 else VECTOR * math.ceil(count / (blocks * VECTOR))
        self._blocks = blocks = math.ceil(count / lanes)
        self.failed, self.kept, self._method = np.full(count, -1, PLACE), carry[shape[0] - recorded :], method
        inverses, spent = np.empty((blocks, substeps, m, m, lanes)), np.full((blocks, substeps), np.inf)
        differences = np.zeros((blocks, substeps, ORDERS, m, lanes))
        places = [method.places(k, lanes) for k in range(len(method.functions))]
        self._arrays = step_sizes, carry, inverses, spent, differences, parts, inverse, places  # C reads them
        self._struct = IntegrationStruct(
            count,
            address_of(step_sizes, FLOAT, (count,), "step sizes"),
            address_of(carry, FLOAT, shape, "states of trajectories"),
            address_of(self.failed, PLACE, (count,), "failed steps"),
            *(address_of(a, FLOAT, a.shape, "what is kept from step to step") for a in (inverses, spent, differences)),
            kept=recorded,
        )
        fractions = address_of(parts, FLOAT, (substeps,), "parts of a step")
        small = None if inverse is None else address_of(inverse, FLOAT, (m, m), "inverse Jacobian of small steps")
        sizes = m, method.states, method.controls, method.rows
        self._steps = MethodStruct(lanes, substeps, *sizes, (c_ssize_t * STEP_ROWS)(*method.first), fractions, small)
        for k, pair in enumerate(places):
            own = (address_of(array, PLACE, array.shape, "places of a step") for array in pair)
            self._steps.sources[k], self._steps.targets[k] = own

    def run(self, done: int, steps: int, phase: int, every: int) -> np.ndarray:
        """Make more steps, and return the rows that are recorded after each group of ``every`` steps.

        ``done``: steps made before, of which ``phase`` belong to the first group.
        """
        if done < 0 or steps < 0 or not 0 <= phase < every:
            raise InvalidInputError(f"numbers of steps, and those of a group, got {done}, {steps}, {phase}, {every}")
        record = np.zeros((math.ceil((phase + steps) / every), *self.kept.shape))
        own = self._struct
        own.done, own.steps, own.phase, own.every = done, steps, phase, every
        own.record = address_of(record, FLOAT, record.shape, "record")
        in_threads(self._advance, self._blocks, math.inf)
        return record

    def _advance(self, blocks: range) -> None:
        """Make the steps of some blocks of lanes, with registers and memory of this thread."""
        core, own = library(), MethodStruct.from_buffer_copy(self._steps)
        programs = [function.program for function in self._method.functions]
        points = self._method.points(self._lanes)
        lanes = [1 if count == 1 else program.lanes(count) for program, count in zip(programs, points, strict=True)]
        registers = max(program.sizes[-1] * count for program, count in zip(programs, lanes, strict=True))
        size = core.retrax_integration_workspace(byref(own))
        if not size:
            raise InvalidInputError("the memory of a step exceeds the address space")
        rooms = scratch(((registers,), (size // BYTES,)))
        workspace, best = address_of(rooms[1], FLOAT, rooms[1].shape, "memory of a step"), best_instruction_set()
        contexts = [program.as_function(rooms[0], count, best) for program, count in zip(programs, lanes, strict=True)]
        for k, (function, _) in enumerate(contexts):  # C reads the contexts
            own.functions[k] = function
        core.retrax_integrate(byref(own), byref(self._struct), blocks.start, blocks.stop, workspace)
