"""A trial on one trajectory by a discretization map, compiled: from a step to the system where it leads."""

from functools import cache

import numpy as np

from ....kernels import pasted
from ....linked import address, called, put, view
from . import inequality_kernels
from .trial_kernels import (
    AT_OWN,
    AT_RUN,
    MOVE,
    TRIAL,
    clear,
    covectors,
    evaluate,
    in_frames,
    laid_out,
    meet_ends,
    put_ends,
    read_by,
)
from .vectors import compiled

MOVED, ENDS, FRAMES, STEPS = range(4)  # the tapes
_move = called(MOVE)


@cache
def addresses(limited: bool) -> tuple[int, ...]:
    """Where the kernels stand in this process that are those of a discretization map."""
    return address(trial, TRIAL), 0, address(inequality_kernels.move, MOVE) if limited else 0, 0, 0, 0


@pasted
def _move_unknowns(run: int, tapes: tuple, before: tuple, data: tuple) -> None:
    """Write the unknowns after a part of the steps, if there are steps."""
    (x, u, _, steps, _, _, _, _, _, part), (h, parameters, _, _) = before, data
    if steps.size == 0:
        put(tapes[7], put(tapes[7], 0, x, 0, x.size), u, 0, u.size)
        return
    read = read_by(tapes, MOVED)
    at = put(read, put(read, 0, x, 0, x.size), u, 0, u.size)
    for i in range(steps.size):
        read[at + i] = part[0] * steps[i]
    put(read, put(read, at + steps.size, h, 0, h.size), parameters, 0, parameters.size)
    evaluate(run, tapes[5][MOVED], tapes, h.size)


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
    """The system after a part of a step; whether the ends of the steps are near each other, else there is none."""
    out, count = laid_out(tapes[7], places), data[0].size
    (_, _, _, nodal, _, _, _, costates), (nodes, _, _, _), points = out[0], out[1], out[5][4]
    (slacks, turn, parts, kept), new, (h, parameters, _, _) = limits, out[6][0], data
    covectors(before, nodal)
    _move_unknowns(calls[AT_RUN], tapes, before, data)
    moved = view(tapes[7], 0, (tapes[5][MOVED, 9],))
    read = read_by(tapes, ENDS)
    put(read, put(read, put(read, 0, moved, 0, moved.size), h, 0, count), parameters, 0, parameters.size)
    if not meet_ends(calls, ENDS, tapes, ends, out[0], out[1], count):
        return False
    in_frames(calls[AT_RUN], FRAMES, tapes, ends[0], nodal, out[1])
    read = read_by(tapes, STEPS)
    at = put_ends(read, put(read, 0, moved, 0, moved.size), nodes, costates)
    at = put(read, put(read, at, h, 0, count), parameters, 0, parameters.size)
    if new[1].size > 0:
        _move(calls[AT_OWN], (0, 1, slacks, turn, parts, kept, new))
        put(read, at, new[1], 0, new[1].size)
    evaluate(calls[AT_RUN], tapes[5][STEPS], tapes, count)
    clear(view(points, 0, (points.size,)))
    return True
