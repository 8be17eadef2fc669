"""A trial on one trajectory by Gauss's method, compiled: from a step to the condensed system where it leads, and from a
step of that to the whole one."""

from functools import cache

import numpy as np
from numba import types
from numba.core.typing.templates import signature

from ....kernels import pasted
from ....linked import address, array, called, put, view
from . import condensing_kernels, extent_kernels
from .condensing_kernels import place
from .trial_kernels import (
    AFTER,
    AT_OWN,
    AT_RUN,
    COMPLETE,
    F1,
    F2,
    F3,
    F4,
    F5,
    TRIAL,
    WHOLE,
    barrier_of,
    change_of,
    clear,
    costates_of,
    costs_of,
    evaluate,
    in_frames,
    laid_parts,
    lengths_of,
    meet_ends,
    move_covectors,
    move_slacks,
    multipliers_of,
    nodes_of,
    part_of,
    point_survey_of,
    price_of,
    put_ends,
    raise_points,
    read_by,
    tapes_of,
    ways_of,
)
from .vectors import compiled, inner

CENTRES, CONTROLS, ENDS, FRAMES, POINTS, BOTH = range(6)  # the tapes
# What the kernels here work with, in the order of ``collocation_trial.OWN``.
MOVED = F1, F1, F3, F3, F3, F2, F1, F4, F3
POINT, END, TABLE = types.UniTuple(F4, 4), types.UniTuple(F3, 4), types.Tuple((F1, F2, F1))
KEPT, BLOCKS, BOTH_SLOPES = types.Tuple((F3, array(2, WHOLE), F3)), types.UniTuple(F3, 6), types.UniTuple(F2, 2)
WORK, ROWS = types.Tuple((F2, F2, F2, F1, F2)), types.UniTuple(F1, 3)
(moved_of, points_of, both_of, kept_of, condensed_of), _after = laid_parts(
    MOVED, (F4, F4, F4, F4), (F3, F3, F3, F3), (F3, array(2, WHOLE), F3), (F3, F3, F3, F3, F3, F3), after=AFTER
)
(slopes_of, asked_of, work_of, stepped_of, sums_of, limited_of), _ = laid_parts(
    (F3, F3, F2, (F2, F2), (F2, F2)),
    (F4, F4, F4, F3),
    (F2, F2, F2, F1, F2),
    (F2, F3, F2, (F1, F1, F1), (F2, F2)),
    (F2, F2, F2),
    (F5, F4, F5),
    after=_after,
)

CONDENSE = signature(types.none, WHOLE, WHOLE, POINT, END, TABLE, WORK, KEPT, BLOCKS)
SLOPES = signature(types.none, WHOLE, WHOLE, types.UniTuple(F3, 2), F2, F3, TABLE, BOTH_SLOPES, BOTH_SLOPES)
SURVEY_POINTS = signature(types.none, WHOLE, WHOLE, F4, F4, F4, F3, F3)
EXPAND = signature(
    types.none,
    WHOLE,
    WHOLE,
    POINT,
    END,
    TABLE,
    ROWS,
    KEPT,
    types.Tuple((F2, F2, F2, WHOLE, F3, F2)),
    BOTH_SLOPES,
)

_condense, _slopes, _survey_points, _expand = called(CONDENSE), called(SLOPES), called(SURVEY_POINTS), called(EXPAND)


@cache
def addresses() -> tuple[int, ...]:
    """Where the kernels stand in this process that are those of a Gauss method."""
    return (
        address(trial, TRIAL),
        address(complete, COMPLETE),
        address(condensing_kernels.condense, CONDENSE),
        address(condensing_kernels.slopes, SLOPES),
        address(extent_kernels.survey_points, SURVEY_POINTS),
        address(condensing_kernels.expand, EXPAND),
    )


@inner
def _turned(known: tuple, moves: tuple, part: float, moved: tuple) -> None:
    """Velocities in the frames at the moved centres, and covectors at the points."""
    (_, _, _, given, _, _, _, frames, multipliers), (_, _, turns, velocities, _, _, covectors, _, _) = known, moved
    (velocity_steps, multiplier_steps), (count, stages, n), size = moves, velocities.shape, frames.shape[3]
    for k in range(count):
        for i in range(stages):
            at, first = (k * stages + i) * size, i * n
            for a in range(n):
                value = 0.0
                for c in range(n):
                    value += turns[k, a, c] * (given[k, i, c] + part * velocity_steps[k, first + c])
                velocities[k, i, a] = value
            for e in range(size):
                covectors[at + e] = 0.0
            for a in range(n):
                f = multipliers[k, i, a] + part * multiplier_steps[k, first + a]
                for e in range(size):
                    covectors[at + e] += f * frames[k, i, a, e]


