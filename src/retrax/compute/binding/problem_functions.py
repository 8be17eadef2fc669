"""Functions of a transcribed problem: their names, and callbacks to Python for functions that have no tape."""

from collections.abc import Callable, Sequence
from ctypes import CFUNCTYPE, POINTER, c_double, c_ssize_t, c_void_p, cast
from enum import IntEnum
from functools import partial
from itertools import accumulate, pairwise
from typing import Any, final
from weakref import ref

import numpy as np

from .library import BYTES
from .structs import FunctionStruct, TapeDataStruct

EVALUATE = CFUNCTYPE(None, c_void_p, POINTER(TapeDataStruct), c_ssize_t)  # of a retrax_function
Columns = tuple[int, int, int]  # place of the first number of point 0, distance to the next point, numbers of a point


class FunctionName(IntEnum):
    """The functions of a problem; ``retrax_core.h`` says what each reads and writes."""

    ENDS = 0
    MIDDLE = 1
    FRAMES = 2
    POINTS = 3
    BOTH_ENDS = 4
    MOVE = 5
    MOVE_CONTROLS = 6
    START_COST = 7
    END_COST = 8
    CONTROL_FRAMES = 9


@final
class Failure:
    """The first error of the functions of a problem, kept until C, which has no exceptions, returns to Python."""

    def __init__(self) -> None:
        self.error: BaseException | None = None

    def check(self) -> None:
        """Raise the error, if there is one, and forget it."""
        error, self.error = self.error, None
        if error is not None:
            raise error


@final
class CallbackFunction:
    """A function of a transcribed problem that Python evaluates.

    ``at``: from arrays of shape ``(points, size)`` to arrays with the points along the leading axis; ``arguments``,
    ``values``: numbers of each array at a point. A function belongs to one transcription.
    """

    def __init__(
        self, at: Callable[..., Sequence[np.ndarray]], arguments: Sequence[int], values: Sequence[int]
    ) -> None:
        self._at, self._arguments, self._values = at, arguments, values
        self._places: tuple[list[Columns], list[Columns]] | None = None  # the same in all trajectories of a problem
        self._failure = Failure()
        self._callback = EVALUATE(partial(_evaluate, ref(self)))  # C calls it

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of inputs and outputs."""
        return sum(self._arguments), sum(self._values)

    def as_function(self, failure: Failure) -> FunctionStruct:
        """The function as C has it, as long as this object lasts.

        ``failure``: of the problem.
        """
        self._failure, self._places = failure, None
        return FunctionStruct(cast(self._callback, c_void_p), None)

    def _write(self, data: TapeDataStruct, points: int) -> None:
        """Write the values at so many points: NaN after an error, which ends the search at its next report."""
        outputs = list[np.ndarray]()
        try:
            if self._places is None:
                self._places = _columns(data.sources, self._arguments), _columns(data.targets, self._values)
            given, found = self._places
            outputs = _views(data.outputs, data.output_size, found, points)
            if self._failure.error is None:
                inputs = _views(data.inputs, data.input_size, given, points)
                with np.errstate(all="ignore"):  # numbers that are not finite are judged in C
                    values = self._at(*inputs)
                for output, value in zip(outputs, values, strict=True):
                    output[...] = value.reshape(output.shape)
                return
        except BaseException as error:
            self._failure.error = error
        for output in outputs:
            output[...] = np.nan


def _evaluate(function: Any, _context: int | None, data: Any, points: int) -> None:
    """The function that C calls."""
    function()._write(data.contents, points)


def _columns(places: int | None, widths: Sequence[int]) -> list[Columns]:
    """The places of the numbers of each array; the numbers of a point follow one another.

    ``places``: the address of a table of the place of each number at point 0, and its distance to the next point.
    """
    if not sum(widths):
        return [(0, 0, 0) for _ in widths]
    table, found = np.array((c_ssize_t * 2 * sum(widths)).from_address(places or 0)), list[Columns]()
    for begin, end in pairwise(accumulate(widths, initial=0)):
        first, stride = map(int, table[begin]) if end > begin else (0, 0)
        expected = [(first + k, stride) for k in range(end - begin)]
        if not np.array_equal(table[begin:end], np.reshape(expected, (-1, 2))):
            raise RuntimeError(f"numbers {begin} to {end} of a function do not follow one another: {table[begin:end]}")
        found.append((first, stride, end - begin))
    return found


def _views(address: int, size: int, columns: list[Columns], points: int) -> list[np.ndarray]:
    """Arrays of shape ``(points, width)`` in memory of so many numbers; NumPy refuses what lies outside of it."""
    memory: Any = (c_double * size).from_address(address)
    return [
        np.ndarray((points, width), float, memory, BYTES * first, (BYTES * stride, BYTES))
        for first, stride, width in columns
    ]
