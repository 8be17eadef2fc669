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

from ..kernels import kernel, kernel_part
from ..linked import array, view
from .emitted import EMITTED, operands_of, spread
from .instructions import CODES, NAMES, OPERANDS
from .program import VECTOR, Program
from .transfers import moved, read_all, write_all

LANES = 64  # points that an instruction acts on at once where nobody says how many
MOST_LANES = 256  # enough to hide the choice of an instruction
MEMORY = 2**17  # registers of all lanes, few enough for the near caches

(
    ADD, SUB, MUL, DIV, MUL_ADD, MUL_SUB, SUB_MUL, ADD_ADD, MUL_ADD_ADD, TWO_MUL, TWO_MUL_ADD, MUL_SUB_MUL, THREE_MUL,
    THREE_MUL_ADD, ADD_CONST, MUL_CONST, CONST_SUB, CONST_DIV, SELECT, CONST, INPUT, OUTPUT, CODE, READ, WRITE,
    STATE, LOOP, NEXT, REPEAT, IF_ELSE_ZERO, POW, CONSTPOW, LT, LE, EQ, NE, AND, OR, FMOD, COPYSIGN, FMIN, FMAX, ATAN2,
    HYPOT, NEG, SQ, TWICE, SQRT, INV, ASSIGN, NOT, FLOOR, CEIL, FABS, SIGN, SIN, COS, TAN, EXP, LOG, ASIN, ACOS, ATAN,
    ERF, SINH, COSH, TANH, ASINH, ACOSH, ATANH, LOG1P, EXPM1,
) = range(len(NAMES))  # fmt: skip
FIRST_OF_ONE = NEG

# What ``run`` is compiled for.
_PROGRAM, _NUMBERS, _PLACES = (array(1, types.uint8), array(2, types.uint32), array(1)), array(1), array(2, types.int64)
RUN = types.void(*_PROGRAM, _NUMBERS, _PLACES, _NUMBERS, _PLACES, array(2), types.int64, types.int64)

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


def _cases(builder: Any, code: Any, after: Any) -> Iterator[Any]:
    """Go through the instructions with the builder where one begins; at the end, where a code is none of them."""
    unknown = builder.append_basic_block("unknown")
    jump = builder.switch(code, unknown)
    for name, emit in EMITTED.items():
        number, block = CODES[name], builder.append_basic_block(name)
        jump.add_case(ir.Constant(code.type, number), block)
        builder.position_at_end(block)
        yield emit
    builder.position_at_end(unknown)


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


@kernel_part()
def _whole(registers: np.ndarray, k: int) -> tuple[np.int64, np.int64, np.int64]:
    """From which register on how many numbers are read or written, and from which place on."""
    return np.int64(registers[k, 0]), np.int64(registers[k, 1]), np.int64(registers[k, 2])


@kernel_part()
def _some_go_on(done: np.ndarray, count: int) -> bool:
    """Whether some of the first lanes are not done."""
    going = False
    for j in range(count):
        going |= done[j] == 0
    return going


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
        m, k, left = min(lanes, last - s), 0, 0
        while k < codes.size:
            c = codes[k]
            if _on_lanes(codes, registers, values, w, m, k):
                k += 1
            elif c in (INPUT, OUTPUT):
                data, places = (inputs, sources) if c == INPUT else (outputs, targets)
                k += moved(codes, registers, values, data, places, w, s, m, k)
            elif c == CODE:
                _call(int(values[k]), w)
                k += 1
            elif c == LOOP:
                left = int(values[k])
                k += 1
            elif c == REPEAT:
                left -= 1
                k = int(values[k]) if left > 0 and _some_go_on(w[registers[k, 1]], m) else k + 1
            elif c == READ:
                row, some, at = _whole(registers, k)
                read_all(inputs, view(sources, 2 * at, (some, 2)), w, row, s, m)
                k += 1
            elif c == WRITE:
                row, some, at = _whole(registers, k)
                write_all(outputs, view(targets, 2 * at, (some, 2)), w, row, s, m)
                k += 1
            else:  # its own time hides the choice
                o, x, y = registers[k, 0], registers[k, 1], registers[k, 2]
                for j in range(m):
                    w[o, j] = _other(c, w[x, j], w[y, j])
                k += 1
