"""What the machine reads into its registers, and writes from them: numbers of points that stand beside each other, of
which a register has one of each."""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import extending, types

from ..kernels import kernel_part, pasted
from .instructions import CODES
from .program import FOUR

INPUT = CODES["INPUT"]

# Numba's own types do not know that it passes an intrinsic its first argument itself.
_intrinsic: Any = extending.intrinsic


def _turning(write: bool) -> Any:
    """What reads or writes four neighbouring numbers of each of four points."""

    @_intrinsic
    def turn(typing: Any, w: Any, j: Any, rows: Any, data: Any, begin: Any, step: Any) -> Any:
        """``turn(w, j, rows, data, begin, step)``: those of the points from the lane ``j`` on, the first of them at
        ``begin`` and each ``step`` further, in four registers."""
        kind = ir.VectorType(ir.DoubleType(), FOUR)

        def generate(context: Any, b: Any, signature: Any, arguments: Any) -> Any:
            arrays = [context.make_array(signature.args[i])(context, b, arguments[i]) for i in (0, 3)]
            (_, j, rows, _, begin, step), (w, data) = arguments, (array.data for array in arrays)
            width = b.extract_value(arrays[0].shape, 1)

            def lanes(n: int) -> Any:
                row = b.zext(b.extract_value(rows, n), j.type)
                return b.bitcast(b.gep(w, [b.add(b.mul(row, width), j)]), kind.as_pointer())

            def point(n: int) -> Any:
                return b.bitcast(b.gep(data, [b.add(begin, b.mul(step, step.type(n)))]), kind.as_pointer())

            given, found = (lanes, point) if write else (point, lanes)
            for n, column in enumerate(_columns(b, [b.load(given(n), align=8) for n in range(FOUR)])):
                b.store(column, found(n), align=8)
            return context.get_dummy_value()

        return types.void(w, j, rows, data, begin, step), generate

    return turn


def _columns(builder: Any, rows: list[Any]) -> list[Any]:
    """The columns of a matrix with four rows of four numbers."""

    def mixed(a: Any, b: Any, *places: int) -> Any:
        index = ir.Constant(ir.VectorType(ir.IntType(32), FOUR), list(places))
        return builder.shuffle_vector(a, b, index)

    low, high = ([mixed(a, b, *places) for a, b in (rows[:2], rows[2:])] for places in ((0, 4, 2, 6), (1, 5, 3, 7)))
    return [mixed(*pair, *places) for places in ((0, 1, 4, 5), (2, 3, 6, 7)) for pair in (low, high)]


_read_four, _write_four = _turning(write=False), _turning(write=True)


@pasted
def _column(registers: Any, k: int, operand: int) -> Any:
    """An operand of four instructions."""
    return registers[k, operand], registers[k + 1, operand], registers[k + 2, operand], registers[k + 3, operand]


@pasted
def _beside(places: Any, i: int) -> int:
    """How many numbers from this one on stand beside each other for sure, in fours: places ascend."""
    for length in (4 * FOUR, FOUR):
        last = i + length - 1
        if last < places.shape[0] and places[last, 0] - places[i, 0] == length - 1 and places[last, 1] == places[i, 1]:
            return length
    return 0


def _all(write: bool) -> Any:
    """What reads inputs, or writes outputs, that stand in registers one after the other: two kernels, as in one the
    choice would be made anew for each number."""
    four = _write_four if write else _read_four

    @kernel_part()
    def move(data: np.ndarray, places: np.ndarray, w: np.ndarray, row: int, s: int, m: int) -> None:
        """Those of ``m`` points from ``s`` on, in the registers from ``row`` on."""
        i, count = 0, places.shape[0]
        while i < count:
            step, length = places[i, 1], _beside(places, i) if m >= FOUR else 0
            begin = places[i, 0] + s * step
            for k in range(0, length, FOUR):
                r = row + i + k
                for first in range(0, m, FOUR):
                    j = min(first, m - FOUR)
                    four(w, j, (r, r + 1, r + 2, r + 3), data, begin + k + j * step, step)
            for j in range(m if length == 0 else 0):
                if write:
                    data[begin + j * step] = w[row + i, j]
                else:
                    w[row + i, j] = data[begin + j * step]
            i += length if length > 0 else 1

    return move


read_all, write_all = _all(write=False), _all(write=True)


@pasted
def moved(codes: Any, registers: Any, values: Any, data: Any, places: Any, w: Any, s: int, m: int, k: int) -> int:
    """Read inputs, or write outputs, of ``m`` points from ``s`` on; the number of instructions that this was."""
    code, place = codes[k], int(values[k])
    step, last = places[place, 1], place + FOUR - 1
    begin = places[place, 0] + s * step
    # Places ascend: where the fourth is the third after the first, all stand beside each other.
    if (
        m >= FOUR
        and registers[k, 2] == FOUR
        and places[last, 0] - places[place, 0] == FOUR - 1
        and places[last, 1] == step
    ):
        for i in range(0, m, FOUR):
            j = min(i, m - FOUR)  # the last four points, some of them for the second time
            if code == INPUT:
                _read_four(w, j, _column(registers, k, 0), data, begin + j * step, step)
            else:
                _write_four(w, j, _column(registers, k, 1), data, begin + j * step, step)
        return FOUR
    for j in range(m):
        if code == INPUT:
            w[registers[k, 0], j] = data[begin + j * step]
        else:
            data[begin + j * step] = w[registers[k, 1], j]
    return 1
