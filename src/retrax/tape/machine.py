"""The machine that runs programs: every instruction acts on a lane of points at once.

Numba compiles it once on a computer and keeps it on its disk. A program is data to it: nothing is compiled for one.
"""

import math
from typing import Any

import numba
import numpy as np

from .program import NAMES

LANES = 64  # points that an instruction acts on at once: enough to hide its choice, few enough for the nearest caches

(
    ADD, SUB, MUL, DIV, MUL_ADD, MUL_SUB, SUB_MUL, ADD_CONST, MUL_CONST, CONST_SUB, CONST_DIV, SELECT, CONST, INPUT, OUTPUT,
    IF_ELSE_ZERO, POW, CONSTPOW, LT, LE, EQ, NE, AND, OR, FMOD, COPYSIGN, FMIN, FMAX, ATAN2, HYPOT,
    NEG, SQ, TWICE, SQRT, INV, ASSIGN, NOT, FLOOR, CEIL, FABS, SIGN,
    SIN, COS, TAN, EXP, LOG, ASIN, ACOS, ATAN, ERF, SINH, COSH, TANH, ASINH, ACOSH, ATANH, LOG1P, EXPM1,
) = range(len(NAMES))  # fmt: skip
FIRST_OF_ONE = NEG

_compiled: Any = numba.njit(cache=True, error_model="numpy", nogil=True)


@_compiled
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


@_compiled
def _of_one(c: int, x: float) -> float:
    if c == FABS:
        return abs(x)
    if c == SIGN:
        return 1.0 if x > 0 else (-1.0 if x < 0 else x)
    if c == NOT:
        return 1.0 if x == 0 else 0.0
    if c == FLOOR:
        return np.floor(x)
    if c == CEIL:
        return np.ceil(x)
    return x if c == ASSIGN else _elementary(c, x)


@_compiled
def _of_two(c: int, x: float, y: float) -> float:
    if c == LT:
        return 1.0 if x < y else 0.0
    if c == LE:
        return 1.0 if x <= y else 0.0
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


@_compiled
def _rare(c: int, w: np.ndarray, o: int, x: int, y: int) -> None:
    """Instructions whose own time hides the choice among them, lane by lane."""
    if c < FIRST_OF_ONE:
        for j in range(LANES):
            w[o, j] = _of_two(c, w[x, j], w[y, j])
    else:
        for j in range(LANES):
            w[o, j] = _of_one(c, w[x, j])


@_compiled
def _common(c: int, v: float, w: np.ndarray, o: int, x: int, y: int, z: int) -> None:
    if c == DIV:
        for j in range(LANES):
            w[o, j] = w[x, j] / w[y, j]
    elif c == SQ:
        for j in range(LANES):
            w[o, j] = w[x, j] * w[x, j]
    elif c == NEG:
        for j in range(LANES):
            w[o, j] = -w[x, j]
    elif c == TWICE:
        for j in range(LANES):
            w[o, j] = w[x, j] + w[x, j]
    elif c == INV:
        for j in range(LANES):
            w[o, j] = 1.0 / w[x, j]
    elif c == SQRT:
        for j in range(LANES):
            w[o, j] = np.sqrt(w[x, j])
    elif c == SELECT:
        for j in range(LANES):
            w[o, j] = w[y, j] if w[x, j] != 0 else w[z, j]
    elif c == IF_ELSE_ZERO:
        for j in range(LANES):
            w[o, j] = w[y, j] if w[x, j] != 0 else 0.0
    elif c == CONST:
        for j in range(LANES):
            w[o, j] = v
    elif c == ADD_CONST:
        for j in range(LANES):
            w[o, j] = w[x, j] + v
    elif c == CONST_SUB:
        for j in range(LANES):
            w[o, j] = v - w[x, j]
    elif c == CONST_DIV:
        for j in range(LANES):
            w[o, j] = v / w[x, j]
    else:
        _rare(c, w, o, x, y)


