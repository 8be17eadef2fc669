"""From a JAX function to SymPy expressions: its jaxpr evaluated on arrays of symbols."""

import math
import operator
from collections.abc import Callable
from fractions import Fraction
from functools import reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import sympy

from ....errors import TRACEABLE
from ....jaxpr_tools import called_program
from ....manifolds import InvalidInputError
from ....tracing import trace_program

# Primitives that only move entries: JAX itself moves the numbers of the entries, of all operands or of those named.
MOVING_PRIMITIVES: dict[str, tuple[int, ...] | None] = {
    "broadcast_in_dim": None,
    "concatenate": None,
    "copy": None,
    "dynamic_slice": (0,),
    "dynamic_update_slice": (0, 1),
    "expand_dims": None,
    "gather": (0,),
    "pad": None,
    "reshape": None,
    "rev": None,
    "scatter": (0, 2),
    "slice": None,
    "split": None,
    "squeeze": None,
    "stack": None,
    "transpose": None,
    "unstack": None,
}


def _power(a: Any, b: Any) -> Any:
    return a**b if b.is_Rational else sympy.exp(b * sympy.log(a))


# By exponentials, sines, cosines, logarithms and rational powers, for which the algebra has rules.
ENTRYWISE: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "add_any": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "neg": operator.neg,
    "pow": _power,
    "square": lambda a: a**2,
    "sqrt": sympy.sqrt,
    "rsqrt": lambda a: 1 / sympy.sqrt(a),
    "cbrt": lambda a: a ** sympy.Rational(1, 3),
    "sin": sympy.sin,
    "cos": sympy.cos,
    "tan": lambda a: sympy.sin(a) / sympy.cos(a),
    "sinh": lambda a: (sympy.exp(a) - sympy.exp(-a)) / 2,
    "cosh": lambda a: (sympy.exp(a) + sympy.exp(-a)) / 2,
    "tanh": lambda a: 1 - 2 / (sympy.exp(2 * a) + 1),
    "logistic": lambda a: 1 / (1 + sympy.exp(-a)),
    "exp": sympy.exp,
    "exp2": lambda a: sympy.exp(a * sympy.log(2)),
    "expm1": lambda a: sympy.exp(a) - 1,
    "log": sympy.log,
    "log1p": lambda a: sympy.log(1 + a),
    # Of JAX 0.11 and later.
    "log2": lambda a: sympy.log(a) / sympy.log(2),
    "one_minus_square": lambda a: 1 - a**2,
    "polynomial": lambda a, *c: reduce(lambda value, b: value * a + b, c[-2::-1], c[-1]),
}
REDUCTIONS = {"reduce_sum": np.sum, "reduce_prod": np.prod}


def trace(function: Callable[..., Any], *arguments: np.ndarray) -> np.ndarray:
    """Value of a JAX function of arrays at arrays of SymPy expressions; floats become fractions by ``fraction``.

    Raises ``InvalidInputError`` if the function uses an operation that has no exact counterpart here, or cannot be
    traced.
    """
    shapes = [jax.ShapeDtypeStruct(a.shape, jnp.result_type(float)) for a in arguments]
    try:
        closed = trace_program(function, *shapes)
    except InvalidInputError:
        raise
    except (TypeError, ValueError, IndexError) as error:
        reason = TRACEABLE if isinstance(error, jax.errors.JAXTypeError) else str(error)
        raise InvalidInputError(
            f"the problem's functions fail on arrays of shapes {[a.shape for a in arguments]}: {reason}; try "
            "problem.check(q, u)"
        ) from error
    return _evaluate(closed.jaxpr, closed.consts, list(arguments))[0]


def _evaluate(jaxpr: Any, constants: Any, arguments: list[Any]) -> list[Any]:
    known = dict(zip(jaxpr.constvars, constants, strict=True)) | dict(zip(jaxpr.invars, arguments, strict=True))
    for equation in jaxpr.eqns:
        values = [v.val if hasattr(v, "val") else known[v] for v in equation.invars]
        known.update(zip(equation.outvars, _apply(equation, values), strict=True))
    return [v.val if hasattr(v, "val") else known[v] for v in jaxpr.outvars]


