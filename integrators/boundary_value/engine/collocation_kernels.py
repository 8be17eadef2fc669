"""A trial on one trajectory by Gauss's method, compiled: from a step to the condensed system where it leads, and from a
step of that to the whole one."""

from functools import cache

import numpy as np
from numba import types
from numba.core.typing.templates import signature

from ....kernels import pasted
from ....linked import address, array, called, laid, put, view
from . import condensing_kernels, extent_kernels
from .trial_kernels import (
    AT_OWN,
    AT_RUN,
    COMPLETE,
    F1,
    F2,
    F3,
    F4,
    TRIAL,
    WHOLE,
    clear,
    covectors,
    evaluate,
    in_frames,
    laid_out,
    meet_ends,
    put_ends,
    read_by,
)
from .vectors import compiled, inner

CENTRES, CONTROLS, ENDS, FRAMES, POINTS, BOTH = range(6)  # the tapes
# What the kernels here work with, in the order of ``collocation_trial.OWN``.
MOVED = F1, F1, F3, F3, F3, F2, F1
POINT, END, TABLE = types.UniTuple(F4, 4), types.UniTuple(F3, 4), types.Tuple((F1, F2, F1))
KEPT, BLOCKS, BOTH_SLOPES = types.Tuple((F3, array(2, WHOLE), F3)), types.UniTuple(F3, 6), types.UniTuple(F2, 2)
WORK, ROWS = types.Tuple((F2, F2, F2, F1, F2)), types.UniTuple(F1, 3)
ARRAYS = (
    MOVED,
    (F4, F4, F4, F4),
    (F3, F3, F3, F3),
    (F3, array(2, WHOLE), F3),
    (F3, F3, F3, F3, F3, F3),
    (F3, F3, F2, (F2, F2), (F2, F2)),
    (F4, F4, F4, F3),
    (F2, F2, F2, F1, F2),
    (F2, F3, F2, (F1, F1, F1), (F2, F2)),
    (F2, F2, F2),
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

_laid = laid(ARRAYS)
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
def _turned(before: tuple, moved: tuple) -> None:
    """Velocities in the frames at the moved centres, and covectors at the points."""
    (_, _, given, _, _, known, steps, _, _, part), (_, _, turns, velocities, _, _, covectors) = before, moved
    (count, stages, n), fraction = velocities.shape, part[0]
    own, size = count * stages * n, covectors.size // (count * stages)
    for k in range(count):
        for i in range(stages):
            first = (k * stages + i) * n
            for a in range(n):
                value = 0.0
                for c in range(n):
                    value += turns[k, a, c] * (given[first + c] + fraction * steps[first + c])
                velocities[k, i, a] = value
            at = (k * stages + i) * size
            for e in range(size):
                covectors[at + e] = 0.0
            for a in range(n):
                f = known[own * size + first + a] + fraction * steps[own + first + a]
                for e in range(size):
                    covectors[at + e] += f * known[(first + a) * size + e]


@inner
def _along(velocities: np.ndarray, data: tuple, xi: np.ndarray, eta: np.ndarray) -> None:
    """``xi_i = h sum_j matrix_ij nu_j`` and ``eta = h sum_j b_j nu_j``."""
    (h, _, matrix, weights), (count, stages, n) = data, velocities.shape
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
def _move_unknowns(run: int, tapes: tuple, before: tuple, data: tuple, moved: tuple) -> None:
    """Write the unknowns after a part of the steps, if there are steps, and the vectors to points and ends."""
    (x, u, given, steps, _, known, _, _, _, part), (_, _, _, velocities, xi, eta, covectors) = before, moved
    count, stages, n = velocities.shape
    if steps.size > 0:
        z = steps.size // count
        read = read_by(tapes, CENTRES)
        at = put(read, 0, x, 0, x.size)
        for k in range(count):
            for a in range(n):
                read[at + k * n + a] = part[0] * steps[k * z + a]
        evaluate(run, tapes[5][CENTRES], tapes, count)
        read = read_by(tapes, CONTROLS)
        at, m = put(read, 0, u, 0, u.size), z - n
        for k in range(count):
            for i in range(m):
                read[at + k * m + i] = part[0] * steps[k * z + n + i]
        evaluate(run, tapes[5][CONTROLS], tapes, count * stages)
        _turned(before, moved)
    else:
        put(moved[0], 0, x, 0, x.size)
        put(moved[1], 0, u, 0, u.size)
        put(velocities, 0, given, 0, given.size)
        put(covectors, 0, known, 0, covectors.size)
    _along(velocities, data, xi, eta)


@pasted
def _read_points(read: np.ndarray, moved: tuple, data: tuple, weights: np.ndarray) -> None:
    """What the tape of the points reads; and their weights."""
    (x, u, _, velocities, xi, _, covectors), (h, parameters, _, b) = moved, data
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
    put(read, put(read, at, weights, 0, weights.size), parameters, 0, parameters.size)


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
    tapes: tuple,
    before: tuple,
    data: tuple,
    ends: tuple,
    limits: tuple,
    places: np.ndarray,
    own: np.ndarray,
) -> bool:
    """The condensed system after a part of a step; whether the ends of the steps are near each other, else there is
    none."""
    out, count = laid_out(tapes[7], places), data[0].size
    moved, points, both, kept, blocks, sloped, asked, work, _, sums = _laid(tapes[7], own)
    (_, _, _, nodal, _, _, _, costates), (nodes, _, _, _), survey, (h, _, matrix, b) = out[0], out[1], out[5][4], data
    (x, _, _, velocities, _, eta, _), (slope, gradient, pull, inside, outer), of = moved, sloped, (h, matrix, b)
    covectors(before, nodal)
    _move_unknowns(calls[AT_RUN], tapes, before, data, moved)
    read = read_by(tapes, ENDS)
    put(read, put(read, 0, x, 0, x.size), eta, 0, eta.size)
    if not meet_ends(calls, ENDS, tapes, ends, out[0], out[1], count):
        return False
    in_frames(calls[AT_RUN], FRAMES, tapes, ends[0], nodal, out[1])
    _read_points(read_by(tapes, POINTS), moved, data, asked[3])
    evaluate(calls[AT_RUN], tapes[5][POINTS], tapes, count * velocities.shape[1])
    read = read_by(tapes, BOTH)
    put_ends(read, put(read, put(read, 0, x, 0, x.size), eta, 0, eta.size), nodes, costates)
    evaluate(calls[AT_RUN], tapes[5][BOTH], tapes, count)
    _condense(calls[AT_OWN], (0, count, points, both, of, work, kept, blocks))
    _slopes(calls[AT_OWN + 1], (0, count, (slope, gradient), pull, kept[2], of, inside, outer))
    clear(view(survey, 0, (survey.size,)))
    _survey_points(calls[AT_OWN + 2], (0, 1, *asked, survey))
    _sums(sums[2], out[3][4], sums[1], (blocks[4], blocks[5]), sums[0])
    return True