@_compiled
def _block(codes: np.ndarray, registers: np.ndarray, values: np.ndarray, ends: tuple, w: np.ndarray, s: int, m: int) -> None:
    """Run a program on the points ``s`` to ``s + m``; ``ends`` are all inputs and outputs."""
    inputs, outputs = ends
    for k in range(codes.size):
        c, v = codes[k], values[k]
        o, x, y, z = registers[k, 0], registers[k, 1], registers[k, 2], registers[k, 3]
        if c == MUL:
            for j in range(LANES):
                w[o, j] = w[x, j] * w[y, j]
        elif c == MUL_ADD:
            for j in range(LANES):
                w[o, j] = w[x, j] * w[y, j] + w[z, j]
        elif c == MUL_SUB:
            for j in range(LANES):
                w[o, j] = w[x, j] * w[y, j] - w[z, j]
        elif c == SUB_MUL:
            for j in range(LANES):
                w[o, j] = w[z, j] - w[x, j] * w[y, j]
        elif c == ADD:
            for j in range(LANES):
                w[o, j] = w[x, j] + w[y, j]
        elif c == SUB:
            for j in range(LANES):
                w[o, j] = w[x, j] - w[y, j]
        elif c == MUL_CONST:
            for j in range(LANES):
                w[o, j] = w[x, j] * v
        elif c == INPUT:
            for j in range(m):
                w[o, j] = inputs[int(v), s + j]
        elif c == OUTPUT:
            for j in range(m):
                outputs[int(v), s + j] = w[x, j]
        else:
            _common(c, v, w, o, x, y, z)


@_compiled
def run(codes: np.ndarray, registers: np.ndarray, values: np.ndarray, ends: tuple, w: np.ndarray, first: int, last: int) -> None:
    """Run a program on the points ``first`` to ``last``.

    ``ends``: inputs and outputs, a row for each scalar and a column for each point; ``w``: registers, shape ``(size, LANES)``.
    """
    for s in range(first, last, LANES):
        _block(codes, registers, values, ends, w, s, min(LANES, last - s))


@_compiled
def run_one(codes: np.ndarray, registers: np.ndarray, values: np.ndarray, v: np.ndarray, w: np.ndarray) -> None:
    """Run a program on one point; ``v``: inputs and outputs, in the places that are operand and destination; ``w``: registers."""
    for k in range(codes.size):
        c = codes[k]
        o, x, y, z = registers[k, 0], registers[k, 1], registers[k, 2], registers[k, 3]
        if c == MUL:
            w[o] = w[x] * w[y]
        elif c == MUL_ADD:
            w[o] = w[x] * w[y] + w[z]
        elif c == MUL_SUB:
            w[o] = w[x] * w[y] - w[z]
        elif c == SUB_MUL:
            w[o] = w[z] - w[x] * w[y]
        elif c == ADD:
            w[o] = w[x] + w[y]
        elif c == SUB:
            w[o] = w[x] - w[y]
        elif c == MUL_CONST:
            w[o] = w[x] * values[k]
        elif c == INPUT:
            w[o] = v[x]
        elif c == OUTPUT:
            v[o] = w[x]
        elif c == CONST:
            w[o] = values[k]
        else:
            w[o] = _other(c, values[k], w[x], w[y], w[z])


@_compiled
def _other(c: int, v: float, x: float, y: float, z: float) -> float:
    if c == DIV:
        return x / y
    if c == SQ:
        return x * x
    if c == NEG:
        return -x
    if c == TWICE:
        return x + x
    if c == INV:
        return 1.0 / x
    if c == SQRT:
        return np.sqrt(x)
    if c == SELECT:
        return y if x != 0 else z
    if c == IF_ELSE_ZERO:
        return y if x != 0 else 0.0
    if c == ADD_CONST:
        return x + v
    if c == CONST_SUB:
        return v - x
    if c == CONST_DIV:
        return v / x
    return _of_two(c, x, y) if c < FIRST_OF_ONE else _of_one(c, x)
