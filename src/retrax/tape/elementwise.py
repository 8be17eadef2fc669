"""Rules of JAX's elementwise primitives on arrays of scalars."""

import math
from collections.abc import Callable
from functools import reduce
from typing import Any

import casadi as ca
import numpy as np

from .arrays import Complex, Entries, NotTraceableError, Scalars, broadcast, column, is_complex, moved, parts, scalars

Function = Callable[..., ca.SX]


def select(condition: ca.SX, yes: ca.SX | float, no: ca.SX | float) -> ca.SX:
    """``yes`` where the condition holds, ``no`` elsewhere, entry by entry."""
    yes, no = (a if isinstance(a, ca.SX) else ca.SX(a) for a in (yes, no))
    over, under = _not_finite(yes), _not_finite(no)
    if not (over.any() or under.any()):
        return ca.if_else(condition, yes, no)
    value = ca.if_else(condition, ca.if_else(ca.DM(over != 0), 0, yes), ca.if_else(ca.DM(under != 0), 0, no))
    return value + _zero_if(ca.logic_not(condition), over) + _zero_if(condition, under)


def _not_finite(x: ca.SX) -> np.ndarray:
    """The constants in a matrix that are NaN or infinite, zero elsewhere."""
    elements: list[Any] = x.elements()
    entries = [float(a) if a.is_constant() else 0.0 for a in elements]
    return np.where(np.isfinite(entries), 0.0, entries).reshape(x.shape, order="F")


def _zero_if(holds: ca.SX, numbers: np.ndarray) -> ca.SX:
    """Zero where a condition holds, elsewhere numbers that are NaN, infinite, or zero too.

    By logarithms of 1, 0 and -1. Of "NaN or zero" times x CasADi would make "NaN times x, or zero", whose derivative is
    NaN times false.
    """
    infinite = ca.DM(np.sign(np.nan_to_num(numbers)))
    return ca.DM(np.isnan(numbers) * 1.0) * ca.log(2 * holds - 1) - infinite * ca.log(holds)


def larger(x: ca.SX, y: ca.SX) -> ca.SX:
    """The maximum as JAX has it: NaN if one is, and half of either derivative where they are equal."""
    return select(x > y, x, select(y > x, y, (x + y) / 2))


def smaller(x: ca.SX, y: ca.SX) -> ca.SX:
    """The minimum."""
    return select(x < y, x, select(y < x, y, (x + y) / 2))


def truncated(x: ca.SX) -> ca.SX:
    """The whole number next to ``x`` towards zero."""
    return ca.sign(x) * ca.floor(ca.fabs(x))


def _logistic(x: ca.SX) -> ca.SX:
    # Each branch sees only arguments at which neither it nor its derivatives overflow.
    low, high = select(x < 0, x, 0.0), select(x < 0, 0.0, x)
    return select(x < 0, ca.exp(low) / (1 + ca.exp(low)), 1 / (1 + ca.exp(-high)))


def _unequal(x: ca.SX, y: ca.SX) -> ca.SX:
    # CasADi simplifies x != x to false: of one scalar it is the test for NaN.
    entries = [1 - (ca.fabs(a) <= np.inf) if ca.is_equal(a, b) else a != b for a, b in _pairs(x, y)]
    return ca.vertcat(*entries)


def _equal(x: ca.SX, y: ca.SX) -> ca.SX:
    return ca.vertcat(*(ca.fabs(a) <= np.inf if ca.is_equal(a, b) else a == b for a, b in _pairs(x, y)))


def _pairs(x: ca.SX, y: ca.SX) -> list[tuple[ca.SX, ca.SX]]:
    count = max(x.shape[0], y.shape[0])
    return [(x[min(k, x.shape[0] - 1)], y[min(k, y.shape[0] - 1)]) for k in range(count)]


