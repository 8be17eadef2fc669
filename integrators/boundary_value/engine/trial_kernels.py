"""Parts of the compiled passes on one trajectory: tapes, frames at the nodes, and what a trial is judged by.

A trial itself, from a step to its system, is a kernel of the transcription (``one_stage_kernels``,
``collocation_kernels``), which a pass calls by its address.
"""

from functools import cache

import numpy as np
from numba import types
from numba.core.typing.templates import signature

from ....kernels import kernel_part, pasted
from ....linked import address, array, called, laid, put, view
from ....tape import machine
from . import elimination_kernels, extent_kernels, inequality_kernels
from .vectors import inner

REAL, WHOLE, TRUTH = types.float64, types.int64, types.boolean
F1, F2, F3, F4, F5 = map(array, range(1, 6))

FIVE, THREE = types.Tuple((F4, F4, F4, F4, F1)), types.Tuple((F4, F4, F4))
HELD, TRAJECTORY, BLOCKS = types.Tuple((F4, F5, F4)), types.Tuple((F3, F4, F3, F3)), types.Tuple((F4, F4, F4, F3, F3))
EXTENT = F2, F2, F3, F2, F2, F2, F1, F2, F2, F2  # the fields of ``Extent``
OUT = (
    (F3, F3, F2, F1, F4, F3, F3, F3),
    (F3, F3, array(2, TRUTH), F2),
    (F4, F4, F4, F3, F3),
    (F5, F4, F4, F5, F2, F1),
    EXTENT,
    (F2, F2, F2, F2, F3),
    ((F4, F4, F4), F5, F2, F1),
    (F4, F4, F4, F4, array(2, TRUTH), F2, (F1, F1, F1, F1), F1, F1),
    (F1, F1, F1, F1, F1, F1, F1),
)

PLACES = array(2, WHOLE)
TAPES = types.Tuple((array(1, types.uint8), array(2, types.uint32), F1, PLACES, PLACES, PLACES, F1, F1))
# Which address is whose; those from ``AT_OWN`` on are for what a transcription has for itself.
AT_RUN, AT_MEET, AT_SURVEY, AT_MEASURE, AT_HELD_SURVEY, AT_RAISE, AT_SOLVE, AT_TRIAL, AT_COMPLETE, AT_OWN = range(10)
ADDRESSES = types.UniTuple(WHOLE, 13)
MET = types.Tuple((F2, F2, array(1, TRUTH), array(1, TRUTH)))
# What a trial takes and gives: whether ends of steps are near each other.
TRIAL = signature(
    TRUTH,
    ADDRESSES,
    TAPES,
    types.Tuple((F1, F1, F1, F1, F1, F1, F1, F3, F4, F1)),
    types.Tuple((F1, F1, F2, F1)),
    types.Tuple((F1, MET, array(1, WHOLE), F1, REAL, array(1, WHOLE))),
    types.Tuple((FIVE, THREE, types.UniTuple(F1, 2), REAL)),
    PLACES,
    PLACES,
)
COMPLETE = signature(types.none, ADDRESSES, F1, F1, types.Tuple((F1, F1, F2, F1)), PLACES, PLACES)
MEET = signature(
    TRUTH,
    F3,
    F3,
    MET,
    array(1, WHOLE),
    REAL,
    F2,
    types.Tuple((F3, F3, array(2, TRUTH), F2)),
)
SURVEY = signature(types.none, WHOLE, WHOLE, TRAJECTORY, BLOCKS, types.Tuple((*EXTENT, F2)))
MEASURE = signature(
    types.none,
    types.Tuple((*EXTENT[:3], *EXTENT[4:])),
    F3,
    types.Tuple((F2, F1, F1)),
    types.Tuple((F2, F2, F1, F2, F1)),
    types.Tuple((F2, F1, F1)),
    types.UniTuple(REAL, 3),
    types.Tuple((F2, F2, F2)),
)
HELD_SURVEY = signature(
    types.none, WHOLE, WHOLE, HELD, FIVE, types.Tuple((F2, F1, F1)), REAL, types.UniTuple(REAL, 3), F2
)
RAISE = signature(types.none, WHOLE, WHOLE, HELD, FIVE, F5, F4, F5)
MOVE = signature(types.none, WHOLE, WHOLE, FIVE, THREE, types.UniTuple(F1, 2), REAL, THREE)
SOLVE = signature(
    types.none,
    WHOLE,
    WHOLE,
    types.Tuple((F4, F4, F4, F4, F4, F2, F2)),
    types.Tuple((F2, F2, F1)),
    types.Tuple((F1, F2)),
    REAL,
    types.UniTuple(F2, 4),
    types.Tuple((F2, F2, array(1, WHOLE), array(1, WHOLE), F2)),
    types.Tuple((F4, F4, array(2, TRUTH), F2)),
    types.UniTuple(F1, 4),
)

laid_out, solve, trial, complete = laid(OUT), called(SOLVE), called(TRIAL), called(COMPLETE)

_run, _meet, _survey, _measure = called(machine.RUN), called(MEET), called(SURVEY), called(MEASURE)
_held_survey, _raise = called(HELD_SURVEY), called(RAISE)


