"""A trial of Newton's method on one trajectory, from its step to what it is judged by, as parts of a compiled pass."""

from functools import cache
from typing import Any

import numpy as np
from numba import types
from numba.core.typing.templates import signature

from ....kernels import kernel_part, pasted
from ....linked import address, array, called, laid, put, view
from ....tape import machine
from . import elimination_kernels, extent_kernels, inequality_kernels

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
    (F2, F2, F2, F2),
    ((F4, F4, F4), F5, F2, F3, F1),
    (F4, F4, F4, F4, array(2, TRUTH), F2, (F1, F1, F1, F1), F1),
)

MEET = signature(
    TRUTH,
    F3,
    F3,
    types.Tuple((F2, F2, array(1, TRUTH), array(1, TRUTH))),
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

laid_out, solve = laid(OUT), called(SOLVE)

_run, _meet, _survey, _measure = called(machine.RUN), called(MEET), called(SURVEY), called(MEASURE)
_held_survey, _raise, _move = called(HELD_SURVEY), called(RAISE), called(MOVE)


@cache
def addresses(limited: bool) -> tuple[int, ...]:
    """Where the kernels stand in this process that a pass calls; those of inequalities only if there are any."""
    kernels: list[tuple[Any, Any]] = [
        (machine.run, machine.RUN),
        (extent_kernels.meet, MEET),
        (extent_kernels.survey, SURVEY),
        (extent_kernels.measure, MEASURE),
    ]
    of_limits: list[tuple[Any, Any]] = [
        (inequality_kernels.survey, HELD_SURVEY),
        (inequality_kernels.raise_points, RAISE),
        (inequality_kernels.move, MOVE),
    ]
    own = [address(*kernel) for kernel in of_limits] if limited else [0] * len(of_limits)
    return *(address(*kernel) for kernel in kernels), *own, address(elimination_kernels.solve, SOLVE)


@pasted
def _rows(table: np.ndarray, first: int, count: int) -> np.ndarray:
    """Some rows of a table."""
    return view(table, first * table.shape[1], (count, table.shape[1]))


@kernel_part(_nrt=False)
def _evaluate(place: int, k: int, tapes: tuple, count: int) -> None:
    """Run the tape ``k`` on what it reads."""
    codes, registers, values, sources, targets, table, memory, written = tapes
    first, size = table[k, 0], table[k, 1] - table[k, 0]
    own = view(codes, first, (size,)), _rows(registers, first, size), view(values, first, (size,))
    reads = _rows(sources, table[k, 2], table[k, 3] - table[k, 2])
    writes = _rows(targets, table[k, 4], table[k, 5] - table[k, 4])
    read, out = view(memory, table[k, 6], (table[k, 7],)), view(written, table[k, 8], (table[k, 9],))
    w = view(memory, table[k, 10], (table[k, 11], table[k, 12]))
    _run(place, (*own, read, reads, out, writes, w, 0, count))


@pasted
def _moved(read: np.ndarray, before: tuple, data: tuple, out: np.ndarray) -> None:
    """What the tape of the moved unknowns reads, and the covectors at the nodes after the step."""
    (x, coordinates, frames, steps, multipliers, part), (h, parameters) = before, data
    at, fraction, (n, size) = put(read, 0, x, 0, x.size), part[0], frames.shape[2:]
    for i in range(steps.size):
        read[at + i] = fraction * steps[i]
    put(read, put(read, at + steps.size, h, 0, h.size), parameters, 0, parameters.size)
    for k in range(h.size + 1):
        for e in range(size):
            out[k * size + e] = 0.0
        for a in range(n):
            f = coordinates[0, k, a] + fraction * multipliers[k * n + a]
            for e in range(size):
                out[k * size + e] += f * frames[0, k, a, e]


@pasted
def _read_row(read: np.ndarray, moved: np.ndarray, nodes: np.ndarray, costates: np.ndarray, data: tuple) -> int:
    """What the tape of the steps reads but for the multipliers of the inequalities: unknowns, both ends, their
    covectors, lengths, parameters."""
    (h, parameters), size = data, nodes.shape[2]
    at, count = put(read, 0, moved, 0, moved.size), h.size * nodes.shape[2]
    at = put(read, put(read, at, nodes, 0, count), nodes, size, count)
    at = put(read, put(read, at, costates, 0, count), costates, size, count)
    return put(read, put(read, at, h, 0, h.size), parameters, 0, parameters.size)


@pasted
def meet_ends(
    run: int, meet: int, tapes: tuple, before: tuple, data: tuple, ends: tuple, arrays: tuple, met: tuple
) -> bool:
    """Move the unknowns, and whether the ends of the steps are near each other; then the nodes are known."""
    (_, points, columns, _, far, _), (begins, finishes, work, covectors, _, _, _, _), count = ends, arrays, data[0].size
    table, memory = tapes[5], tapes[6]
    _moved(view(memory, table[0, 6], (table[0, 7],)), before, data, covectors)
    if before[3].size > 0:
        _evaluate(run, 0, tapes, count)
    else:
        put(tapes[7], 0, before[0], 0, before[0].size)
    read = view(memory, table[1, 6], (table[1, 7],))
    at = put(read, put(read, 0, tapes[7], 0, table[0, 9]), data[0], 0, count)
    put(read, at, data[1], 0, data[1].size)
    _evaluate(run, 1, tapes, count)
    return not _meet(meet, (begins, finishes, points, columns, far, work, met))


@pasted
def evaluate(calls: tuple, tapes: tuple, data: tuple, fixed: np.ndarray, limits: tuple, out: tuple) -> None:
    """Frames at the nodes and blocks of the steps, with the multipliers of the inequalities after their step."""
    run, move = calls[0], calls[6]
    (_, _, _, covectors, _, _, _, costates), (nodes, gaps, _, _) = out[0], out[1]
    (slacks, turn, parts, kept), new = limits[:4], out[6][0]
    table, memory, moved, count = tapes[5], tapes[6], view(tapes[7], 0, (tapes[5][0, 9],)), data[0].size
    read = view(memory, table[2, 6], (table[2, 7],))
    at = put(read, put(read, 0, nodes, 0, nodes.size), fixed, 0, fixed.size)
    put(read, put(read, at, gaps, 0, gaps.size), covectors, 0, covectors.size)
    _evaluate(run, 2, tapes, count + 1)
    read = view(memory, table[3, 6], (table[3, 7],))
    end = _read_row(read, moved, nodes, costates, data)
    if new[1].size > 0:
        _move(move, (0, 1, slacks, turn, parts, kept, new))
        put(read, end, new[1], 0, new[1].size)
    _evaluate(run, 3, tapes, count)


@pasted
def measure(calls: tuple, mean: np.ndarray, units: tuple, limits: tuple, out: tuple) -> None:
    """What the trial is judged by, with the shares of the inequalities in the blocks."""
    survey, measure, held_survey, raise_points = calls[2:6]
    slacks, _, _, _, (scales, rate, room), weights, value, prices = limits
    (arrays, (nodes, _, _, largest), blocks, raised, extent, told, held, _) = out
    (along, entries, numbers, surveyed), (new, pushed, sums, none, zeros), barrier = told, held, slacks[4]
    (points_hessian, points_slope, values, pushes, costs, cost), (_, _, _, _, frames, gap, coordinates, _) = (
        raised,
        arrays,
    )
    for i in range(zeros.size):
        zeros[i] = 0.0
    for i in range(extent[0].size):
        extent[0][0, i], extent[1][0, i] = -np.inf, -np.inf
    cost[0] = 0.0
    for k in range(costs.size):
        cost[0] += costs[0, k]
    if scales.shape[1] > 0:
        given, after = (values, pushes, weights), (new[0], new[1], new[2], slacks[3], barrier)
        _raise(raise_points, (0, 1, given, after, points_hessian, points_slope, pushed))
        _held_survey(held_survey, (0, 1, given, after, (scales, rate, room), value, prices, surveyed))
    _survey(survey, (0, 1, (nodes, frames, coordinates, gap), blocks, (*extent, sums)))
    highest, lowest, support, _, missing, lacking, total, parts, slopes, curvature = extent
    of = highest, lowest, support, missing, lacking, total, parts, slopes, curvature
    measured = (surveyed, barrier, rate), units[1], (along, entries, numbers)
    _measure(measure, (of, none, (largest, mean, cost), units[0], *measured))