@compiled
def complete(
    calls: tuple, written: np.ndarray, change: np.ndarray, data: tuple, places: np.ndarray, own: np.ndarray
) -> None:
    """The steps of the velocities and of the multipliers of the points; and what these change to first order: the cost,
    and the multipliers on what is lacking."""
    multipliers, (h, _, matrix, b) = laid_out(written, places)[8][4], data
    _, points, both, kept, _, (_, _, _, inside, _), asked, _, stepped, _ = _laid(written, own)
    w, slopes, pulls, rows, found = stepped
    (count, z), n = w.shape, both[1].shape[1]
    nodes = view(multipliers, 0, (count, n)), view(multipliers, n, (count, n))
    solved = w, nodes[0], nodes[1], z, slopes, pulls
    _expand(calls[AT_OWN + 3], (0, count, points, both, (h, matrix, b), rows, kept, solved, found))
    velocities, lambdas = found
    defect, change[0], change[1] = view(asked[0], 0, velocities.shape), 0.0, 0.0
    for k in range(count):
        for i in range(velocities.shape[1]):
            value = velocities[k, i]
            for j in range(z):
                value -= kept[2][k, i, j] * w[k, j]
            change[0] += inside[1][k, i] * value
            change[1] += lambdas[k, i] * defect[k, i]