@inner
def _along(velocities: np.ndarray, lengths: tuple, xi: np.ndarray, eta: np.ndarray) -> None:
    """``xi_i = h sum_j matrix_ij nu_j`` and ``eta = h sum_j b_j nu_j``."""
    (h, _, matrix, weights), (count, stages, n) = lengths, velocities.shape
    for k in range(count):
        for a in range(n):
            eta[k, a] = 0.0
            for j in range(stages):
                eta[k, a] += h[k] * weights[j] * velocities[k, j, a]
            for i in range(stages):
                xi[k, i, a] = 0.0
                for j in range(stages):
                    xi[k, i, a] += h[k] * matrix[i, j] * velocities[k, j, a]


@pasted
def _move_unknowns(
    run: int, tapes: tuple, known: tuple, stepped: tuple, lengths: tuple, part: float, moved: tuple
) -> None:
    """Write the unknowns after a part of the steps, and the vectors to points and ends; they stay as they are after
    none."""
    (x, u, _, given, _, _, covectors, _, _), (steps, _, _, _, moves) = known, stepped
    _, _, _, velocities, xi, eta, new, _, _ = moved
    count, stages, n = velocities.shape
    if part == 0:
        put(moved[0], 0, x, 0, x.size)
        put(moved[1], 0, u, 0, u.size)
        put(velocities, 0, given, 0, given.size)
        put(new, 0, covectors, 0, covectors.size)
    else:
        read, m = read_by(tapes, CENTRES), steps.shape[1] - n
        at = put(read, 0, x, 0, x.size)
        for k in range(count):
            for a in range(n):
                read[at + k * n + a] = part * steps[k, a]
        evaluate(run, tapes[5][CENTRES], tapes, count)
        read = read_by(tapes, CONTROLS)
        at = put(read, 0, u, 0, u.size)
        for k in range(count):
            for i in range(m):
                read[at + k * m + i] = part * steps[k, n + i]
        evaluate(run, tapes[5][CONTROLS], tapes, count * stages)
        _turned(known, moves, part, moved)
    _along(velocities, lengths, xi, eta)


@pasted
def _read_points(read: np.ndarray, moved: tuple, lengths: tuple, weights: np.ndarray) -> int:
    """What the tape of the points reads but for multipliers of inequalities, where these go; and their weights."""
    (x, u, _, velocities, xi, _, covectors, _, _), (h, parameters, _, b) = moved, lengths
    (count, stages, _), at = velocities.shape, 0
    size = x.size // count
    for k in range(count):
        for _ in range(stages):
            at = put(read, at, x, k * size, size)
    at = put(read, put(read, at, xi, 0, xi.size), velocities, 0, velocities.size)
    at = put(read, put(read, at, u, 0, u.size), covectors, 0, covectors.size)
    for k in range(count):
        for i in range(stages):
            weights[0, k, i] = h[k] * b[i]
    return put(read, put(read, at, weights, 0, weights.size), parameters, 0, parameters.size)


@inner
def _columns(missed: np.ndarray, pull: np.ndarray, defects: np.ndarray, pulls: np.ndarray) -> None:
    """What the points lack, and the slopes of the ends, in two columns; inequalities have no share in them."""
    for k in range(missed.shape[1]):
        for i in range(missed.shape[2]):
            for a in range(missed.shape[3]):
                defects[k, i, a, 0], defects[k, i, a, 1] = missed[0, k, i, a], 0.0
        for a in range(pull.shape[1]):
            pulls[k, a, 0], pulls[k, a, 1] = pull[k, a], 0.0


@inner
def _driven(columns: np.ndarray, barrier: float, slopes: np.ndarray) -> None:
    """The slopes of the points with the share of the inequalities at their barrier."""
    for k in range(slopes.shape[0]):
        for i in range(slopes.shape[1]):
            for a in range(slopes.shape[2]):
                slopes[k, i, a] = columns[0, k, i, a, 0] + barrier * columns[0, k, i, a, 1]


@inner
def _ways(w: np.ndarray, velocities: np.ndarray, of: tuple, ways: np.ndarray) -> None:
    """The steps ``(dx, dxi, dnu, du)`` of the points."""
    (h, matrix, _), (_, count, stages, q) = of, ways.shape
    n = velocities.shape[1] // stages
    for k in range(count):
        for i in range(stages):
            place(ways[0, k, i], w[k], velocities[k], h[k], matrix[i], (n, q - 3 * n, i))


@inner
def _sums(of_points: np.ndarray, costs: np.ndarray, gap: np.ndarray, moved: tuple, lacks: np.ndarray) -> None:
    """The costs of the steps; and what the nodes lack once the velocities mend what the points lack."""
    before, after = moved
    for k in range(of_points.shape[0]):
        costs[0, k] = 0.0
        for i in range(of_points.shape[1]):
            costs[0, k] += of_points[k, i]
    put(lacks, 0, gap, 0, gap.size)
    for k in range(before.shape[0]):
        for a in range(before.shape[1]):
            lacks[k, a] += before[k, a, 0]
            lacks[k + 1, a] -= after[k, a, 0]


