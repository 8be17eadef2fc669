"""From a JAX function to SymPy expressions: its jaxpr evaluated on arrays of symbols."""

import math
import operator
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import sympy

from ....manifolds import InvalidInputError

# Primitives that only move entries: JAX itself moves the numbers of the entries.
MOVES = {
    "broadcast_in_dim",
    "concatenate",
    "convert_element_type",
    "copy",
    "dynamic_slice",
    "expand_dims",
    "gather",
    "reshape",
    "rev",
    "slice",
    "split",
    "squeeze",
    "stack",
    "transpose",
    "unstack",
}
INDEXED = {"dynamic_slice", "gather"}  # of these only the first operand is moved
CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr"}
ENTRYWISE: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "add_any": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "neg": operator.neg,
    "pow": operator.pow,
    "square": lambda a: a**2,
    "sqrt": sympy.sqrt,
    "rsqrt": lambda a: 1 / sympy.sqrt(a),
    "sin": sympy.sin,
    "cos": sympy.cos,
    "tan": sympy.tan,
    "sinh": sympy.sinh,
    "cosh": sympy.cosh,
    "tanh": sympy.tanh,
    "exp": sympy.exp,
    "log": sympy.log,
}


def trace(function: Callable[..., Any], *arguments: np.ndarray) -> np.ndarray:
    """Value of a JAX function of arrays at arrays of SymPy expressions; floats become fractions by ``fraction``.

    Raises ``InvalidInputError`` if the function uses an operation that has no exact counterpart here.
    """
    shapes = [jax.ShapeDtypeStruct(a.shape, jnp.result_type(float)) for a in arguments]
    closed = jax.make_jaxpr(function)(*shapes)
    return _evaluate(closed.jaxpr, closed.consts, list(arguments))[0]


def _evaluate(jaxpr: Any, constants: Any, arguments: list[Any]) -> list[Any]:
    known = dict(zip(jaxpr.constvars, constants, strict=True)) | dict(zip(jaxpr.invars, arguments, strict=True))
    for equation in jaxpr.eqns:
        values = [v.val if hasattr(v, "val") else known[v] for v in equation.invars]
        known.update(zip(equation.outvars, _apply(equation, values), strict=True))
    return [v.val if hasattr(v, "val") else known[v] for v in jaxpr.outvars]


def _apply(equation: Any, values: list[Any]) -> list[Any]:
    name, parameters = equation.primitive.name, equation.params
    if name in CALLS:
        inner = parameters[CALLS[name]]
        return _evaluate(inner.jaxpr, inner.consts, values)
    if not any(_is_exact(value) for value in values):
        result = equation.primitive.bind(*map(jnp.asarray, values), **parameters)
        return list(result) if equation.primitive.multiple_results else [result]
    if name in MOVES:
        return _moved(equation, values)
    exact = [_exact(value) for value in values]
    if name in ENTRYWISE:
        return [np.asarray(np.frompyfunc(ENTRYWISE[name], len(exact), 1)(*exact), dtype=object)]
    if name == "integer_pow":
        return [np.asarray(exact[0] ** parameters["y"], dtype=object)]
    if name == "reduce_sum":
        return [np.asarray(np.sum(exact[0], axis=tuple(parameters["axes"])), dtype=object)]
    if name == "dot_general" and not parameters["dimension_numbers"][1][0]:
        return [np.asarray(np.tensordot(*exact, axes=parameters["dimension_numbers"][0]), dtype=object)]
    raise InvalidInputError(
        f"the operation {name} of the problem's functions has no exact counterpart; classify it without symbolic=True"
    )


def _moved(equation: Any, values: list[Any]) -> list[Any]:
    """The entries where JAX moves their numbers."""
    count = 1 if equation.primitive.name in INDEXED else len(values)
    data = [_exact(value) for value in values[:count]]
    pool = np.concatenate([a.ravel() for a in data])
    starts = np.cumsum([0, *(a.size for a in data)])
    numbers = [jnp.arange(a.size).reshape(a.shape) + start for a, start in zip(data, starts, strict=False)]
    if equation.primitive.name == "convert_element_type":
        return [data[0]]
    result = equation.primitive.bind(*numbers, *map(jnp.asarray, values[count:]), **equation.params)
    return [
        np.asarray(pool[np.asarray(part)], dtype=object) for part in (result if equation.primitive.multiple_results else [result])
    ]


def _is_exact(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.dtype == object


def _exact(value: Any) -> np.ndarray:
    """An array of SymPy expressions."""
    if _is_exact(value):
        return value
    numbers = np.asarray(value)
    return np.array([fraction(a) for a in numbers.ravel()], dtype=object).reshape(numbers.shape)


def fraction(a: Any) -> Any:
    """The rational number that was meant by a NumPy float: each rounds to its float, so that different ones stay different.

    The decimal that names it, as 1/10 for 0.1, if that is shorter than any decimal for a float has to be; otherwise a power
    of ten times the fraction of least denominator that rounds to it, as 1/3 for 0.3333333333333333. Raises
    ``InvalidInputError`` if it is not finite.
    """
    if not np.isfinite(a):
        raise InvalidInputError(f"the problem's functions contain the constant {a}; classify it without symbolic=True")
    if not np.issubdtype(a.dtype, np.floating):
        return sympy.Integer(int(a))
    decimal = Fraction(str(a))
    if len(str(decimal.numerator).strip("-0")) <= np.finfo(a.dtype).precision:
        return sympy.Rational(decimal)
    size, unit = abs(a), Fraction(10) ** int(f"{abs(a):e}".split("e")[1])
    below, exact = (Fraction(float(b)) / unit for b in (np.nextafter(size, a.dtype.type(0)), size))
    half = (exact - below) / 2  # the gap above is no smaller
    return sympy.Rational(int(np.sign(a)) * unit * _simplest(exact - half, exact + half))


def _simplest(low: Fraction, high: Fraction) -> Fraction:
    """The fraction of least denominator between two positive ones, by their continued fractions."""
    whole = math.ceil(low)
    if whole <= high:
        return Fraction(whole)
    return whole - 1 + 1 / _simplest(1 / (high - whole + 1), 1 / (low - whole + 1))
