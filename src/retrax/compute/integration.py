"""Integration of trajectories by the compiled core."""

import math
from ctypes import addressof, byref, c_ssize_t, c_void_p, cast, pointer
from typing import NamedTuple, final

import numpy as np

from ..aligned import scratch
from ..errors import InvalidInputError
from .core import (
    BYTES,
    FLOAT,
    PLACE,
    STEP_FUNCTIONS,
    STEP_ROWS,
    FunctionStruct,
    IntegrationStruct,
    MethodStruct,
    TapeFunctionStruct,
    address_of,
    best_instruction_set,
    library,
)
from .tape_machine import MachineProgram
from .threads import in_threads

MOST_LANES = 64  # enough to hide the choice of an instruction
VECTOR = 8  # lanes are a multiple of it where there are several
ORDERS = 6  # of the differences by which predictions are corrected
PUSH = 2


@final
class StepFunction(NamedTuple):
    """A function of a step, with the rows of the memory that it reads and writes."""

    program: MachineProgram
    reads: np.ndarray
    writes: np.ndarray


@final
class StepMethod(NamedTuple):
    """The functions of the substeps of a method, and the sizes and rows of the memory that they share.

    ``functions``: prepare, residual, push and end; ``first``: the first row of each part of the memory, in the order of
    ``retrax_step_rows``. Directions stand in the rows behind the last one; derivatives are written to rows of their
    own, 0 to ``unknowns - 1``.
    """

    functions: tuple[StepFunction, StepFunction, StepFunction, StepFunction]
    first: tuple[int, ...]
    unknowns: int
    states: int
    controls: int
    rows: int


