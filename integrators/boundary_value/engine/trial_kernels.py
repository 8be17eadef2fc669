"""Parts of the compiled passes on one trajectory: tapes, frames at the nodes, and what a trial is judged by.

A trial itself, from a step to its system, is a kernel of the transcription (``one_stage_kernels``,
``collocation_kernels``), which a pass calls by its address.
"""

from functools import cache
from typing import Any

import numpy as np
from numba import types
from numba.core.typing.templates import signature

from ....kernels import kernel_part, pasted
from ....linked import address, array, called, laid, leaves, put, view
from ....tape import machine
from . import elimination_kernels, extent_kernels, scaling_kernels
from .arrays import LANES
from .trial_shapes import OUT
from .vectors import add, filled, inner, part, put_part

REAL, WHOLE, TRUTH = types.float64, types.int64, types.boolean
F1, F2, F3, F4, F5 = map(array, range(1, 6))

FIVE, THREE = types.Tuple((F4, F4, F4, F4, F1)), types.Tuple((F4, F4, F4))
INEQUALITIES, TRAJECTORY, BLOCKS = (
    types.Tuple((F4, F5, F4)),
    types.Tuple((F3, F4, F3, F3)),
    types.Tuple((F4, F4, F4, F3, F3)),
)
EXTENT = F2, F2, F3, F2, F2, F2, F1, F2, F2, F2  # the fields of ``Extent``
FLAGS, PLACES, INDICES = array(1, TRUTH), array(2, WHOLE), array(1, WHOLE)
MET = types.Tuple((F2, F2, FLAGS, FLAGS))


def laid_parts(*forms: Any, after: int) -> tuple[list[Any], int]:
    """For each form what lays its arrays, whose rows of the table stand one after the other; and where those end."""
    found = []
    for form in forms:
        found.append(laid(form, after))
        after += leaves(form)
    return found, after


# What a pass takes and gives, each in one vector. What it gives, in the order of ``trial.OUT``:
(arrays_of, met_of, blocks_of, raised_of, values_of, paid_of), _after = laid_parts(
    (F3, F3, F2, F1, F4, F3, F3, F3),
    (F3, F3, array(2, TRUTH), F2),
    (F4, F4, F4, F3, F3),
    (F5, F4),
    (F4, F5),
    (F2, F1),
    after=0,
)
(extent_of, told_of, held_of, found_of, _, turned_of, ways_of), _after = laid_parts(
    EXTENT,
    (F2, F2, F2, F2, F3),
    ((F4, F4, F4), F5, F1),
    (F4, F4, F4, F4, array(2, TRUTH), F2, (F1, F1, F1, F1), F1, F1),
    (F1, F1),
    ((F1, F1), (F4, F4, F4), F2, F1),
    F4,
    after=_after,
)
# What of these is asked for alone.
cost_of, standing_of, x_of, u_of, covectors_of, change_of, barrier_of, part_of, dual_of = (
    laid(F1, OUT.index(name))
    for name in ("cost", "standing", "x/", "u/", "covectors", "change", "barrier", "part", "dual")
)
along_of, numbers_of, grown_of, lacking_of, curvature_of, sizes_of = (
    laid(F2, OUT.index(name)) for name in ("along", "numbers", "grown", "lacking", "curvature", "sizes")
)
largest_of, costs_of, line_of, surveyed_of, way_of = (
    laid(F2, OUT.index(name)) for name in ("largest", "costs", "work", "surveyed", "turned")
)
nodes_of, gap_of, coordinates_of, costates_of, point_survey_of, gradient_of = (
    laid(F3, OUT.index(name)) for name in ("nodes", "gap", "coordinates", "costates", "points", "gradient")
)
frames_of, lacks_of, steps_of, multipliers_of, driven_of = (
    laid(F4, OUT.index(name)) for name in ("frames", "lacks|", "steps|", "multipliers|", "driven|")
)
spread_of = laid((F2, F2, F3), OUT.index("highest"))
# The programs of a trial, one after the other, and a table of where each stands, reads and writes.
(programs_of,), _after = laid_parts(
    (array(1, types.uint8), array(2, types.uint32), F1, PLACES, PLACES, PLACES), after=_after
)
# What stays the same: lengths of the steps, parameters, a tableau; 1 for the coordinates of the nodes that count; the
# ends, and which of their entries are prescribed; columns and arrays of the entries; the mean step.
(lengths_of, fixed_of, ends_of, columns_of, mean_of), _after = laid_parts(
    (F1, F1, F2, F1), F1, (F2, F2, FLAGS, FLAGS), (INDICES, INDICES), F1, after=_after
)
# What is given to a pass: units of success and of steps, in the orders of ``measure`` and of an elimination, and what
# raises Hessians; prices, units, room, and weights of the inequalities.
(units_of, wide_of, raising_of, price_of, limits_of, weights_of), _after = laid_parts(
    (F2, F2, F1, F2, F1), (F2, F2, F1), (F1, F2), F4, (F2, F1, F1), F4, after=_after
)
# What an elimination works in; and what units are found in.
(work_of, factors_of, unit_work_of, unit_sizes_of), AFTER = laid_parts(
    (F2, F2, F2, F2),
    (F2, F2, INDICES, INDICES, F2),
    ((F2, F2, F1, F2, F3, F3, F2, F2, F2, F2, F3), INDICES),
    ((F2, F2, F2), FLAGS),
    after=_after,
)  # the rows of what a transcription has for itself stand after these

