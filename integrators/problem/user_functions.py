"""Functions that users write: the number that they return, and whether they are called while JAX is transforming the
caller."""

from collections.abc import Callable
from functools import partial
from inspect import unwrap
from linecache import getline
from traceback import walk_tb
from types import CodeType, FunctionType, MethodType
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...manifolds import InvalidInputError
from ...manifolds.numerics.ambient import is_traced, is_transformed
from ...manifolds.numerics.precision import working_precision
from ..reporting.result_sentences import warn_of_coarse_values
from .argument_errors import takes_more

LIBRARIES = frozenset(
    {"builtins", "casadi", "equinox", "functools", "jax", "jaxlib", "math", "numpy", "operator", "retrax", "scipy"}
)
TRUTH = "try jnp.where(condition, 1.0, 0.0)"


def real_number(name: str, value: Any) -> Array:
    """The result of a user's function as one real number in the precision in use; raises if the result is something
    else."""
    return _real(name, value, 0, TRUTH)


def real_vector(name: str, value: Any, truth: str) -> Array:
    """The result of a user's function as a real number or a vector; raises if the result is something else.

    ``truth``: what to try instead of a comparison.
    """
    return _real(name, value, 1, truth)


def _real(name: str, value: Any, axes: int, truth: str) -> Array:
    """Real numbers with at most ``axes`` axes."""
    expected = "a real number or a vector of them" if axes else "a real number"
    got = "nothing; did it forget to return?" if value is None else f"{value!r}"
    if isinstance(value, np.ndarray | np.generic | jax.Array | list | tuple):
        value = _as_array(value)
    kind = getattr(value, "dtype", None)
    if isinstance(value, int | float) and not isinstance(value, bool):
        kind = np.dtype(float)
    elif isinstance(value, complex):
        kind = np.dtype(complex)
    if kind is None:
        raise InvalidInputError(f"{name} must return {expected}, got {got}")
    if jnp.issubdtype(kind, jnp.complexfloating):
        raise InvalidInputError(
            f"{name} must return {expected}, got a complex one; try jnp.real(...) of it, or vdot and abs"
        )
    if not jnp.issubdtype(kind, jnp.number):
        raise InvalidInputError(f"{name} must return {expected}, got {kind} values; {truth}")
    shape = getattr(value, "shape", ())
    if len(shape) > axes:
        wanted, hint = ("a number or a vector", "jnp.ravel it") if axes else ("a scalar", "sum it or pick an entry")
        raise InvalidInputError(f"{name} must return {wanted}, got an array of shape {shape}; {hint}")
    return in_precision(name, value, working_precision())


def shapes_in(value: Any) -> Any:
    """Shapes and kinds of the arrays and numbers of a value. Those of arrays are read without a trace, which would take
    far longer: each call of a user's function asks for them."""
    if all(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(value)):
        return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), value)
    return jax.eval_shape(lambda: value)


def in_precision(name: str, value: Any, dtype: Any) -> Array:
    """A number or an array from a user's function in a precision; with a warning if it was computed in a lower one."""
    kind = getattr(value, "dtype", np.dtype(float))
    # What is no tracer is a constant, and has no more digits.
    if is_traced(value) and jnp.issubdtype(kind, jnp.inexact) and jnp.finfo(kind).eps > jnp.finfo(dtype).eps:
        warn_of_coarse_values(name, str(kind), str(dtype))
    # A manifold may have been made, or its arrays described, in double precision.
    return jnp.asarray(value, jax.dtypes.canonicalize_dtype(dtype))


def imprecise(functions: dict[str, Any], *arguments: Any) -> str:
    """Words on the first function that computes in a lower precision than is in use; empty if none does."""
    eps = np.finfo(working_precision()).eps
    for name, function in functions.items():
        kinds = [leaf.dtype for leaf in jax.tree.leaves(jax.eval_shape(function, *arguments))]
        low = [kind for kind in kinds if jnp.issubdtype(kind, jnp.inexact) and jnp.finfo(kind).eps > eps]
        if low:
            return (
                f"{name} returns {low[0]} values where {working_precision()} is in use, and no condition can be met to "
                f"more digits than these have; compute it in {working_precision()}, or give a tolerance above "
                f"{float(jnp.finfo(low[0]).eps):.0e}"
            )
    return ""


def _as_array(value: Any) -> Any:
    """A list of numbers as an array, and None where it is something else."""
    try:
        return jnp.asarray(value)
    except (TypeError, ValueError):
        return None


class FailingLine(NamedTuple):
    """The line of a user at which a function raised an error: words on its place, and its source."""

    place: str
    source: str


def failing_line(error: BaseException, functions: dict[str, Any]) -> FailingLine:
    """The line of a named function, or of what it calls, that raised an error; empty texts if there is none."""
    frames = list(walk_tb(error.__traceback__))
    codes = {code: name for name, function in functions.items() if (code := _code(function)) is not None}
    called = [i for i, (frame, _) in enumerate(frames) if frame.f_code in codes]
    if not called:
        return FailingLine("", "")
    inside = [
        at for at in frames[called[-1] :] if at[0].f_globals.get("__name__", "").partition(".")[0] not in LIBRARIES
    ]
    frame, line = (inside or [frames[called[-1]]])[-1]
    file, name = frame.f_code.co_filename, codes[frames[called[-1]][0].f_code]
    return FailingLine(f"{name}, line {line} of {file}", getline(file, line, frame.f_globals).strip())


@final
class BoundFunction:
    """A function of its first arguments, with a value for the last one."""

    def __init__(self, function: Callable[..., Any], value: Any) -> None:
        self.function, self.value = function, value

    def __call__(self, *arguments: Any) -> Any:
        return self.function(*arguments, self.value)


def with_last(function: Any, count: int, value: Any) -> Any:
    """The function of its first ``count`` arguments, with the value where it takes one more."""
    if function is None or not takes_more(function, count):
        return function
    return BoundFunction(function, value)


def _code(function: Any) -> CodeType | None:
    """The code that runs where this is called, if it is written in Python."""
    while isinstance(function, partial | BoundFunction):
        function = function.func if isinstance(function, partial) else function.function
    if not isinstance(function, FunctionType | MethodType):
        function = getattr(function, "__call__", function)  # noqa: B004  what is called, not whether something can be
    return getattr(unwrap(getattr(function, "__func__", function)), "__code__", None)


def require_concrete(name: str, *arguments: Any, instead: str = "") -> None:
    """Raise if JAX is transforming the caller, the public function ``name``, which computes with values.

    ``instead``: what has derivatives, or takes batches, in its place.
    """
    if is_transformed(arguments):
        hint = f"; try {instead}" if instead else ""
        raise InvalidInputError(
            f"{name} runs outside jit, vmap and grad: it checks its input and computes with values{hint}"
        )
