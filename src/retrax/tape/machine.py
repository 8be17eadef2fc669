"""The machine that runs programs: every instruction acts on a lane of points at once.

Numba compiles it once on a computer and keeps it on its disk. A program is data to it: nothing is compiled for one.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import extending, types
from numba.core import cgutils

from ..kernels import kernel, kernel_part, pasted
from ..linked import array, view
from .emitted import EMITTED, operands_of, spread
from .program import CODES, FOUR, NAMES, OPERANDS, VECTOR, Program

LANES = 64  # points that an instruction acts on at once where nobody says how many
MOST_LANES = 256  # enough to hide the choice of an instruction
MEMORY = 2**17  # registers of all lanes, few enough for the near caches

(
    ADD, SUB, MUL, DIV, MUL_ADD, MUL_SUB, SUB_MUL, ADD_ADD, MUL_ADD_ADD, TWO_MUL, TWO_MUL_ADD, MUL_SUB_MUL, THREE_MUL,
    THREE_MUL_ADD, ADD_CONST, MUL_CONST, CONST_SUB, CONST_DIV, SELECT, CONST, INPUT, OUTPUT, CODE, READ, WRITE,
    IF_ELSE_ZERO, POW, CONSTPOW, LT, LE, EQ, NE, AND, OR, FMOD, COPYSIGN, FMIN, FMAX, ATAN2, HYPOT, NEG, SQ, TWICE,
    SQRT, INV, ASSIGN, NOT, FLOOR, CEIL, FABS, SIGN, SIN, COS, TAN, EXP, LOG, ASIN, ACOS, ATAN, ERF, SINH, COSH, TANH,
    ASINH, ACOSH, ATANH, LOG1P, EXPM1,
) = range(len(NAMES))  # fmt: skip
FIRST_OF_ONE = NEG

# What ``run`` and ``run_one`` are compiled for.
_PROGRAM, _NUMBERS, _PLACES = (array(1, types.uint8), array(2, types.uint32), array(1)), array(1), array(2, types.int64)
RUN = types.void(*_PROGRAM, _NUMBERS, _PLACES, _NUMBERS, _PLACES, array(2), types.int64, types.int64)
RUN_ONE = types.void(*_PROGRAM, _NUMBERS, _NUMBERS)

# Numba's own types do not know that it passes an intrinsic its first argument itself.
_intrinsic: Any = extending.intrinsic


@_intrinsic
def _on_lanes(typing: Any, codes: Any, registers: Any, values: Any, w: Any, m: Any, k: Any) -> Any:
    """``run(codes, registers, values, w, m, k)``: run the instruction ``k`` on the first ``m`` of the lanes if it is
    one of these, and whether it is.

    One table of jumps, where Numba would need a loop for each instruction.
    """
    kind = ir.VectorType(ir.DoubleType(), VECTOR)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        arrays = [
            context.make_array(t)(context, builder, a) for t, a in zip(signature.args, arguments[:4], strict=False)
        ]
        codes, registers, values, w = (array.data for array in arrays)
        count, k = arguments[4:]
        width, row = builder.extract_value(arrays[3].shape, 1), builder.mul(k, ir.Constant(k.type, 1 + OPERANDS))
        constant = spread(builder, kind, builder.load(builder.gep(values, [k])))
        known = cgutils.alloca_once_value(builder, cgutils.true_bit)
        after, step = builder.append_basic_block("after"), ir.Constant(count.type, VECTOR)

        def place(operand: int) -> Any:
            register = builder.load(builder.gep(registers, [builder.add(row, ir.Constant(row.type, operand))]))
            return builder.gep(w, [builder.mul(builder.zext(register, row.type), width)])

        for emit in _cases(builder, builder.load(builder.gep(codes, [k])), after):
            target, *operands = (place(operand) for operand in range(1 + operands_of(emit)))
            with cgutils.for_range_slice(builder, ir.Constant(count.type, 0), count, step) as (j, _):

                def load(pointer: Any, j: Any = j) -> Callable[[], Any]:
                    return lambda: builder.load(builder.bitcast(builder.gep(pointer, [j]), kind.as_pointer()), align=8)

                result = emit(builder, constant, *map(load, operands))
                builder.store(result, builder.bitcast(builder.gep(target, [j]), kind.as_pointer()), align=8)
            builder.branch(after)
        builder.store(cgutils.false_bit, known)
        builder.branch(after)
        builder.position_at_end(after)
        return builder.load(known)

    return types.boolean(codes, registers, values, w, types.intp, types.intp), generate


@_intrinsic
def _on_one(typing: Any, codes: Any, registers: Any, values: Any, w: Any, k: Any) -> Any:
    """``run(codes, registers, values, w, k)``: run the instructions from ``k`` on that are the same on one point; the
    next one.

    That is ``k`` itself where the instruction is none of these.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        arrays = [
            context.make_array(t)(context, builder, a) for t, a in zip(signature.args, arguments[:4], strict=False)
        ]
        codes, registers, values, w = (array.data for array in arrays)
        first, count = arguments[4], builder.extract_value(arrays[0].shape, 0)
        at, after = cgutils.alloca_once_value(builder, first), builder.append_basic_block("after")
        code = builder.load(builder.gep(codes, [first]))
        for number, emit in _cases(builder, code, after, numbered=True):
            again, more = builder.append_basic_block("again"), builder.append_basic_block("more")
            builder.branch(again)
            builder.position_at_end(again)
            here = builder.load(at)
            row = builder.mul(here, ir.Constant(here.type, 1 + OPERANDS))

            def place(operand: int, row: Any = row) -> Any:
                register = builder.load(builder.gep(registers, [builder.add(row, ir.Constant(row.type, operand))]))
                return builder.gep(w, [builder.zext(register, row.type)])

            loads = (lambda i=i: builder.load(place(i)) for i in range(1, 1 + operands_of(emit)))
            builder.store(emit(builder, builder.load(builder.gep(values, [here])), *loads), place(0))
            following = builder.add(here, ir.Constant(here.type, 1))
            builder.store(following, at)
            builder.cbranch(builder.icmp_unsigned("<", following, count), more, after)
            builder.position_at_end(more)
            next_code = builder.load(builder.gep(codes, [following]))
            builder.cbranch(builder.icmp_unsigned("==", next_code, ir.Constant(code.type, number)), again, after)
        builder.branch(after)
        builder.position_at_end(after)
        return builder.load(at)

    return types.intp(codes, registers, values, w, types.intp), generate


