"""Rules of JAX's elementwise primitives on arrays of scalars."""

import math
from collections.abc import Callable
from functools import reduce
from typing import Any

import casadi as ca
import numpy as np

from . import complex_rules
from .arrays import (
    Complex,
    Entries,
    NotTraceableError,
    Scalars,
    broadcast,
    column,
    is_complex,
    move_entries,
    parts,
    scalars,
)
from .choice import select
from .complex_rules import Pair, product, whole_power

Function = Callable[..., ca.SX]

SQUARES = {ca.OP_SQ, ca.OP_FABS, ca.OP_EXP, ca.OP_SQRT, ca.OP_COSH, ca.OP_HYPOT}
SUM_OPERATIONS = {ca.OP_ADD, ca.OP_TWICE, ca.OP_FMAX}  # none of these is negative if what they are made of is not
LONGEST_SUM = 200  # nodes of an expression that are looked at for a sum of squares


def larger(x: ca.SX, y: ca.SX) -> ca.SX:
    """The maximum as JAX has it: NaN if one is, and half of either derivative where they are equal."""
    return select(x > y, x, select(y > x, y, (x + y) / 2))


def smaller(x: ca.SX, y: ca.SX) -> ca.SX:
    """The minimum."""
    return select(x < y, x, select(y < x, y, (x + y) / 2))


def truncate(x: ca.SX) -> ca.SX:
    """The whole number next to ``x`` towards zero."""
    return ca.sign(x) * ca.floor(ca.fabs(x))


def _logistic(x: ca.SX) -> ca.SX:
    # Each branch sees only arguments at which neither it nor its derivatives overflow.
    low, high = select(x < 0, x, 0.0), select(x < 0, 0.0, x)
    return select(x < 0, ca.exp(low) / (1 + ca.exp(low)), 1 / (1 + ca.exp(-high)))


def square_root(x: ca.SX) -> ca.SX:
    """The square root, NaN below zero also where its square is taken, which CasADi simplifies to the number itself."""
    outside = [0.0 if _is_square(a) else select(a < 0, np.nan, 0.0) for a in ca.vertsplit(x)]
    return ca.sqrt(x) + ca.vertcat(*outside)