# Functions of real arrays of one shape.
REAL: dict[str, Function] = {
    "abs": lambda x: select(x < 0, -x, x),  # its derivative at zero is that of JAX: one
    "acos": ca.acos,
    "acosh": ca.acosh,
    "add": lambda x, y: x + y,
    "add_any": lambda x, y: x + y,
    "asin": ca.asin,
    "asinh": ca.asinh,
    "atan": ca.atan,
    "atan2": ca.atan2,
    "atanh": ca.atanh,
    "cbrt": lambda x: ca.sign(x) * ca.fabs(x) ** (1 / 3),
    "ceil": ca.ceil,
    "conj": lambda x: x,
    "copy": lambda x: x,
    "cos": ca.cos,
    "cosh": ca.cosh,
    "erf": ca.erf,
    "exp": ca.exp,
    "exp2": lambda x: ca.exp(x * np.log(2.0)),
    "expm1": ca.expm1,
    "floor": ca.floor,
    "ge": lambda x, y: x >= y,
    "gt": lambda x, y: x > y,
    "is_finite": lambda x: ca.fabs(x) < np.inf,
    "le": lambda x, y: x <= y,
    "log": ca.log,
    "log1p": ca.log1p,
    "log2": lambda x: ca.log(x) / np.log(2.0),
    "logistic": _logistic,
    "lt": lambda x, y: x < y,
    "le_to": lambda x, y: x <= y,
    "lt_to": lambda x, y: x < y,
    "max": larger,
    "min": smaller,
    "mul": lambda x, y: x * y,
    "ne": _unequal,
    "eq": _equal,
    "neg": lambda x: -x,
    "one_minus_square": lambda x: (1 + x) * (1 - x),
    "polynomial": lambda x, *c: reduce(lambda value, a: value * x + a, c[-2::-1], c[-1]),
    "real": lambda x: x,
    "rem": ca.fmod,
    "rsqrt": lambda x: 1 / ca.sqrt(x),
    "sign": ca.sign,
    "sin": ca.sin,
    "sinh": ca.sinh,
    "sqrt": ca.sqrt,
    "square": lambda x: x * x,
    "sub": lambda x, y: x - y,
    "tan": ca.tan,
    "tanh": ca.tanh,
}


def elementwise(name: str, params: dict[str, Any], arrays: list[Entries]) -> Entries | None:
    """The value of an elementwise primitive, or None if the primitive is not one."""
    if name in _OTHERS:
        return _OTHERS[name](params, *arrays)
    if any(is_complex(a) for a in arrays):
        return _complex(name, [parts(a) for a in arrays]) if name in _COMPLEX else None
    return _mapped(REAL[name], *arrays) if name in REAL else None


def _mapped(function: Function, *arrays: Any) -> Scalars:
    """A function of columns on real arrays."""
    alike, shape = broadcast(*arrays)
    return _full(function(*(column(a) for a in alike)), shape)


def _full(values: ca.SX, shape: tuple[int, ...]) -> Scalars:
    count = math.prod(shape)
    return scalars(values if values.shape[0] == count else ca.repmat(values, count, 1), shape)


def _complex(name: str, pairs: list[tuple[Entries, Entries]]) -> Entries:
    alike, shape = broadcast(*(half for pair in pairs for half in pair))
    value = _COMPLEX[name](*((column(a), column(b)) for a, b in zip(alike[::2], alike[1::2], strict=True)))
    return Complex(*(_full(part, shape) for part in value)) if isinstance(value, tuple) else _full(value, shape)


Pair = tuple[ca.SX, ca.SX]


def _sum(x: Pair, y: Pair) -> Pair:
    return x[0] + y[0], x[1] + y[1]


def product(x: Pair, y: Pair) -> Pair:
    """Product of complex numbers."""
    return x[0] * y[0] - x[1] * y[1], x[0] * y[1] + x[1] * y[0]


def _quotient(x: Pair, y: Pair) -> Pair:
    size = y[0] * y[0] + y[1] * y[1]
    a, b = product(x, (y[0], -y[1]))
    return a / size, b / size


def _length(square: ca.SX) -> ca.SX:
    """Its root, whose derivative at zero is that of JAX: none."""
    return select(square > 0, ca.sqrt(select(square > 0, square, 1.0)), square)


def _exponential(x: Pair) -> Pair:
    size = ca.exp(x[0])
    return size * ca.cos(x[1]), size * ca.sin(x[1])


# Functions of complex arrays of one shape, as pairs.
_COMPLEX: dict[str, Callable[..., Pair | ca.SX]] = {
    "abs": lambda x: _length(x[0] * x[0] + x[1] * x[1]),
    "add": _sum,
    "add_any": _sum,
    "conj": lambda x: (x[0], -x[1]),
    "copy": lambda x: x,
    "div": _quotient,
    "eq": lambda x, y: ca.logic_and(_equal(x[0], y[0]), _equal(x[1], y[1])),
    "exp": _exponential,
    "imag": lambda x: x[1],
    "log": lambda x: (ca.log(x[0] * x[0] + x[1] * x[1]) / 2, ca.atan2(x[1], x[0])),
    "log2": lambda x: (ca.log(x[0] * x[0] + x[1] * x[1]) / np.log(4.0), ca.atan2(x[1], x[0]) / np.log(2.0)),
    "mul": product,
    "ne": lambda x, y: ca.logic_or(_unequal(x[0], y[0]), _unequal(x[1], y[1])),
    "neg": lambda x: (-x[0], -x[1]),
    "polynomial": lambda x, *c: reduce(lambda value, a: _sum(product(value, x), a), c[-2::-1], c[-1]),
    "real": lambda x: x[0],
    "square": lambda x: product(x, x),
    "sub": lambda x, y: (x[0] - y[0], x[1] - y[1]),
}


