"""The machine of tapes as a compiled function with an address, by which the loops of steps call it."""

import numba
import numpy as np
from numba import types

from ...linked import array
from ...tape.machine import run, run_one

MATRIX = array(2)
PROGRAMS = array(1, types.uint8), array(2, types.uint32), array(1), array(2, types.int64)
EVALUATE = types.void(*PROGRAMS, types.int64, MATRIX, MATRIX)


@numba.cfunc(EVALUATE, cache=True, error_model="numpy")
def evaluate(
    codes: np.ndarray,
    operands: np.ndarray,
    values: np.ndarray,
    ranges: np.ndarray,
    which: int,
    v: np.ndarray,
    w: np.ndarray,
) -> None:
    """Run one of the programs on a memory with these registers."""
    a, b = ranges[which, 0], ranges[which, 1]
    if v.shape[1] == 1:
        run_one(codes[a:b], operands[a:b], values[a:b], v.reshape(v.size), w.reshape(w.size))
    else:
        flat, rows = v.reshape(v.size), np.empty((v.shape[0], 2), np.int64)
        for i in range(v.shape[0]):
            rows[i, 0], rows[i, 1] = i * v.shape[1], 1
        run(codes[a:b], operands[a:b], values[a:b], flat, rows, flat, rows, w, a - a, v.shape[1])