# Which address is whose; those from ``AT_OWN`` on are for what a transcription has for itself.
AT_RUN, AT_MEET, AT_SURVEY, AT_MEASURE, AT_SOLVE, AT_UNITS = range(6)
# Of inequalities:
AT_HELD_SURVEY, AT_RAISE, AT_TURN_POINTS, AT_MOVE, AT_LOWER, AT_DRIVE, AT_TURN, AT_JAMMED = range(6, 14)
AT_TRIAL, AT_COMPLETE, AT_OWN = range(14, 17)
ADDRESSES = types.UniTuple(WHOLE, AT_OWN + 4)
# A trial, from what was written before to what it writes: whether ends of steps are near each other.
TRIAL = signature(TRUTH, ADDRESSES, INDICES, F1, F1, F1, F1, F1, PLACES, types.UniTuple(REAL, 2))
COMPLETE = signature(types.none, ADDRESSES, F1, F1, PLACES)
UNITS = signature(
    types.none,
    types.Tuple((F4, F4, F4, F3, F4, F2, F2)),
    types.UniTuple(F2, 3),
    FLAGS,
    types.Tuple((F2, F2, F1, F2, F3, F3, F2, F2, F2, F2, F3)),
    INDICES,
    REAL,
    types.Tuple((F2, F2, F1)),
)
MEET = signature(
    TRUTH,
    F3,
    F3,
    MET,
    INDICES,
    REAL,
    F2,
    types.Tuple((F3, F3, array(2, TRUTH), F2)),
)
SURVEY = signature(types.none, WHOLE, WHOLE, TRAJECTORY, BLOCKS, types.Tuple(EXTENT))
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
    types.none, WHOLE, WHOLE, INEQUALITIES, FIVE, types.Tuple((F2, F1, F1)), REAL, types.UniTuple(REAL, 3), F2
)
RAISE = signature(types.none, WHOLE, WHOLE, INEQUALITIES, FIVE, F5, F4, F5)
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
    types.Tuple((F2, F2, INDICES, INDICES, F2)),
    types.Tuple((F4, F4, array(2, TRUTH), F2)),
    types.UniTuple(F1, 4),
)

solve, trial, complete, units_by = map(called, (SOLVE, TRIAL, COMPLETE, UNITS))

_run, _meet, _survey, _measure = called(machine.RUN), called(MEET), called(SURVEY), called(MEASURE)
_raise, _move, held_survey = called(RAISE), called(MOVE), called(HELD_SURVEY)


