"""A trial on one trajectory by a discretization map, compiled: from a step to the system where it leads."""

from functools import cache

import numpy as np

from ....kernels import pasted
from ....linked import address, put, view
from .trial_kernels import (
    AT_RUN,
    TRIAL,
    clear,
    costates_of,
    evaluate,
    held_of,
    in_frames,
    lengths_of,
    meet_ends,
    move_covectors,
    move_slacks,
    nodes_of,
    part_of,
    point_survey_of,
    price_of,
    put_ends,
    raise_points,
    raised_of,
    read_by,
    steps_of,
    tapes_of,
    u_of,
    x_of,
)
from .vectors import compiled

MOVED, ENDS, FRAMES, STEPS = range(4)  # the tapes


@cache
def addresses() -> tuple[int, ...]:
    """Where the kernels stand in this process that are those of a discretization map."""
    return address(trial, TRIAL), 0, 0, 0, 0, 0


@pasted
def _move_unknowns(run: int, tapes: tuple, known: tuple, steps: np.ndarray, lengths: tuple, part: float) -> None:
    """Write the unknowns after a part of the steps; they stay as they are after none."""
    (x, u), (h, parameters) = known, lengths
    if part == 0:
        put(tapes[7], put(tapes[7], 0, x, 0, x.size), u, 0, u.size)
        return
    read, moves = read_by(tapes, MOVED), view(steps, 0, (steps.size,))
    at = put(read, put(read, 0, x, 0, x.size), u, 0, u.size)
    for i in range(moves.size):
        read[at + i] = part * moves[i]
    put(read, put(read, at + moves.size, h, 0, h.size), parameters, 0, parameters.size)
    evaluate(run, tapes[5][MOVED], tapes, h.size)


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
    """The system after a part of a step; whether the ends of the steps are near each other, else there is none.

    ``before``: where it sets out from, with the step; ``sizes``: from which share on ends are far apart, and what a
    multiplier is kept within; see ``pursuit_kernels.pursue`` for the others.
    """
    tapes, nodal = tapes_of(programs, memory, written, rows), move_covectors(before, written, rows)
    (h, parameters, _, _), run, table = lengths_of(setting, rows), calls[AT_RUN], tapes[5]
    known, part = (x_of(before, rows), u_of(before, rows)), part_of(before, rows)[0]
    _move_unknowns(run, tapes, known, steps_of(before, rows), (h, parameters), part)
    read, moved = read_by(tapes, ENDS), view(written, 0, (table[MOVED, 9],))
    put(read, put(read, put(read, 0, moved, 0, moved.size), h, 0, h.size), parameters, 0, parameters.size)
    if not meet_ends(calls, ENDS, tapes, setting, sizes[0], rows):
        return False
    in_frames(run, FRAMES, tapes, setting, nodal, rows)
    read, limited = read_by(tapes, STEPS), price_of(given, rows).shape[3] > 0
    at = put_ends(read, put(read, 0, moved, 0, moved.size), nodes_of(written, rows), costates_of(written, rows))
    at = put(read, put(read, at, h, 0, h.size), parameters, 0, parameters.size)
    if limited:
        multipliers = move_slacks(calls, before, written, given, rows, sizes[1])
        put(read, at, multipliers, 0, multipliers.size)
    evaluate(run, table[STEPS], tapes, h.size)
    if limited:
        raise_points(calls, given, written, rows, raised_of(written, rows), held_of(written, rows)[1])
    points = point_survey_of(written, rows)
    clear(view(points, 0, (points.size,)))
    return True
