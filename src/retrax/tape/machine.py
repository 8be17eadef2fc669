"""The machine that runs programs: every instruction acts on a lane of points at once.

Numba compiles it once on a computer and keeps it on its disk. A program is data to it: nothing is compiled for one.
"""

import inspect
import math
from collections.abc import Callable, Iterator
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import extending, types
from numba.core import cgutils

from ..inlined import AS_PART
from .program import NAMES, OPERANDS

LANES = 64  # points that an instruction acts on at once where nobody says how many
VECTOR = 8  # numbers that are loaded at once; lanes are whole vectors

(
    ADD, SUB, MUL, DIV, MUL_ADD, MUL_SUB, SUB_MUL, ADD_ADD, MUL_ADD_ADD, TWO_MUL, TWO_MUL_ADD, MUL_SUB_MUL, THREE_MUL,
    THREE_MUL_ADD, ADD_CONST, MUL_CONST, CONST_SUB, CONST_DIV, SELECT, CONST, INPUT, OUTPUT, IF_ELSE_ZERO, POW,
    CONSTPOW, LT, LE, EQ, NE, AND, OR, FMOD, COPYSIGN, FMIN, FMAX, ATAN2, HYPOT, NEG, SQ, TWICE, SQRT, INV, ASSIGN, NOT,
    FLOOR, CEIL, FABS, SIGN, SIN, COS, TAN, EXP, LOG, ASIN, ACOS, ATAN, ERF, SINH, COSH, TANH, ASINH, ACOSH, ATANH,
    LOG1P, EXPM1,
) = range(len(NAMES))  # fmt: skip
FIRST_OF_ONE = NEG

# Numba's own types know neither all of its options nor that it passes an intrinsic its first argument itself.
_njit: Any = numba.njit
_compiled = _njit(cache=True, error_model="numpy", nogil=True)
_inner = _njit(error_model="numpy", nogil=True, **AS_PART)
_intrinsic: Any = extending.intrinsic
_FUSED = ("contract",)  # a product and a sum may be one instruction


def _chosen(builder: Any, condition: Any, a: Any, b: Any) -> Any:
    """``a`` where ``condition`` is not zero, else ``b``."""
    return builder.select(builder.fcmp_unordered("!=", condition, ir.Constant(condition.type, None)), a, b)


def _truth(relation: str) -> Callable[..., Any]:
    def emit(b: Any, v: Any, x: Any, y: Any) -> Any:
        one, none = (ir.Constant(v.type, value) for value in (_filled(v.type, 1.0), None))
        return b.select(b.fcmp_ordered(relation, x(), y()), one, none)

    return emit


def _filled(kind: Any, value: float) -> Any:
    return [value] * kind.count if isinstance(kind, ir.VectorType) else value


def _of_llvm(name: str) -> Callable[..., Any]:
    def emit(b: Any, v: Any, x: Any) -> Any:
        suffix = f"v{v.type.count}f64" if isinstance(v.type, ir.VectorType) else "f64"
        function = cgutils.get_or_insert_function(b.module, ir.FunctionType(v.type, [v.type]), f"{name}.{suffix}")
        return b.call(function, [x()])

    return emit


def _product_and(b: Any, x: Any, y: Any, rest: Any) -> Any:
    """``x y + rest``."""
    return b.fadd(b.fmul(x(), y(), flags=_FUSED), rest, flags=_FUSED)


# Instructions that are vector instructions of the processor: operands are loaded when they are called, ``v`` is the
# constant.
_EMITTED: dict[int, Callable[..., Any]] = {
    MUL: lambda b, v, x, y: b.fmul(x(), y()),
    MUL_ADD: lambda b, v, x, y, z: b.fadd(b.fmul(x(), y(), flags=_FUSED), z(), flags=_FUSED),
    MUL_SUB: lambda b, v, x, y, z: b.fsub(b.fmul(x(), y(), flags=_FUSED), z(), flags=_FUSED),
    SUB_MUL: lambda b, v, x, y, z: b.fsub(z(), b.fmul(x(), y(), flags=_FUSED), flags=_FUSED),
    ADD_ADD: lambda b, v, x, y, z: b.fadd(b.fadd(x(), y()), z()),
    MUL_ADD_ADD: lambda b, v, x, y, z, t: b.fadd(_product_and(b, x, y, z()), t()),
    TWO_MUL: lambda b, v, x, y, z, t: _product_and(b, z, t, b.fmul(x(), y())),
    TWO_MUL_ADD: lambda b, v, x, y, s, z, t: _product_and(b, z, t, _product_and(b, x, y, s())),
    MUL_SUB_MUL: lambda b, v, x, y, z, t: b.fsub(b.fmul(z(), t(), flags=_FUSED), b.fmul(x(), y()), flags=_FUSED),
    THREE_MUL: lambda b, v, x, y, z, t, q, r: _product_and(b, q, r, _product_and(b, z, t, b.fmul(x(), y()))),
    THREE_MUL_ADD: lambda b, v, x, y, s, z, t, q, r: _product_and(
        b, q, r, _product_and(b, z, t, _product_and(b, x, y, s()))
    ),
    ADD: lambda b, v, x, y: b.fadd(x(), y()),
    SUB: lambda b, v, x, y: b.fsub(x(), y()),
    DIV: lambda b, v, x, y: b.fdiv(x(), y()),
    MUL_CONST: lambda b, v, x: b.fmul(x(), v),
    ADD_CONST: lambda b, v, x: b.fadd(x(), v),
    CONST_SUB: lambda b, v, x: b.fsub(v, x()),
    CONST_DIV: lambda b, v, x: b.fdiv(v, x()),
    CONST: lambda b, v: v,
    INV: lambda b, v, x: b.fdiv(ir.Constant(v.type, _filled(v.type, 1.0)), x()),
    NEG: lambda b, v, x: b.fneg(x()),
    SQ: lambda b, v, x: b.fmul(x(), x()),
    TWICE: lambda b, v, x: b.fadd(x(), x()),
    SQRT: _of_llvm("llvm.sqrt"),
    FABS: _of_llvm("llvm.fabs"),
    LT: _truth("<"),
    LE: _truth("<="),
    NOT: lambda b, v, x: _chosen(b, x(), ir.Constant(v.type, None), ir.Constant(v.type, _filled(v.type, 1.0))),
    SELECT: lambda b, v, x, y, z: _chosen(b, x(), y(), z()),
    IF_ELSE_ZERO: lambda b, v, x, y: _chosen(b, x(), y(), ir.Constant(v.type, None)),
}


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
        constant = _spread(builder, kind, builder.load(builder.gep(values, [k])))
        known = cgutils.alloca_once_value(builder, cgutils.true_bit)
        after, step = builder.append_basic_block("after"), ir.Constant(count.type, VECTOR)

        def place(operand: int) -> Any:
            register = builder.load(builder.gep(registers, [builder.add(row, ir.Constant(row.type, operand))]))
            return builder.gep(w, [builder.mul(builder.zext(register, row.type), width)])

        for emit in _cases(builder, builder.load(builder.gep(codes, [k])), after):
            target, *operands = (place(operand) for operand in range(1 + _operands(emit)))
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


