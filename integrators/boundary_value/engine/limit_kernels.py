"""What a compiled pass does with inequalities beside trials: kernels of their own, compiled where there are some."""

from functools import cache

import numpy as np
from numba import types
from numba.core.typing.templates import signature

from ....linked import address, called, view
from . import inequality_kernels as kernels
from .inequality_kernels import lowered
from .trial_kernels import (
    ADDRESSES,
    AT_HELD_SURVEY,
    AT_TURN_POINTS,
    F1,
    F2,
    F4,
    FIVE,
    HELD_SURVEY,
    INEQUALITIES,
    MOVE,
    PLACES,
    RAISE,
    REAL,
    THREE,
    TRUTH,
    WHOLE,
    barrier_of,
    clear,
    driven_of,
    held_of,
    held_survey,
    inequalities_of,
    limits_of,
    measure,
    numbers_of,
    part_of,
    slacks_of,
    surveyed_of,
    turned_of,
    ways_of,
)
from .vectors import compiled, inner

# What stands between the trials of a pass.
PROMISED, TURNED, MISSING, COST, HELD, FUNNEL, BEST, FIRST, CORRECTION, ISOLATED, SHIFT = range(11)
SAME, LESS, CHEAP = range(3)  # what becomes of a barrier: it stays, it is lowered, or excesses are too cheap for that

RULES = types.Tuple(
    (REAL, REAL, types.UniTuple(REAL, 5), types.Tuple((REAL, types.UniTuple(REAL, 3))), types.UniTuple(REAL, 3))
)
LOWER = signature(WHOLE, ADDRESSES, F1, F1, F1, PLACES, F1, RULES)
DRIVE = signature(types.none, F1, PLACES)
TURN = signature(types.none, ADDRESSES, F1, F1, PLACES, REAL)
JAMMED = signature(TRUTH, F1, F1, PLACES, REAL, REAL, REAL)
TURN_POINTS = signature(types.none, WHOLE, WHOLE, INEQUALITIES, FIVE, F4, REAL, THREE, F2)
lower, drive, turn, is_jammed = called(LOWER), called(DRIVE), called(TURN), called(JAMMED)
_turn_points = called(TURN_POINTS)


@cache
def addresses() -> tuple[int, ...]:
    """Where the kernels stand in this process."""
    of_points = (kernels.survey, HELD_SURVEY), (kernels.raise_points, RAISE), (kernels.turn, TURN_POINTS)
    own = (kernels.move, MOVE), (lower_barrier, LOWER), (drive_slopes, DRIVE), (turn_slacks, TURN), (jams, JAMMED)
    return tuple([address(*kernel) for kernel in (*of_points, *own)])


@inner
def set_out(standing: np.ndarray, numbers: np.ndarray) -> None:
    """The merit where a search begins, and a funnel as wide."""
    standing[MISSING], standing[COST], standing[HELD] = numbers[9, 0], numbers[10, 0], numbers[11, 0]
    standing[FUNNEL], standing[BEST], standing[FIRST] = max(numbers[9, 0], 1.0), numbers[8, 0], 1.0


@compiled
def lower_barrier(
    calls: tuple,
    setting: np.ndarray,
    given: np.ndarray,
    written: np.ndarray,
    rows: np.ndarray,
    standing: np.ndarray,
    rules: tuple,
) -> int:
    """Lower the barrier while its problem is solved, and measure anew what depends on it; what has become of it."""
    (tolerance, last, own, sizes, shares), numbers = rules, numbers_of(written, rows)
    barrier, surveyed, limits = barrier_of(written, rows), surveyed_of(written, rows), limits_of(given, rows)
    rate = limits[1][0] * max(surveyed[7, 0], 1.0)
    found, before = (surveyed[2, 0], surveyed[3, 0], surveyed[8, 0]), barrier[0]
    less, cheap = lowered(before, rate, last * tolerance * limits[1][0] / rate, found, numbers[6, 0], tolerance, own)
    if cheap or less == before:
        return CHEAP if cheap else SAME
    barrier[0] = less
    clear(view(surveyed, 0, (surveyed.size,)))
    clear(view(numbers, 0, (numbers.size,)))
    held, slacks = inequalities_of(written, given, rows), slacks_of(written, given, rows)
    held_survey(calls[AT_HELD_SURVEY], (0, 1, held, slacks, limits, sizes[0], sizes[1], surveyed))
    measure(calls, written, setting, given, rows, shares)
    set_out(standing, numbers)
    standing[FIRST] = 0.0
    return LESS


@compiled
def drive_slopes(written: np.ndarray, rows: np.ndarray) -> None:
    """The slopes with the share of the inequalities at their barrier."""
    pushed, barrier, slopes = held_of(written, rows)[1], barrier_of(written, rows)[0], driven_of(written, rows)
    for k in range(slopes.shape[1]):
        for i in range(slopes.shape[2]):
            slopes[0, k, i, 0] = pushed[0, k, 0, i, 0] + barrier * pushed[0, k, 0, i, 1]


@compiled
def turn_slacks(calls: tuple, given: np.ndarray, written: np.ndarray, rows: np.ndarray, share: float) -> None:
    """The steps of slacks, multipliers and excesses, and how far these may go; ``share``: of the way to the
    boundary."""
    ((part, dual), moves, found, _), held = turned_of(written, rows), inequalities_of(written, given, rows)
    ways, slacks = ways_of(written, rows), slacks_of(written, given, rows)
    _turn_points(calls[AT_TURN_POINTS], (0, 1, held, slacks, ways, share, moves, found))
    part[0], dual[0] = found[0, 0], found[0, 1]


@compiled
def jams(
    written: np.ndarray, given: np.ndarray, rows: np.ndarray, tolerance: float, near: float, jammed: float
) -> bool:
    """Whether inequalities contradict each other or the ends, or a step jams at them; ``near``: a barrier, and an
    excess, relative; ``jammed``: a share of a step."""
    barrier, rate, numbers = barrier_of(written, rows)[0], limits_of(given, rows)[1][0], numbers_of(written, rows)
    left = barrier <= near * rate and numbers[6, 0] <= tolerance and surveyed_of(written, rows)[9, 0] > near
    return left or part_of(written, rows)[0] <= jammed