def _is_square(x: ca.SX) -> bool:
    """Whether an expression is seen to be nowhere negative, as a sum of squares."""
    left = [x]
    for _ in range(LONGEST_SUM):
        if not left:
            return True
        a = left.pop()
        if a.is_constant():
            known = float(a) >= 0
        elif a.op() in SUM_OPERATIONS:
            known = True
            left += [a.dep(k) for k in range(a.n_dep())]
        else:
            known = a.op() in SQUARES
        if not known:
            return False
    return False


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
REAL_RULES: dict[str, Function] = {
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
    "sqrt": square_root,
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
    return _map_columns(REAL_RULES[name], *arrays) if name in REAL_RULES else None


def _map_columns(function: Function, *arrays: Any) -> Scalars:
    """A function of columns on real arrays."""
    alike, shape = broadcast(*arrays)
    return _full(function(*(column(a) for a in alike)), shape)


def _full(values: ca.SX, shape: tuple[int, ...]) -> Scalars:
    count = math.prod(shape)
    return scalars(values if values.shape[0] == count else ca.repmat(values, count, 1), shape)


def _complex(name: str, arrays: list[tuple[Entries, Entries]]) -> Entries:
    alike, shape = broadcast(*(half for pair in arrays for half in pair))
    value = _COMPLEX[name](*((column(a), column(b)) for a, b in zip(alike[::2], alike[1::2], strict=True)))
    return Complex(*(_full(part, shape) for part in value)) if isinstance(value, tuple) else _full(value, shape)


# Functions of complex arrays of one shape, as pairs.
_COMPLEX: dict[str, Callable[..., Pair | ca.SX]] = {
    "abs": complex_rules.size,
    "add": complex_rules.total,
    "add_any": complex_rules.total,
    "conj": lambda x: (x[0], -x[1]),
    "copy": lambda x: x,
    "cos": lambda x: (ca.cos(x[0]) * ca.cosh(x[1]), -ca.sin(x[0]) * ca.sinh(x[1])),
    "cosh": lambda x: (ca.cosh(x[0]) * ca.cos(x[1]), ca.sinh(x[0]) * ca.sin(x[1])),
    "div": complex_rules.quotient,
    "eq": lambda x, y: ca.logic_and(_equal(x[0], y[0]), _equal(x[1], y[1])),
    "exp": complex_rules.exponential,
    "exp2": lambda x: complex_rules.exponential((x[0] * np.log(2.0), x[1] * np.log(2.0))),
    "expm1": complex_rules.exponential_less_one,
    "imag": lambda x: x[1],
    "log": lambda x: (ca.log(x[0] * x[0] + x[1] * x[1]) / 2, ca.atan2(x[1], x[0])),
    "log1p": complex_rules.logarithm_of_one_more,
    "log2": lambda x: (ca.log(x[0] * x[0] + x[1] * x[1]) / np.log(4.0), ca.atan2(x[1], x[0]) / np.log(2.0)),
    "logistic": complex_rules.logistic,
    "mul": product,
    "ne": lambda x, y: ca.logic_or(_unequal(x[0], y[0]), _unequal(x[1], y[1])),
    "neg": lambda x: (-x[0], -x[1]),
    "polynomial": lambda x, *c: reduce(lambda value, a: complex_rules.total(product(value, x), a), c[-2::-1], c[-1]),
    "real": lambda x: x[0],
    "rsqrt": complex_rules.inverse_root,
    "sin": lambda x: (ca.sin(x[0]) * ca.cosh(x[1]), ca.cos(x[0]) * ca.sinh(x[1])),
    "sinh": lambda x: (ca.sinh(x[0]) * ca.cos(x[1]), ca.cosh(x[0]) * ca.sin(x[1])),
    "sqrt": complex_rules.root,
    "square": lambda x: product(x, x),
    "sub": lambda x, y: (x[0] - y[0], x[1] - y[1]),
    "tan": complex_rules.tangent,
    "tanh": complex_rules.hyperbolic_tangent,
}


def select_n(params: dict[str, Any], which: Entries, *cases: Entries) -> Entries:
    if isinstance(which, np.ndarray) and not which.shape:
        return cases[int(which)]
    if any(is_complex(case) for case in cases):
        halves = zip(*(parts(case) for case in cases), strict=True)
        return Complex(*(select_n(params, which, *half) for half in halves))

    def choose(which: ca.SX, *cases: ca.SX) -> ca.SX:
        last = len(cases) - 1
        return reduce(lambda rest, k: select(which <= k, cases[k], rest), reversed(range(last)), cases[last])

    if isinstance(which, np.ndarray):  # the entries are known one by one: nothing of the others enters the graph
        columns = [column(case) for case in cases]
        entries = [columns[int(w)][k] for k, w in enumerate(which.reshape(-1))]
        return scalars(ca.vertcat(*entries), which.shape)
    return _map_columns(choose, which, *cases)


def _integer_pow(params: dict[str, Any], x: Entries) -> Entries:
    exponent = int(params["y"])
    if is_complex(x):
        real, imag = parts(x)
        power = whole_power((column(real), column(imag)), abs(exponent))
        value = power if exponent >= 0 else complex_rules.quotient(complex_rules.COMPLEX_ONE, power)
        return Complex(*(scalars(part, x.shape) for part in value))
    value, base = None, column(x)
    for bit in bin(abs(exponent))[2:]:
        value = None if value is None else value * value
        value = (base if value is None else value * base) if bit == "1" else value
    value = ca.SX.ones(base.shape[0]) if value is None else value
    return scalars(value if exponent >= 0 else 1 / value, x.shape)


def _convert(params: dict[str, Any], x: Entries) -> Entries:
    kind = np.dtype(params["new_dtype"]).kind
    if kind == "c":
        return x if isinstance(x, Complex) else Complex(*parts(x))
    if isinstance(x, Complex):
        x = x.real
    if kind == "b":
        return _map_columns(lambda a: a != 0, x)
    return _map_columns(truncate, x) if kind in "iu" else x


def _pair(*halves: Any) -> Complex:
    """A complex array from its parts, of which one may be a single number."""
    shape = np.broadcast_shapes(*(half.shape for half in halves))
    return Complex(
        *(half if half.shape == shape else move_entries(half, lambda a: np.broadcast_to(a, shape)) for half in halves)
    )


def _round(params: dict[str, Any], x: Entries) -> Entries:
    def away(a: ca.SX) -> ca.SX:
        return ca.sign(a) * ca.floor(ca.fabs(a) + 0.5)

    def even(a: ca.SX) -> ca.SX:
        near = ca.floor(a + 0.5)
        odd = ca.fabs(ca.fmod(near, 2.0)) > 0
        return select(ca.logic_and(near - a == 0.5, odd), near - 1, near)

    return _map_columns(away if int(params["rounding_method"]) == 0 else even, x)


def _divide(params: dict[str, Any], x: Entries, y: Entries) -> Entries:
    if is_complex(x) or is_complex(y):
        return _complex("div", [parts(x), parts(y)])
    whole = params.get("whole", False)
    return _map_columns(lambda a, b: truncate(a / b) if whole else a / b, x, y)


def _logic(params: dict[str, Any], name: str, *arrays: Entries) -> Entries:
    if not params.get("truth", True):
        raise NotTraceableError(name, "here on the bits of whole numbers")
    functions = {"and": ca.logic_and, "or": ca.logic_or, "not": ca.logic_not, "xor": lambda a, b: a != b}
    return _map_columns(functions[name], *arrays)


_OTHERS: dict[str, Callable[..., Entries]] = {
    "and": lambda params, *a: _logic(params, "and", *a),
    "complex": lambda params, a, b: _pair(a, b),
    "convert_element_type": _convert,
    "div": _divide,
    "imag": lambda params, a: parts(a)[1],
    "integer_pow": _integer_pow,
    "not": lambda params, *a: _logic(params, "not", *a),
    "or": lambda params, *a: _logic(params, "or", *a),
    "reduce_precision": lambda params, a: a,
    "round": _round,
    "select_n": select_n,
    "xor": lambda params, *a: _logic(params, "xor", *a),
}

ELEMENTWISE_PRIMITIVES = {*REAL_RULES, *_COMPLEX, *_OTHERS}  # the primitives with a rule here