def _cases(builder: Any, code: Any, after: Any, numbered: bool = False) -> Iterator[Any]:
    """Go through the instructions with the builder where one begins; at the end, where a code is none of them."""
    unknown = builder.append_basic_block("unknown")
    jump = builder.switch(code, unknown)
    for name, emit in EMITTED.items():
        number, block = CODES[name], builder.append_basic_block(name)
        jump.add_case(ir.Constant(code.type, number), block)
        builder.position_at_end(block)
        yield (number, emit) if numbered else emit
    builder.position_at_end(unknown)


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


@_intrinsic
def _call(typing: Any, address: Any, w: Any) -> Any:
    """``_call(address, w)``: call machine code on the registers."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[1])(context, builder, arguments[1]).data
        form = ir.FunctionType(ir.VoidType(), [data.type])
        builder.call(builder.inttoptr(arguments[0], form.as_pointer()), [data])
        return context.get_dummy_value()

    return types.void(address, w), generate


@kernel_part()
def _elementary(c: int, x: float) -> float:
    """Functions of one number that take longer than the choice among them."""
    if c == SIN:
        return math.sin(x)
    if c == COS:
        return math.cos(x)
    if c == EXP:
        return math.exp(x)
    if c == LOG:
        return np.log(x)
    if c == TAN:
        return math.tan(x)
    if c == ASIN:
        return np.arcsin(x)
    if c == ACOS:
        return np.arccos(x)
    if c == ATAN:
        return math.atan(x)
    if c == SINH:
        return np.sinh(x)
    if c == COSH:
        return np.cosh(x)
    if c == TANH:
        return math.tanh(x)
    if c == ASINH:
        return np.arcsinh(x)
    if c == ACOSH:
        return np.arccosh(x)
    if c == ATANH:
        return np.arctanh(x)
    return math.erf(x) if c == ERF else (np.log1p(x) if c == LOG1P else np.expm1(x))


@kernel_part()
def _of_one(c: int, x: float) -> float:
    if c == SIGN:
        return 1.0 if x > 0 else (-1.0 if x < 0 else x)
    if c == FLOOR:
        return np.floor(x)
    if c == CEIL:
        return np.ceil(x)
    return x if c == ASSIGN else _elementary(c, x)


@kernel_part()
def _of_two(c: int, x: float, y: float) -> float:
    if c == EQ:
        return 1.0 if x == y else 0.0
    if c == NE:
        return 1.0 if x != y else 0.0
    if c == AND:
        return 1.0 if x != 0 and y != 0 else 0.0
    if c == OR:
        return 1.0 if x != 0 or y != 0 else 0.0
    if c == FMIN:
        return x if x < y or y != y else y
    if c == FMAX:
        return x if x > y or y != y else y
    if c == FMOD:
        return np.fmod(x, y)
    if c == COPYSIGN:
        return math.copysign(x, y)
    if c == ATAN2:
        return math.atan2(x, y)
    return math.hypot(x, y) if c == HYPOT else np.power(x, y)


@kernel_part()
def _other(c: int, x: float, y: float) -> float:
    return _of_two(c, x, y) if c < FIRST_OF_ONE else _of_one(c, x)


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


@kernel_part()
def _read_all(data: np.ndarray, places: np.ndarray, w: np.ndarray, row: int, s: int, m: int) -> None:
    """Read inputs of ``m`` points from ``s`` on into the registers from ``row`` on."""
    i, count = 0, places.shape[0]
    while i < count:
        step, length = places[i, 1], _beside(places, i) if m >= FOUR else 0
        begin = places[i, 0] + s * step
        for k in range(0, length, FOUR):
            r = row + i + k
            for first in range(0, m, FOUR):
                j = min(first, m - FOUR)
                _read_four(w, j, (r, r + 1, r + 2, r + 3), data, begin + k + j * step, step)
        if length == 0 and step == 1:
            for j in range(m):
                w[row + i, j] = data[begin + j]
        elif length == 0:
            for j in range(m):
                w[row + i, j] = data[begin + j * step]
        i += length if length > 0 else 1


@kernel_part()
def _write_all(data: np.ndarray, places: np.ndarray, w: np.ndarray, row: int, s: int, m: int) -> None:
    """Write outputs of ``m`` points from ``s`` on, which stand in the registers from ``row`` on."""
    i, count = 0, places.shape[0]
    while i < count:
        step, length = places[i, 1], _beside(places, i) if m >= FOUR else 0
        begin = places[i, 0] + s * step
        for k in range(0, length, FOUR):
            r = row + i + k
            for first in range(0, m, FOUR):
                j = min(first, m - FOUR)
                _write_four(w, j, (r, r + 1, r + 2, r + 3), data, begin + k + j * step, step)
        if length == 0 and step == 1:
            for j in range(m):
                data[begin + j] = w[row + i, j]
        elif length == 0:
            for j in range(m):
                data[begin + j * step] = w[row + i, j]
        i += length if length > 0 else 1


@pasted
def _moved(codes: Any, registers: Any, values: Any, data: Any, places: Any, w: Any, s: int, m: int, k: int) -> int:
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


def lanes_for(count: int, program: Program) -> int:
    """How many lanes ``count`` points have best."""
    if program.engine is not None:
        return VECTOR
    blocks = -(-count // max(LANES, min(MOST_LANES, MEMORY // max(1, program.size))))
    return -(-count // (blocks * VECTOR)) * VECTOR


@kernel()
def run(
    codes: np.ndarray,
    registers: np.ndarray,
    values: np.ndarray,
    inputs: np.ndarray,
    sources: np.ndarray,
    outputs: np.ndarray,
    targets: np.ndarray,
    w: np.ndarray,
    first: int,
    last: int,
) -> None:
    """Run a program on the points ``first`` to ``last``, as many at once as there are lanes.

    ``inputs``: numbers that are read; ``sources``: for each input where that of the first point stands and how far the
    next is; ``outputs``, ``targets``: the same of what is written; ``w``: registers, shape ``(size, lanes)``, lanes in
    whole vectors. Places of inputs ascend, and those of outputs.
    """
    lanes = w.shape[1]
    for s in range(first, last, lanes):
        m, k = min(lanes, last - s), 0
        while k < codes.size:
            c = codes[k]
            if _on_lanes(codes, registers, values, w, m, k):
                k += 1
            elif c in (INPUT, OUTPUT):
                data, places = (inputs, sources) if c == INPUT else (outputs, targets)
                k += _moved(codes, registers, values, data, places, w, s, m, k)
            elif c == CODE:
                _call(int(values[k]), w)
                k += 1
            elif c in (READ, WRITE):  # so many, from a register and a place on
                row, some, at = np.int64(registers[k, 0]), np.int64(registers[k, 1]), np.int64(registers[k, 2])
                if c == READ:
                    _read_all(inputs, view(sources, 2 * at, (some, 2)), w, row, s, m)
                else:
                    _write_all(outputs, view(targets, 2 * at, (some, 2)), w, row, s, m)
                k += 1
            else:  # its own time hides the choice
                o, x, y = registers[k, 0], registers[k, 1], registers[k, 2]
                for j in range(m):
                    w[o, j] = _other(c, w[x, j], w[y, j])
                k += 1


@kernel()
def run_one(codes: np.ndarray, registers: np.ndarray, values: np.ndarray, v: np.ndarray, w: np.ndarray) -> None:
    """Run a program on one point; ``v``: inputs and outputs, in the places that are operand and destination; ``w``:
    registers.

    The same instructions after each other take least time.
    """
    k = 0
    while k < codes.size:
        begin = k
        k = _on_one(codes, registers, values, w, k)
        if k > begin:
            continue
        c, o, x = codes[k], registers[k, 0], registers[k, 1]
        if c == INPUT:
            w[o] = v[x]
        elif c == OUTPUT:
            v[o] = w[x]
        else:
            w[o] = _other(c, w[x], w[registers[k, 2]])
        k += 1
