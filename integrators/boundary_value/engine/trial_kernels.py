"""A trial of Newton's method on one trajectory, from its step to what it is judged by, in one compiled pass."""

from typing import Any

import numpy as np
from numba import types

from ....tape import machine
from . import extent_kernels, inequality_kernels
from .linked import address, array, called, signature
from .vectors import compiled, inner

REAL, WHOLE, TRUTH = types.float64, types.int64, types.boolean
F1, F2, F3, F4, F5 = map(array, range(1, 6))
PLACES = array(2, WHOLE)

FIVE, THREE = types.Tuple((F4, F4, F4, F4, F1)), types.Tuple((F4, F4, F4))
HELD, TRAJECTORY, BLOCKS = types.Tuple((F4, F5, F4)), types.Tuple((F3, F4, F3, F3)), types.Tuple((F4, F4, F4, F3, F3))
EXTENT = F2, F2, F3, F2, F2, F2, F1, F2, F2, F2  # the fields of ``Extent``

RUN = signature(types.none, array(1, types.uint8), array(2, types.uint32), F1, F1, PLACES, F1, PLACES, F2, WHOLE, WHOLE)
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
    types.Tuple((types.UniTuple(F1, 11), F1, F1)),
    types.UniTuple(REAL, 3),
    types.Tuple((F2, F2, F2)),
)
HELD_SURVEY = signature(
    types.none, WHOLE, WHOLE, HELD, FIVE, types.Tuple((F2, F1, F1)), REAL, types.UniTuple(REAL, 3), F2
)
RAISE = signature(types.none, WHOLE, WHOLE, HELD, FIVE, F5, F4, F5)
MOVE = signature(types.none, WHOLE, WHOLE, FIVE, THREE, types.UniTuple(F1, 2), REAL, THREE)

_run, _meet, _survey, _measure = called(RUN), called(MEET), called(SURVEY), called(MEASURE)
_held_survey, _raise, _move = called(HELD_SURVEY), called(RAISE), called(MOVE)


def addresses() -> tuple[int, ...]:
    """Where the kernels stand that a trial calls."""
    kernels: tuple[tuple[Any, Any], ...] = (
        (machine.run, RUN),
        (extent_kernels.meet, MEET),
        (extent_kernels.survey, SURVEY),
        (extent_kernels.measure, MEASURE),
        (inequality_kernels.survey, HELD_SURVEY),
        (inequality_kernels.raise_points, RAISE),
        (inequality_kernels.move, MOVE),
    )
    return tuple(address(*own) for own in kernels)


@inner
def _put(read: np.ndarray, at: int, numbers: np.ndarray) -> int:
    """Copy numbers to what a tape reads, from ``at`` on; where the next ones go."""
    for i in range(numbers.size):
        read[at + i] = numbers[i]
    return at + numbers.size


@inner
def _put_rows(read: np.ndarray, at: int, rows: np.ndarray, first: int, last: int) -> int:
    """Copy rows of a matrix."""
    for k in range(first, last):
        for e in range(rows.shape[1]):
            read[at] = rows[k, e]
            at += 1
    return at


@inner
def _evaluate(place: int, tape: tuple, count: int) -> None:
    """Run a tape on what it is to read."""
    codes, registers, values, read, sources, written, targets, w = tape
    _run(place, (codes, registers, values, read, sources, written, targets, w, 0, count))


@inner
def _moved(place: int, tape: tuple, before: tuple, data: tuple, out: np.ndarray) -> None:
    """Centres and controls after the step, and covectors at the nodes, in the places where tapes read them."""
    (x, u, coordinates, frames, steps, multipliers, part), (h, parameters) = before, data
    read, count = tape[3], h.size
    at, fraction = _put(read, _put(read, 0, x), u), part[0]
    for k in range(count):
        for i in range(steps.shape[2]):
            read[at] = fraction * steps[0, k, i]
            at += 1
    _put(read, _put(read, at, h), parameters)
    _evaluate(place, tape, count)
    size = frames.shape[3]
    for k in range(count + 1):
        for e in range(size):
            out[k * size + e] = 0.0
        for a in range(coordinates.shape[2]):
            f = coordinates[0, k, a] + fraction * multipliers[0, k, a]
            for e in range(size):
                out[k * size + e] += f * frames[0, k, a, e]