@cache
def addresses(limited: bool) -> tuple[int, ...]:
    """Where the kernels stand in this process that all passes call; those of inequalities only if there are any."""
    of_limits = (
        limited and address(inequality_kernels.survey, HELD_SURVEY),
        limited and address(inequality_kernels.raise_points, RAISE),
    )
    return (
        address(machine.run, machine.RUN),
        address(extent_kernels.meet, MEET),
        address(extent_kernels.survey, SURVEY),
        address(extent_kernels.measure, MEASURE),
        *map(int, of_limits),
        address(elimination_kernels.solve, SOLVE),
    )


@pasted
def _rows(table: np.ndarray, first: int, count: int) -> np.ndarray:
    """Some rows of a table."""
    return view(table, first * table.shape[1], (count, table.shape[1]))


@pasted
def read_by(tapes: tuple, k: int) -> np.ndarray:
    """Where the tape ``k`` reads."""
    return view(tapes[6], tapes[5][k, 6], (tapes[5][k, 7],))


@kernel_part(_nrt=False)
def evaluate(place: int, row: np.ndarray, tapes: tuple, count: int) -> None:
    """Run a tape on what it reads; ``row``: that of the table."""
    codes, registers, values, sources, targets, _, memory, written = tapes
    first, size = row[0], row[1] - row[0]
    own = view(codes, first, (size,)), _rows(registers, first, size), view(values, first, (size,))
    reads, writes = _rows(sources, row[2], row[3] - row[2]), _rows(targets, row[4], row[5] - row[4])
    read, out = view(memory, row[6], (row[7],)), view(written, row[8], (row[9],))
    _run(place, (*own, read, reads, out, writes, view(memory, row[10], (row[11], row[12])), 0, count))


@inner
def clear(numbers: np.ndarray) -> None:
    """Make all of them zero."""
    for i in range(numbers.size):
        numbers[i] = 0.0


@inner
def covectors(before: tuple, out: np.ndarray) -> None:
    """The covectors at the nodes after a part of the steps of their multipliers."""
    (_, _, _, _, multipliers, _, _, coordinates, frames, part) = before
    _, count, n, size = frames.shape
    for k in range(count):
        for e in range(size):
            out[k * size + e] = 0.0
        for a in range(n):
            f = coordinates[0, k, a] + part[0] * multipliers[k * n + a]
            for e in range(size):
                out[k * size + e] += f * frames[0, k, a, e]


@pasted
def meet_ends(calls: tuple, k: int, tapes: tuple, ends: tuple, arrays: tuple, met: tuple, count: int) -> bool:
    """Whether the ends of the steps, which the tape ``k`` finds, are near each other; then the nodes are known."""
    (_, points, columns, _, far, _), (begins, finishes, work, _, _, _, _, _) = ends, arrays
    evaluate(calls[AT_RUN], tapes[5][k], tapes, count)
    return not _meet(calls[AT_MEET], (begins, finishes, points, columns, far, work, met))


@pasted
def in_frames(run: int, k: int, tapes: tuple, fixed: np.ndarray, covectors: np.ndarray, met: tuple) -> None:
    """Frames at the nodes, and in them what is lacking there and the covectors, by the tape ``k``."""
    (nodes, gaps, _, _), read = met, read_by(tapes, k)
    at = put(read, put(read, 0, nodes, 0, nodes.size), fixed, 0, fixed.size)
    put(read, put(read, at, gaps, 0, gaps.size), covectors, 0, covectors.size)
    evaluate(run, tapes[5][k], tapes, nodes.shape[1])


@pasted
def put_ends(read: np.ndarray, at: int, nodes: np.ndarray, costates: np.ndarray) -> int:
    """States before and after each step, and their covectors, from a place on; where the next ones go."""
    size, count = nodes.shape[2], nodes.size - nodes.shape[2]
    at = put(read, put(read, at, nodes, 0, count), nodes, size, count)
    return put(read, put(read, at, costates, 0, count), costates, size, count)


@pasted
def measure(calls: tuple, mean: np.ndarray, units: tuple, limits: tuple, out: tuple) -> None:
    """What the trial is judged by, with the shares of the inequalities in the blocks."""
    slacks, _, _, _, (scales, rate, room), weights, value, prices = limits
    (arrays, (nodes, _, _, largest), blocks, raised, extent, told, held, _, _) = out
    (along, entries, numbers, surveyed, points), (new, pushed, sums, zeros), barrier = told, held, slacks[4]
    (points_hessian, points_slope, values, pushes, costs, cost), (_, _, _, _, frames, gap, coordinates, _) = (
        raised,
        arrays,
    )
    clear(zeros)
    for i in range(extent[0].size):
        extent[0][0, i], extent[1][0, i] = -np.inf, -np.inf
    cost[0] = 0.0
    for k in range(costs.size):
        cost[0] += costs[0, k]
    if scales.shape[1] > 0:
        given, after = (values, pushes, weights), (new[0], new[1], new[2], slacks[3], barrier)
        _raise(calls[AT_RAISE], (0, 1, given, after, points_hessian, points_slope, pushed))
        _held_survey(calls[AT_HELD_SURVEY], (0, 1, given, after, (scales, rate, room), value, prices, surveyed))
    _survey(calls[AT_SURVEY], (0, 1, (nodes, frames, coordinates, gap), blocks, (*extent, sums)))
    highest, lowest, support, _, missing, lacking, total, parts, slopes, curvature = extent
    of = highest, lowest, support, missing, lacking, total, parts, slopes, curvature
    measured = (surveyed, barrier, rate), units[1], (along, entries, numbers)
    _measure(calls[AT_MEASURE], (of, points, (largest, mean, cost), units[0], *measured))
