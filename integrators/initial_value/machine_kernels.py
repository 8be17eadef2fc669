"""The machine of tapes for the loops of steps, called by its address: each loop would be compiled with all of it."""

from functools import cache

import numpy as np

from ...kernels import kernel_part
from ...linked import address, called
from ...tape.machine import RUN, RUN_ONE, run, run_one

_run, _run_one = called(RUN), called(RUN_ONE)
Machine = tuple[int, int]


@cache
def machine() -> Machine:
    """Where the machine stands in this process, for many points and for one."""
    return address(run, RUN), address(run_one, RUN_ONE)


@kernel_part()
def evaluate(programs: tuple, which: int, v: np.ndarray, w: np.ndarray) -> None:
    """Run one of the programs on a memory with these registers."""
    (many, one), codes, operands, values, ranges, sources, targets = programs
    a, b, flat = ranges[which, 0], ranges[which, 1], v.reshape(v.size)
    if w.shape[1] == 1:
        _run_one(one, (codes[a:b], operands[a:b], values[a:b], flat, w.reshape(w.size)))
    else:
        _run(many, (codes[a:b], operands[a:b], values[a:b], flat, sources, flat, targets, w, 0, v.shape[1]))


@kernel_part()
def places_of(rows: np.ndarray, lanes: int) -> np.ndarray:
    """Where rows of a memory of so many lanes begin, and how far the number of the next lane is."""
    found = np.empty((rows.size, 2), np.int64)
    for i in range(rows.size):
        found[i, 0], found[i, 1] = rows[i] * lanes, 1
    return found
