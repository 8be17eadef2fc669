"""Functions of one point, evaluated at many points as tapes of scalar instructions."""

import itertools
import math
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Self, final

import numpy as np

from ..errors import RetraxError
from .base import Arrays, Evaluator, Function, PointwiseFunction
from .binding.tape_machine import TapeCall
from .program_digest import content_key
from .threads import worth_threads
from .working_memory import LINE, aligned_array

if TYPE_CHECKING:
    from ..tape import Tape

SHAPE = attrgetter("shape")
MOST_TAPES = 256  # tapes that are kept, so that memory has a bound
MOST_OPERATIONS = 2_500_000  # of a graph, expected: a tape of more takes half a minute to make, and XLA a tenth of it
PLANS = 8  # of a tape, for as many shapes of its arrays
SHARED_MEMORY = 2**17  # numbers that the small tapes of a thread share, in the near caches
ALL_TRACED = "all functions are traced to scalar operations"


@final
class LargeTapeError(RetraxError, ValueError):
    """The graph of a tape is larger than was asked for."""

    def __init__(self, size: int, most: float) -> None:
        super().__init__(f"it has about {size} scalar operations, more than {most:.0f}: XLA takes less time")


# By what they compute, the last one that was asked for at the end; of those that are too large the size.
_tapes: dict[Hashable, "Tape | int"] = {}


@final
class TapeEvaluator(Evaluator):
    """Runs functions as tapes of scalar instructions, in double precision; nothing is compiled for a problem.

    ``most``: scalar operations in the graph of a tape, about; larger ones raise ``LargeTapeError``.
    """

    def __init__(self, most: float = math.inf) -> None:
        self._most = most

    @property
    def name(self) -> str:
        """``"tape"``."""
        return "tape"

    @property
    def reason(self) -> str:
        """The reason: all functions are tapes."""
        return ALL_TRACED

    def _make(self, function: Function, sizes: Sequence[int], first: int | None) -> PointwiseFunction:
        d = [] if first is None else [np.zeros(first)]
        return _TapeFunction(_tape(function, [*d, *(np.zeros(size) for size in sizes)], first is not None, self._most))


def _tape(function: Function, examples: list[np.ndarray], expanded: bool, most: float) -> "Tape":
    """The tape of a function, or of its expansion; functions that compute the same have one."""
    from ..tape import Tape
    from ..tape.trace import flat

    program = flat(function, *examples)
    content = content_key(program.jaxpr, differentiated=expanded)
    key = content, program.result, expanded, most
    tape = None if content is None else _tapes.pop(key, None)
    if tape is None:
        tape = Tape.read(program)
        size = tape.expansion_size if expanded else tape.size
        tape = size if size > most else tape.expansion() if expanded else tape
    if content is not None:
        _tapes[key] = tape
        if len(_tapes) > MOST_TAPES:
            _tapes.pop(next(iter(_tapes)), None)
    if isinstance(tape, int):
        raise LargeTapeError(tape, most)
    return tape


@dataclass(frozen=True, eq=False)
class _Plan:
    """Where a tape finds the numbers of some arrays, and where it writes: fixed by their shapes."""

    count: int
    read: list[tuple[int, int, tuple[int, ...]]]  # the parts of what is read, and their shapes: arrays are copied there
    sources: np.ndarray  # the place of the number of the first point, and how far that of the next is
    targets: np.ndarray
    written: list[tuple[int, int, tuple[int, ...]]]  # the parts of what is written, and their shapes

    @classmethod
    def of(cls, axes: int, given: list[tuple[int, ...]], found: Sequence[tuple[int, ...]]) -> Self:
        """The plan for arrays with leading axes, and for the shapes of the values at a point."""
        leading = np.broadcast_shapes(*(shape[:axes] for shape in given))
        count, sizes = math.prod(leading), [math.prod(shape[axes:]) for shape in given]
        shared = [count > 1 and math.prod(shape[:axes]) == 1 for shape in given]
        filled = [shape if one else (*leading, *shape[axes:]) for one, shape in zip(shared, given, strict=True)]
        sources = _rows((size, 1 if one else count) for one, size in zip(shared, sizes, strict=True))
        targets = _rows((math.prod(shape), count) for shape in found)
        return cls(count, _slices(filled), sources, targets, _slices([(*leading, *shape) for shape in found]))

    @property
    def numbers(self) -> tuple[int, int]:
        """How many are read, and written."""
        return self.read[-1][1] if self.read else 0, self.written[-1][1] if self.written else 0