@final
class Integration:
    """Trajectories that begin together.

    ``carry``, shape ``(states + substeps * controls, T)``: states, and controls of the last step; ``step_sizes``, shape
    ``(T,)``; ``parts``: those of a step that its substeps are; ``inverse``: the inverse Jacobian of small steps, or
    None; ``kept``: the rows of the carry that are recorded, the last ones. ``failed``: -1 or the step at which a
    trajectory has stopped.
    """

    def __init__(
        self,
        method: StepMethod,
        carry: np.ndarray,
        step_sizes: np.ndarray,
        parts: np.ndarray,
        inverse: np.ndarray | None,
        kept: int,
    ) -> None:
        count, m, substeps = len(step_sizes), method.unknowns, len(parts)
        shape = method.states + substeps * method.controls, count
        self.blocks = math.ceil(count / MOST_LANES)
        self.lanes = 1 if count == 1 else VECTOR * math.ceil(count / (self.blocks * VECTOR))
        self.blocks = math.ceil(count / self.lanes)
        self.carry, self.failed, self._method = carry, np.full(count, -1), method
        steady = np.empty((self.blocks, substeps, m, m, self.lanes)), np.full((self.blocks, substeps), np.inf)
        differences = np.zeros((self.blocks, substeps, ORDERS, m, self.lanes))
        self._arrays = step_sizes, parts, inverse, *steady, differences
        if not 0 <= kept <= shape[0]:
            raise InvalidInputError(f"{shape[0]} rows are carried, got {kept} that are kept")
        self._kept = kept
        self._struct = IntegrationStruct(
            count,
            address_of(step_sizes, FLOAT, (count,), "step sizes"),
            address_of(carry, FLOAT, shape, "states of trajectories"),
            address_of(self.failed, PLACE, (count,), "failed steps"),
            *(address_of(a, FLOAT, a.shape, "what is kept from step to step") for a in (*steady, differences)),
        )
        self._places = [self._places_of(k, own) for k, own in enumerate(method.functions)]
        self._shared = MethodStruct(
            self.lanes,
            substeps,
            m,
            method.states,
            method.controls,
            method.rows,
            (c_ssize_t * STEP_ROWS)(*self._first()),
            address_of(parts, FLOAT, (substeps,), "parts of a step"),
            None if inverse is None else address_of(inverse, FLOAT, (m, m), "inverse Jacobian of small steps"),
        )
        for k, (sources, targets) in enumerate(self._places):
            self._shared.sources[k], self._shared.targets[k] = (
                address_of(own, PLACE, own.shape, "places of a step") for own in (sources, targets)
            )

    def _first(self) -> tuple[int, ...]:
        """The first rows; raises unless each part of the memory is within it."""
        own, m = self._method, self._method.unknowns
        sizes = m, 1, own.states, m, m, m, own.states, own.controls, 1
        if m < 1 or any(not 0 <= row <= own.rows - size for row, size in zip(own.first, sizes, strict=True)):
            raise InvalidInputError(f"parts of {sizes} rows of a memory of {own.rows} rows, got first rows {own.first}")
        return own.first

    @property
    def _points(self) -> tuple[int, int, int, int]:
        """The numbers of points at which the functions are evaluated."""
        lanes = self.lanes
        return lanes, lanes, self._method.unknowns if lanes == 1 else lanes, lanes

    def _places_of(self, k: int, function: StepFunction) -> tuple[np.ndarray, np.ndarray]:
        """The places of the lanes of what a function reads and writes; raises unless these are in its memory."""
        own, lanes, (program, reads, writes) = self._method, self.lanes, function
        points, push = self._points[k], k == PUSH
        behind, written = (own.rows + own.unknowns, own.unknowns) if push else (own.rows, own.rows)
        inputs, outputs, _ = program.sizes
        for of, rows, many, end in (("reads", reads, inputs, behind), ("writes", writes, outputs, written)):
            if len(rows) != many or (rows.size and not (rows.min() >= 0 and rows.max() < end)):
                raise InvalidInputError(f"a function of a step {of} {many} rows from 0 to {end - 1}, got {rows}")
        beyond, end = reads >= own.rows, own.rows * lanes
        places = np.where(beyond, end + (reads - own.rows) * points, reads * lanes)
        sources = np.stack([places, np.where(beyond | (lanes > 1) | (not push), 1, 0)], axis=1).astype(PLACE)
        targets = np.stack([writes * lanes * (own.unknowns if push else 1), np.ones_like(writes)], axis=1).astype(PLACE)
        return sources, targets

    def run(self, done: int, steps: int, phase: int, every: int) -> np.ndarray:
        """Make more steps and return the rows that are kept after each group of ``every`` steps.

        ``done``: steps made before, of which ``phase`` belong to the first group.
        """
        if done < 0 or steps < 0 or not 0 <= phase < every:
            raise InvalidInputError(f"numbers of steps, got {done}, {steps}, {phase} and {every}")
        record = np.zeros((-(-(phase + steps) // every), self._kept, len(self.failed)))
        own = self._struct
        own.done, own.steps, own.phase, own.every, own.kept = done, steps, phase, every, self._kept
        own.record = address_of(record, FLOAT, record.shape, "record")
        in_threads(self._share, self.blocks, math.inf)
        return record

    def _share(self, blocks: range) -> None:
        """Make the steps of some blocks of lanes, with registers and memory of this thread."""
        core, own = library(), MethodStruct.from_buffer_copy(self._shared)
        programs = [function.program for function in self._method.functions]
        many = [1 if points == 1 else program.lanes(points) for program, points in zip(programs, self._points, strict=True)]
        registers = max(program.sizes[2] * lanes for program, lanes in zip(programs, many, strict=True))
        size = core.retrax_integration_workspace(byref(own))
        if not size:
            raise InvalidInputError("the memory of a step does not fit the address space")
        shared, workspace = scratch(((registers,), (size // BYTES,)))
        begin, room = (address_of(a, FLOAT, a.shape, "memory of a step") for a in (shared, workspace))
        evaluate, own_set = cast(core.retrax_evaluate_tape, c_void_p).value, best_instruction_set()
        tapes = [
            TapeFunctionStruct(pointer(program.tape), begin, lanes, own_set)
            for program, lanes in zip(programs, many, strict=True)
        ]
        for k in range(STEP_FUNCTIONS):
            own.functions[k] = FunctionStruct(evaluate, addressof(tapes[k]))
        core.retrax_integrate(byref(own), byref(self._struct), blocks.start, blocks.stop, room)