def _operands(emit: Callable[..., Any]) -> int:
    """How many operands an instruction has."""
    return len(inspect.signature(emit).parameters) - 2


def _spread(builder: Any, kind: Any, value: Any) -> Any:
    """A vector of the same number."""
    found = ir.Constant(kind, ir.Undefined)
    for t in range(kind.count):
        found = builder.insert_element(found, value, ir.Constant(ir.IntType(32), t))
    return found


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

            loads = (lambda i=i: builder.load(place(i)) for i in range(1, 1 + _operands(emit)))
            builder.store(emit(builder, builder.load(builder.gep(values, [here])), *loads), place(0))
            following = builder.add(here, ir.Constant(here.type, 1))
            builder.store(following, at)
            builder.cbranch(builder.icmp_unsigned("<", following, count), more, after)
            builder.position_at_end(more)
            same = builder.icmp_unsigned(
                "==", builder.load(builder.gep(codes, [following])), ir.Constant(code.type, number)
            )
            builder.cbranch(same, again, after)
        builder.branch(after)
        builder.position_at_end(after)
        return builder.load(at)

    return types.intp(codes, registers, values, w, types.intp), generate


def _cases(builder: Any, code: Any, after: Any, numbered: bool = False) -> Iterator[Any]:
    """Go through the instructions with the builder where one begins; at the end, where a code is none of them."""
    unknown = builder.append_basic_block("unknown")
    jump = builder.switch(code, unknown)
    for number, emit in _EMITTED.items():
        block = builder.append_basic_block(NAMES[number])
        jump.add_case(ir.Constant(code.type, number), block)
        builder.position_at_end(block)
        yield (number, emit) if numbered else emit
    builder.position_at_end(unknown)


@_inner
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


@_inner
def _of_one(c: int, x: float) -> float:
    if c == SIGN:
        return 1.0 if x > 0 else (-1.0 if x < 0 else x)
    if c == FLOOR:
        return np.floor(x)
    if c == CEIL:
        return np.ceil(x)
    return x if c == ASSIGN else _elementary(c, x)


@_inner
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


@_inner
def _other(c: int, x: float, y: float) -> float:
    return _of_two(c, x, y) if c < FIRST_OF_ONE else _of_one(c, x)


@_compiled
def run(
    codes: np.ndarray, registers: np.ndarray, values: np.ndarray, ends: tuple, w: np.ndarray, first: int, last: int
) -> None:
    """Run a program on the points ``first`` to ``last``, as many at once as there are lanes.

    ``ends``: numbers that are read, and for each input where that of the first point stands and how far the next is;
    numbers that are written, and the same for each output; ``w``: registers, shape ``(size, lanes)``, lanes in whole
    vectors.
    """
    inputs, sources, outputs, targets = ends
    lanes = w.shape[1]
    for s in range(first, last, lanes):
        m = min(lanes, last - s)
        for k in range(codes.size):
            if _on_lanes(codes, registers, values, w, m, k):
                continue
            c, v, o, x = codes[k], values[k], registers[k, 0], registers[k, 1]
            if c == INPUT:
                begin, step = sources[int(v), 0] + s * sources[int(v), 1], sources[int(v), 1]
                for j in range(m):
                    w[o, j] = inputs[begin + j * step]
            elif c == OUTPUT:
                begin, step = targets[int(v), 0] + s * targets[int(v), 1], targets[int(v), 1]
                for j in range(m):
                    outputs[begin + j * step] = w[x, j]
            else:  # its own time hides the choice
                y = registers[k, 2]
                for j in range(m):
                    w[o, j] = _other(c, w[x, j], w[y, j])


@_compiled
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
