"""The machine of tapes for the loops of steps, called by its address: each loop would be compiled with all of it."""

import numpy as np

from ...kernels import kernel_part
from ...linked import address, called
from ...tape.machine import RUN, RUN_ONE, run, run_one

_run, _run_one = called(RUN), called(RUN_ONE)
Machine = tuple[int, int]


def machine() -> Machine:
    """Where the machine stands in this process, for many points and for one."""
    return address(run, RUN), address(run_one, RUN_ONE)


@kernel_part()
def evaluate(programs: tuple, which: int, v: np.ndarray, w: np.ndarray) -> None:
    """Run one of the programs on a memory with these registers."""
    (many, one), codes, operands, values, ranges = programs
    a, b = ranges[which, 0], ranges[which, 1]
    if v.shape[1] == 1:
        _run_one(one, (codes[a:b], operands[a:b], values[a:b], v.reshape(v.size), w.reshape(w.size)))
    else:
        flat, rows = v.reshape(v.size), np.empty((v.shape[0], 2), np.int64)
        for i in range(v.shape[0]):
            rows[i, 0], rows[i, 1] = i * v.shape[1], 1
        _run(many, (codes[a:b], operands[a:b], values[a:b], flat, rows, flat, rows, w, 0, v.shape[1]))