def select_n(params: dict[str, Any], which: Entries, *cases: Entries) -> Entries:
    if isinstance(which, np.ndarray) and not which.shape:
        return cases[int(which)]
    if any(is_complex(case) for case in cases):
        halves = zip(*(parts(case) for case in cases), strict=True)
        return Complex(*(select_n(params, which, *half) for half in halves))

    def chosen(which: ca.SX, *cases: ca.SX) -> ca.SX:
        last = len(cases) - 1
        return reduce(lambda rest, k: select(which <= k, cases[k], rest), reversed(range(last)), cases[last])

    if isinstance(which, np.ndarray):  # the entries are known one by one: nothing of the others enters the graph
        columns = [column(case) for case in cases]
        entries = [columns[int(w)][k] for k, w in enumerate(which.reshape(-1))]
        return scalars(ca.vertcat(*entries), which.shape)
    return _mapped(chosen, which, *cases)


def _integer_pow(params: dict[str, Any], x: Entries) -> Entries:
    exponent = int(params["y"])
    power = _repeated(parts(x), abs(exponent)) if is_complex(x) else None
    if power is not None:
        one = ca.SX.ones(1), ca.SX.zeros(1)
        value = power if exponent >= 0 else _quotient(one, power)
        return Complex(*(scalars(part, x.shape) for part in value))
    value, base = None, column(x)
    for bit in bin(abs(exponent))[2:]:
        value = None if value is None else value * value
        value = (base if value is None else value * base) if bit == "1" else value
    value = ca.SX.ones(base.shape[0]) if value is None else value
    return scalars(value if exponent >= 0 else 1 / value, x.shape)


def _repeated(x: tuple[Entries, Entries], exponent: int) -> Pair:
    base = column(x[0]), column(x[1])
    value = ca.SX.ones(base[0].shape[0]), ca.SX.zeros(base[0].shape[0])
    for _ in range(exponent):
        value = product(value, base)
    return value


def _convert(params: dict[str, Any], x: Entries) -> Entries:
    kind = np.dtype(params["new_dtype"]).kind
    if kind == "c":
        return x if isinstance(x, Complex) else Complex(*parts(x))
    if isinstance(x, Complex):
        x = x.real
    if kind == "b":
        return _mapped(lambda a: a != 0, x)
    return _mapped(truncated, x) if kind in "iu" else x


def _paired(*halves: Any) -> Complex:
    """A complex array from its parts, of which one may be a single number."""
    shape = np.broadcast_shapes(*(half.shape for half in halves))
    return Complex(
        *(half if half.shape == shape else moved(half, lambda a: np.broadcast_to(a, shape)) for half in halves)
    )


def _round(params: dict[str, Any], x: Entries) -> Entries:
    def away(a: ca.SX) -> ca.SX:
        return ca.sign(a) * ca.floor(ca.fabs(a) + 0.5)

    def even(a: ca.SX) -> ca.SX:
        near = ca.floor(a + 0.5)
        odd = ca.fabs(ca.fmod(near, 2.0)) > 0
        return select(ca.logic_and(near - a == 0.5, odd), near - 1, near)

    return _mapped(away if int(params["rounding_method"]) == 0 else even, x)


def _divided(params: dict[str, Any], x: Entries, y: Entries) -> Entries:
    if is_complex(x) or is_complex(y):
        return _complex("div", [parts(x), parts(y)])
    whole = params.get("whole", False)
    return _mapped(lambda a, b: truncated(a / b) if whole else a / b, x, y)


def _logic(params: dict[str, Any], name: str, *arrays: Entries) -> Entries:
    if not params.get("truth", True):
        raise NotTraceableError(name, "here on the bits of whole numbers")
    functions = {"and": ca.logic_and, "or": ca.logic_or, "not": ca.logic_not, "xor": lambda a, b: a != b}
    return _mapped(functions[name], *arrays)


_OTHERS: dict[str, Callable[..., Entries]] = {
    "and": lambda params, *a: _logic(params, "and", *a),
    "complex": lambda params, a, b: _paired(a, b),
    "convert_element_type": _convert,
    "div": _divided,
    "imag": lambda params, a: parts(a)[1],
    "integer_pow": _integer_pow,
    "not": lambda params, *a: _logic(params, "not", *a),
    "or": lambda params, *a: _logic(params, "or", *a),
    "reduce_precision": lambda params, a: a,
    "round": _round,
    "select_n": select_n,
    "xor": lambda params, *a: _logic(params, "xor", *a),
}

KINDS = {*REAL, *_COMPLEX, *_OTHERS}  # the primitives with a rule here