def _apply(equation: Any, values: list[Any]) -> list[Any]:
    name, parameters = equation.primitive.name, equation.params
    if (inner := called_program(equation)) is not None:
        return _evaluate(inner.jaxpr, inner.consts, values)
    if not any(_is_exact(value) for value in values):
        result = equation.primitive.bind(*map(jnp.asarray, values), **parameters)
        return list(result) if equation.primitive.multiple_results else [result]
    if name in MOVING_PRIMITIVES:
        return _move(equation, values, MOVING_PRIMITIVES[name] or tuple(range(len(values))))
    if name == "select_n" and not _is_exact(values[0]):
        return _move(equation, values, tuple(range(1, len(values))))
    if name == "convert_element_type" and jnp.issubdtype(parameters["new_dtype"], jnp.floating):
        return [values[0]]
    exact = [_exact(value) for value in values]
    if name in ENTRYWISE:
        return [np.asarray(np.frompyfunc(ENTRYWISE[name], len(exact), 1)(*exact), dtype=object)]
    if name == "integer_pow":
        return [np.asarray(exact[0] ** parameters["y"], dtype=object)]
    if name in REDUCTIONS:
        return [np.asarray(REDUCTIONS[name](exact[0], axis=tuple(parameters["axes"])), dtype=object)]
    if name == "dot_general":
        return [_product(*exact, *parameters["dimension_numbers"])]
    raise InvalidInputError(
        f"the problem's functions use the operation {name}; exact algebra treats sums, products, rational powers, exp, "
        "log, sin, cos, tan, sinh, cosh and tanh, and moves of entries; classify it without symbolic=True"
    )


def _product(a: np.ndarray, b: np.ndarray, contracted: Any, batched: Any) -> np.ndarray:
    """Sums of products over contracted axes, for each index of the batched axes, which come first."""
    names, count = [list(range(a.ndim)), list(range(a.ndim, a.ndim + b.ndim))], len(batched[0])
    for pairs in (contracted, batched):
        for i, j in zip(*pairs, strict=True):
            names[1][j] = names[0][i]
    summed = {names[0][i] for i in contracted[0]}
    first = [names[0][i] for i in batched[0]]
    rest = [k for k in dict.fromkeys([*names[0], *names[1]]) if k not in summed and k not in first]
    return np.asarray(np.einsum(a, names[0], b, names[1], [*first[:count], *rest]), dtype=object)


def _move(equation: Any, values: list[Any], places: tuple[int, ...]) -> list[Any]:
    """The entries of the operands in these places where JAX moves their numbers."""
    data = {i: _exact(values[i]) for i in places}
    pool = np.concatenate([a.ravel() for a in data.values()])
    starts = np.cumsum([0, *(a.size for a in data.values())])
    numbers = {
        i: jnp.arange(a.size).reshape(a.shape) + start for (i, a), start in zip(data.items(), starts, strict=False)
    }
    operands = [numbers[i] if i in numbers else jnp.asarray(value) for i, value in enumerate(values)]
    result = equation.primitive.bind(*operands, **equation.params)
    return [
        np.asarray(pool[np.asarray(part)], dtype=object)
        for part in (result if equation.primitive.multiple_results else [result])
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
    """The rational number behind a NumPy float, which rounds to the float, so that different floats stay different.

    The decimal that names it, as 1/10 for 0.1, if that is shorter than any decimal for a float has to be; otherwise a
    power of ten times the fraction of least denominator that rounds to it, as 1/3 for 0.3333333333333333. Raises
    ``InvalidInputError`` if it is complex or not finite.
    """
    if np.iscomplexobj(a):
        raise InvalidInputError(
            f"the problem's functions contain the complex constant {a}; classify it without symbolic=True"
        )
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
    """The fraction of least denominator between two positive fractions, by their continued fractions."""
    whole = math.ceil(low)
    if whole <= high:
        return Fraction(whole)
    return whole - 1 + 1 / _simplest(1 / (high - whole + 1), 1 / (low - whole + 1))