@cache
def addresses() -> tuple[int, ...]:
    """Where the kernels stand in this process that all passes call."""
    return (
        address(machine.run, machine.RUN),
        address(extent_kernels.meet, MEET),
        address(extent_kernels.survey, SURVEY),
        address(extent_kernels.measure, MEASURE),
        address(elimination_kernels.solve, SOLVE),
        address(scaling_kernels.units, UNITS),  # the last one
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
def covectors(
    coordinates: np.ndarray, frames: np.ndarray, multipliers: np.ndarray, share: float, out: np.ndarray
) -> None:
    """The covectors at the nodes after a share of the steps of their multipliers."""
    (_, count, n, size), of_nodes = frames.shape, frames[0]
    moved = view(out, 0, (count, size))
    for k in range(count):
        for j in range(0, size, LANES):
            row = filled(0.0)
            for a in range(n):
                f = coordinates[0, k, a] + share * multipliers[0, k, a, 0]
                row = add(row, f, part(of_nodes[k], a, j))
            put_part(moved, k, j, row)


@pasted
def tapes_of(programs: np.ndarray, memory: np.ndarray, written: np.ndarray, rows: np.ndarray) -> tuple:
    """The programs of a trial, a table of where each stands, reads and writes, and where they work and write."""
    codes, registers, values, sources, targets, table = programs_of(programs, rows)
    return codes, registers, values, sources, targets, table, memory, written


@pasted
def move_covectors(before: np.ndarray, written: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Write the covectors at the nodes after the part of the step that is made; they stay as they are after none."""
    given, moved, share = covectors_of(before, rows), covectors_of(written, rows), part_of(before, rows)[0]
    if share == 0:
        put(moved, 0, given, 0, given.size)
    else:
        frames, coordinates = frames_of(before, rows), coordinates_of(before, rows)
        covectors(coordinates, frames, multipliers_of(before, rows), share, moved)
    return moved


@pasted
def meet_ends(calls: tuple, k: int, tapes: tuple, setting: np.ndarray, far: float, rows: np.ndarray) -> bool:
    """Whether the ends of the steps, which the tape ``k`` finds, are near each other; then the nodes are known."""
    evaluate(calls[AT_RUN], tapes[5][k], tapes, lengths_of(setting, rows)[0].size)
    begins, finishes, work, _, _, _, _, _ = arrays_of(tapes[7], rows)
    columns, met = columns_of(setting, rows)[0], met_of(tapes[7], rows)
    return not _meet(calls[AT_MEET], (begins, finishes, ends_of(setting, rows), columns, far, work, met))


@pasted
def in_frames(run: int, k: int, tapes: tuple, setting: np.ndarray, covectors: np.ndarray, rows: np.ndarray) -> None:
    """Frames at the nodes, and in them what is lacking there and the covectors, by the tape ``k``."""
    (nodes, gaps, _, _), read, fixed = met_of(tapes[7], rows), read_by(tapes, k), fixed_of(setting, rows)
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
def slacks_of(written: np.ndarray, given: np.ndarray, rows: np.ndarray) -> tuple:
    """Slacks, multipliers and excesses that are written, their prices, and the barrier."""
    s, nu, t = held_of(written, rows)[0]
    return s, nu, t, price_of(given, rows), barrier_of(written, rows)


@pasted
def inequalities_of(written: np.ndarray, given: np.ndarray, rows: np.ndarray) -> tuple:
    """Values of the inequalities at the points, their derivatives, and their weights."""
    values, pushes = values_of(written, rows)
    return values, pushes, weights_of(given, rows)


@pasted
def move_slacks(
    calls: tuple, before: np.ndarray, written: np.ndarray, given: np.ndarray, rows: np.ndarray, kept: float
) -> np.ndarray:
    """Write slacks, multipliers and excesses after parts of their steps; the multipliers."""
    (parts, turn, _, _), new = turned_of(before, rows), held_of(written, rows)[0]
    _move(calls[AT_MOVE], (0, 1, slacks_of(before, given, rows), turn, parts, kept, new))
    return new[1]


@pasted
def raise_points(
    calls: tuple, given: np.ndarray, written: np.ndarray, rows: np.ndarray, points: tuple, slopes: np.ndarray
) -> None:
    """Add the share of the inequalities to the Hessians of the points; and their slopes in two columns."""
    (hessian, slope), held = points, inequalities_of(written, given, rows)
    _raise(calls[AT_RAISE], (0, 1, held, slacks_of(written, given, rows), hessian, slope, slopes))


@pasted
def survey(calls: tuple, written: np.ndarray, given: np.ndarray, rows: np.ndarray, sizes: tuple) -> None:
    """What is largest in what is written; ``sizes``: what measures values and prices of inequalities."""
    (_, _, zeros), limits, extent = held_of(written, rows), limits_of(given, rows), extent_of(written, rows)
    costs, cost = paid_of(written, rows)
    clear(zeros)
    for i in range(extent[0].size):
        extent[0][0, i], extent[1][0, i] = -np.inf, -np.inf
    cost[0] = 0.0
    for k in range(costs.size):
        cost[0] += costs[0, k]
    if limits[0].shape[1] > 0:
        held, slacks = inequalities_of(written, given, rows), slacks_of(written, given, rows)
        told = surveyed_of(written, rows)
        held_survey(calls[AT_HELD_SURVEY], (0, 1, held, slacks, limits, sizes[0], sizes[1], told))
    trajectory = (
        nodes_of(written, rows),
        frames_of(written, rows),
        coordinates_of(written, rows),
        gap_of(written, rows),
    )
    _survey(calls[AT_SURVEY], (0, 1, trajectory, blocks_of(written, rows), extent))


@pasted
def measure(
    calls: tuple, written: np.ndarray, setting: np.ndarray, given: np.ndarray, rows: np.ndarray, shares: tuple
) -> None:
    """What the trial is judged by, in numbers that come as zeros."""
    along, entries, numbers, surveyed, points = told_of(written, rows)
    highest, lowest, support, _, missing, lacking, total, parts, slopes, curvature = extent_of(written, rows)
    of = highest, lowest, support, missing, lacking, total, parts, slopes, curvature
    limits = surveyed, barrier_of(written, rows), limits_of(given, rows)[1]
    trajectory = largest_of(written, rows), mean_of(setting, rows), cost_of(written, rows)
    found = along, entries, numbers
    _measure(calls[AT_MEASURE], (of, points, trajectory, units_of(given, rows), limits, shares, found))