@compiled
def trial(
    calls: tuple,
    programs: np.ndarray,
    memory: np.ndarray,
    before: np.ndarray,
    written: np.ndarray,
    setting: np.ndarray,
    given: np.ndarray,
    rows: np.ndarray,
    sizes: tuple,
) -> bool:
    """The condensed system after a part of a step; whether the ends of the steps are near each other, else there is
    none; see ``one_stage_kernels.trial``."""
    tapes, nodal = tapes_of(programs, memory, written, rows), move_covectors(before, written, rows)
    lengths, run, table, part = lengths_of(setting, rows), calls[AT_RUN], tapes[5], part_of(before, rows)[0]
    moved, (h, _, matrix, b) = moved_of(written, rows), lengths
    _move_unknowns(run, tapes, moved_of(before, rows), stepped_of(before, rows), lengths, part, moved)
    (x, _, _, velocities, _, eta, _, _, _), of = moved, (h, matrix, b)
    read = read_by(tapes, ENDS)
    put(read, put(read, 0, x, 0, x.size), eta, 0, eta.size)
    if not meet_ends(calls, ENDS, tapes, setting, sizes[0], rows):
        return False
    in_frames(run, FRAMES, tapes, setting, nodal, rows)
    (defect, multipliers, pulled, weights), limited = asked_of(written, rows), price_of(given, rows).shape[3] > 0
    read = read_by(tapes, POINTS)
    at = _read_points(read, moved, lengths, weights)
    if limited:
        pushing = move_slacks(calls, before, written, given, rows, sizes[1])
        put(read, at, pushing, 0, pushing.size)
    evaluate(run, table[POINTS], tapes, h.size * velocities.shape[1])
    read, nodes, costates = read_by(tapes, BOTH), nodes_of(written, rows), costates_of(written, rows)
    put_ends(read, put(read, put(read, 0, x, 0, x.size), eta, 0, eta.size), nodes, costates)
    evaluate(run, table[BOTH], tapes, h.size)
    kept, blocks, (slope, gradient, pull, inside, outer) = (
        kept_of(written, rows),
        condensed_of(written, rows),
        slopes_of(written, rows),
    )
    points, both = points_of(written, rows), both_of(written, rows)
    if limited:
        hessian, at_points, columns = limited_of(written, rows)
        raise_points(calls, given, written, rows, (hessian, at_points), columns)
        _columns(defect, pull, points[3], both[3])
    _condense(calls[AT_OWN], (0, h.size, points, both, of, work_of(written, rows), kept, blocks))
    _slopes(calls[AT_OWN + 1], (0, h.size, (slope, gradient), pull, kept[2], of, inside, outer))
    survey, (lacks, gap, costs) = point_survey_of(written, rows), sums_of(written, rows)
    clear(view(survey, 0, (survey.size,)))
    _survey_points(calls[AT_OWN + 2], (0, 1, defect, multipliers, pulled, weights, survey))
    _sums(costs, costs_of(written, rows), gap, (blocks[4], blocks[5]), lacks)
    return True


@compiled
def complete(calls: tuple, written: np.ndarray, setting: np.ndarray, rows: np.ndarray) -> None:
    """The steps of the velocities and of the multipliers of the points; and what these change to first order: the cost,
    and the multipliers on what is lacking."""
    (h, _, matrix, b), (w, slopes, pulls, room, found) = lengths_of(setting, rows), stepped_of(written, rows)
    multipliers, change = multipliers_of(written, rows), change_of(written, rows)
    points, both, kept = points_of(written, rows), both_of(written, rows), kept_of(written, rows)
    (count, z), n, ways = w.shape, both[1].shape[1], ways_of(written, rows)
    limited = points[2].shape[3] > 1  # slopes have a second column
    if limited:
        _driven(limited_of(written, rows)[2], barrier_of(written, rows)[0], slopes)
    nodes = view(multipliers, 0, (count, n)), view(multipliers, n, (count, n))
    solved = w, nodes[0], nodes[1], z, slopes, pulls
    _expand(calls[AT_OWN + 3], (0, count, points, both, (h, matrix, b), room, kept, solved, found))
    (velocities, lambdas), inside = found, slopes_of(written, rows)[3]
    if limited:
        _ways(w, velocities, (h, matrix, b), ways)
    defect, change[0], change[1] = view(asked_of(written, rows)[0], 0, velocities.shape), 0.0, 0.0
    for k in range(count):
        for i in range(velocities.shape[1]):
            value = velocities[k, i]
            for j in range(z):
                value -= kept[2][k, i, j] * w[k, j]
            change[0] += inside[1][k, i] * value
            change[1] += lambdas[k, i] * defect[k, i]