@inner
def _read_row(read: np.ndarray, moved: np.ndarray, nodes: np.ndarray, costates: np.ndarray, data: tuple) -> int:
    """What the tape of the steps reads but for the multipliers of the inequalities: unknowns, both ends, their
    covectors, lengths, parameters."""
    (h, parameters), count = data, nodes.shape[0] - 1
    at = _put(read, 0, moved)
    for rows in (nodes, costates):
        at = _put_rows(read, at, rows, 0, count)
        at = _put_rows(read, at, rows, 1, count + 1)
    return _put(read, _put(read, at, h), parameters)


@inner
def _cleared(extent: tuple, numbers: np.ndarray, surveyed: np.ndarray) -> None:
    """Make all what the kernels expect to find."""
    highest, lowest, support, sizes, missing, lacking, held, parts, slope, curvature = extent
    highest[:], lowest[:] = -np.inf, -np.inf
    support[:], sizes[:], missing[:], lacking[:], held[:] = 0.0, 0.0, 0.0, 0.0, 0.0
    parts[:], slope[:], curvature[:], numbers[:], surveyed[:] = 0.0, 0.0, 0.0, 0.0, 0.0


@compiled
def trial(
    calls: tuple, tapes: tuple, before: tuple, data: tuple, ends: tuple, units: tuple, limits: tuple, out: tuple
) -> bool:
    """Whether all ends of steps are near each other where a step leads; then ``out`` has the system there.

    ``calls``: addresses; ``tapes``: of the moved unknowns, of the ends, of the frames, of the steps, each with what it
    reads and writes and its registers; ``before``: centres, controls, coordinates of the multipliers, frames, steps,
    steps of the multipliers, and the part of them that is made; ``data``: lengths of the steps, parameters; ``ends``:
    1 for the coordinates of the nodes that count; the points and which of their entries are prescribed; columns; the
    mean step; from which share on ends are far apart; ``units``: of ``measure``, and its shares; ``limits``: slacks,
    their steps, parts of these, what a multiplier is kept within, units, weights, what measures values, prices.
    """
    run, meet, survey, measure, held_survey, raise_points, move = calls
    (fixed, points, columns, mean, far), (sizes, shares) = ends, units
    slacks, turn, parts, kept, (scales, rate, room), weights, value, prices = limits
    (arrays, met, blocks, raised, extent, judged, held), count = out, data[0].size
    (nodes, gaps, _, largest), (begins, finishes, work), (covectors, frames, gap, coordinates, costates) = (
        met,
        arrays[:3],
        arrays[3:],
    )
    _moved(run, tapes[0], before, data, covectors)
    moved = tapes[0][5]
    at = _put(tapes[1][3], 0, moved)
    _put(tapes[1][3], _put(tapes[1][3], at, data[0]), data[1])
    _evaluate(run, tapes[1], count)
    if _meet(meet, (begins, finishes, points, columns, far, work, met)):
        return False
    read = tapes[2][3]
    at = _put(read, _put_rows(read, 0, nodes[0], 0, count + 1), fixed)
    _put(read, _put_rows(read, at, gaps[0], 0, count + 1), covectors)
    _evaluate(run, tapes[2], count + 1)
    at = _read_row(tapes[3][3], moved, nodes[0], costates[0], data)
    new, barrier = held[0], slacks[4]
    if scales.shape[1] > 0:
        _move(move, (0, 1, slacks, turn, parts, kept, new))
        for k in range(count):
            at = _put(tapes[3][3], at, new[1][0, k, 0])
    _evaluate(run, tapes[3], count)
    costs, cost = raised[4:]
    cost[0] = 0.0
    for k in range(count):
        cost[0] += costs[0, k]
    (along, entries, numbers, surveyed), none = judged, held[1]
    _cleared(extent, numbers, surveyed)
    if scales.shape[1] > 0:
        both = (raised[2], raised[3], weights), (new[0], new[1], new[2], slacks[3], barrier)
        _raise(raise_points, (0, 1, both[0], both[1], raised[0], raised[1], held[2]))
        _held_survey(held_survey, (0, 1, both[0], both[1], (scales, rate, room), value, prices, surveyed))
    _survey(survey, (0, 1, (nodes, frames, coordinates, gap), blocks, (*extent, held[3])))
    highest, lowest, support, _, missing, lacking, sums, terms, slopes, curvature = extent
    s = surveyed
    rows = s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8], s[9], s[10]
    of = highest, lowest, support, missing, lacking, sums, terms, slopes, curvature
    trajectory = largest, mean, cost
    _measure(measure, (of, none, trajectory, sizes, (rows, barrier, rate), shares, (along, entries, numbers)))
    return True