def _slices(shapes: Iterable[tuple[int, ...]]) -> list[tuple[int, int, tuple[int, ...]]]:
    """Begins and ends of arrays of these shapes, one after the other, and the shapes."""
    shapes = list(shapes)
    ends = itertools.accumulate((math.prod(shape) for shape in shapes), initial=0)
    return [(*pair, shape) for pair, shape in zip(itertools.pairwise(ends), shapes, strict=True)]


def _parts(numbers: np.ndarray, cuts: list[tuple[int, int, tuple[int, ...]]]) -> list[np.ndarray]:
    """The parts of an array."""
    return [numbers[first:last].reshape(shape) for first, last, shape in cuts]


def _rows(arrays: Iterable[tuple[int, int]]) -> np.ndarray:
    """Where the numbers of points stand in arrays one after the other, of these widths and lengths; shared where that
    is one."""
    rows, first = list[tuple[int, int]](), 0
    for size, length in arrays:
        rows += [(first + k, size if length > 1 else 0) for k in range(size)]
        first += size * length
    return np.array(rows, np.int64).reshape(-1, 2)


@final
class _TapeFunction(PointwiseFunction):
    """A tape with arguments and values in rows."""

    def __init__(self, tape: "Tape") -> None:
        self.tape = tape
        self._plans: dict[Any, tuple[_Plan, _SmallTape | None]] = {}

    def at(self, axes: int, *arguments: np.ndarray) -> Arrays:
        key = axes, *map(SHAPE, arguments)
        plan, small = self._plans.get(key) or self._plan(key)
        if small is not None:
            return small.at(arguments)
        read, written = map(np.empty, plan.numbers)
        for place, a in zip(_parts(read, plan.read), arguments, strict=True):
            place[...] = a
        self.tape.run(plan.count, (read, plan.sources, written, plan.targets))
        return tuple(_parts(written, plan.written))

    def _plan(self, key: tuple[Any, ...]) -> "tuple[_Plan, _SmallTape | None]":
        """The plan for arrays of some shapes; a few plans are kept."""
        axes, *shapes = key
        plan = _Plan.of(axes, shapes, self.tape.shapes)
        if len(self._plans) == PLANS:
            self._plans = {}
        found = self._plans[key] = plan, _SmallTape.of(self.tape, plan)
        return found


@final
class _Memory:
    """Memory in which one tape after the other runs."""

    def __init__(self) -> None:
        self.numbers = aligned_array(SHARED_MEMORY)


_rooms: list[_Memory] = []  # those that no tape runs in


@final
class _SmallTape:
    """The arrays of a tape whose loop takes no longer than Python, made once for some shapes."""

    def __init__(self, tape: "Tape", lanes: int, plan: _Plan) -> None:
        self._program, self._lanes, self._plan = tape.on_core, lanes, plan
        self._numbers = plan.numbers[1]
        # Fields of a structure are views that are made in less time than slices.
        self._fields = [str(k) for k in range(len(plan.written))]
        self._structure = np.dtype(
            [(name, float, cut[2]) for name, cut in zip(self._fields, plan.written, strict=True)]
        )
        self._kept: dict[_Memory, tuple[list[np.ndarray], TapeCall]] = {}

    @classmethod
    def of(cls, tape: "Tape", plan: _Plan) -> Self | None:
        """The arrays for a tape; None if threads share the loop, or if the loop needs more room."""
        lanes, (read, written) = tape.on_core.lanes(plan.count), plan.numbers
        shared = worth_threads(plan.count, tape.program.work)
        if shared or not (plan.count and written) or tape.program.size * lanes + read + LINE > SHARED_MEMORY:
            return None
        return cls(tape, lanes, plan)

    def at(self, arguments: Arrays) -> Arrays:
        """The values for arrays of the shapes of the plan."""
        try:
            room = _rooms.pop()
        except IndexError:  # one for each thread that is here at the same time
            room = _Memory()
        places, write = self._kept.get(room) or self._in(room)
        for place, a in zip(places, arguments, strict=True):
            place[...] = a
        written = np.empty(self._numbers)
        write(written)
        _rooms.append(room)
        structure = np.ndarray((), self._structure, written)
        return tuple(map(structure.__getitem__, self._fields))

    def _in(self, room: _Memory) -> tuple[list[np.ndarray], TapeCall]:
        """Where arrays are copied to in a room, and the call of the core with registers there."""
        plan, size = self._plan, self._program.sizes[-1] * self._lanes
        begin = -(-size // LINE) * LINE
        read = room.numbers[begin : begin + plan.numbers[0]]
        ends = read, plan.sources, np.empty(self._numbers), plan.targets
        call = TapeCall(self._program, range(plan.count), ends, self._lanes, room.numbers[:size])
        found = self._kept[room] = _parts(read, plan.read), call
        return found
