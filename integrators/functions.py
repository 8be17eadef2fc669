"""Functions that users write: the number that they return; compared by what they compute, their code and its data.

Compiled code is found again by the functions it was made from. JAX compares these by identity and takes what they read, a
parameter in a closure or a global, for constant: a changed parameter would be ignored, a lambda written anew compiled again.
"""

from collections.abc import Callable
from functools import partial
from inspect import unwrap
from traceback import walk_tb
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array

from ..manifolds import InvalidInputError
from ..manifolds.manifold import working_precision
from ..manifolds.numerics.ambient import is_jitting, is_traced
from .results import warn_of_coarse_values

LIBRARIES = frozenset({"builtins", "equinox", "functools", "jax", "jaxlib", "math", "numpy", "operator", "retrax", "scipy"})
PLAIN = bool | int | float | complex | str | bytes | None
DEEPEST, LONGEST = 30, 10_000  # how deep, and how many objects, are read: what is beyond compares by identity


@final
class ByData:
    """A function that equals another one with the same code and equal data at the time when both were wrapped.

    ``reads_traced``: whether some of its data is a value that JAX is tracing.
    """

    def __init__(self, function: Callable) -> None:
        reader = _Reader()
        self.function = function
        self._key = reader.key(function)
        self._hash = hash(self._key)
        self.reads_traced = reader.traced

    def __call__(self, *arguments: Any) -> Any:
        return self.function(*arguments)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ByData) and self._key == other._key

    def __hash__(self) -> int:
        return self._hash

    def __repr__(self) -> str:
        return repr(self.function)


def real_number(name: str, value: Any) -> Array:
    """What a user's function returned, as one real number in the precision in use; raises if it is something else."""
    got = "nothing; did it forget to return?" if value is None else f"{value!r}"
    if isinstance(value, np.ndarray | np.generic | jax.Array | list | tuple):
        value = _stacked(value)
    kind = getattr(value, "dtype", None)
    if isinstance(value, int | float) and not isinstance(value, bool):
        kind = np.dtype(float)
    elif isinstance(value, complex):
        kind = np.dtype(complex)
    if kind is None:
        raise InvalidInputError(f"{name} must return a real number, got {got}")
    if jnp.issubdtype(kind, jnp.complexfloating):
        raise InvalidInputError(f"{name} must return a real number, got a complex one; try jnp.real(...) of it, or vdot and abs")
    if not jnp.issubdtype(kind, jnp.number):
        raise InvalidInputError(f"{name} must return a real number, got {kind} values; try jnp.where(condition, 1.0, 0.0)")
    shape = getattr(value, "shape", ())
    if shape != ():
        raise InvalidInputError(f"{name} must return a scalar, got an array of shape {shape}; sum it or pick an entry")
    return in_precision(name, value, working_precision())


def in_precision(name: str, value: Any, dtype: Any) -> Array:
    """A number or an array from a user's function in a precision; with a warning if it was computed in a lower one."""
    kind = getattr(value, "dtype", np.dtype(float))
    # What is no tracer is a constant, and has no more digits.
    if is_traced(value) and jnp.issubdtype(kind, jnp.inexact) and jnp.finfo(kind).eps > jnp.finfo(dtype).eps:
        warn_of_coarse_values(name, str(kind), str(dtype))
    return jnp.asarray(value, dtype)


def _stacked(value: Any) -> Any:
    """A list of numbers as an array, and None where it is something else."""
    try:
        return jnp.asarray(value)
    except (TypeError, ValueError):
        return None


def failing_line(error: BaseException, functions: dict[str, Any]) -> str:
    """Where a user's function, one of those that are named, raised an error: its name, a line and a file; else empty."""
    frames = list(walk_tb(error.__traceback__))
    codes = {code: name for name, function in functions.items() if (code := _code(function)) is not None}
    called = [i for i, (frame, _) in enumerate(frames) if frame.f_code in codes]
    if not called:
        return ""
    inside = [at for at in frames[called[-1] :] if at[0].f_globals.get("__name__", "").partition(".")[0] not in LIBRARIES]
    frame, line = (inside or [frames[called[-1]]])[-1]
    return f"{codes[frames[called[-1]][0].f_code]}, line {line} of {frame.f_code.co_filename}"


def _code(function: Any) -> CodeType | None:
    """The code that runs where this is called, if it is written in Python."""
    while isinstance(function, ByData | partial):
        function = function.function if isinstance(function, ByData) else function.func
    if not isinstance(function, FunctionType | MethodType):
        function = getattr(function, "__call__", function)  # noqa: B004  what is called, not whether something can be
    return getattr(unwrap(getattr(function, "__func__", function)), "__code__", None)


def by_data(tree: Any) -> Any:
    """A pytree with each plain function or method in it compared by its data."""
    return jax.tree.map(lambda leaf: ByData(leaf) if isinstance(leaf, FunctionType | MethodType) else leaf, tree)


def reads_traced(tree: Any) -> bool:
    """Whether a function in a pytree reads a value that JAX is tracing."""
    leaves = [leaf for leaf in jax.tree.leaves(tree) if callable(leaf)]
    return any((leaf if isinstance(leaf, ByData) else ByData(leaf)).reads_traced for leaf in leaves)


def is_transformed(*arguments: Any) -> bool:
    """Whether JAX is transforming the caller or values in the arguments, on which nothing can be checked."""
    return is_jitting() or is_traced(arguments) or reads_traced(arguments)


def require_concrete(name: str, *arguments: Any) -> None:
    """Raise if JAX is transforming the caller, the public function ``name``, which computes with values."""
    if is_transformed(arguments):
        raise InvalidInputError(f"{name} runs outside jit, vmap and grad: it checks its input and compiles its own kernels")


def same_by_data(a: Any, b: Any) -> bool:
    """Whether two pytrees are equal, with the functions in them compared by their data."""
    return bool(eqx.tree_equal(by_data(a), by_data(b)))


class _Identical:
    """An object that equals itself alone; holding it keeps its address from being used again."""

    def __init__(self, value: object) -> None:
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Identical) and self.value is other.value

    def __hash__(self) -> int:
        return id(self.value)


class _Reader:
    """Keys of values; those of plain data, containers and functions are equal where their contents are."""

    def __init__(self) -> None:
        self.traced = False
        self.depth = 0
        self.seen: dict[int, tuple[int, object]] = {}  # what was met, by address: functions may refer to themselves

    def key(self, value: Any) -> Any:
        if isinstance(value, PLAIN):
            return type(value), repr(value)
        if isinstance(value, Tracer):
            self.traced = True
            return _Identical(object())  # it belongs to one trace: nothing compiled with it can serve again
        if isinstance(value, np.ndarray | np.generic | jax.Array):
            if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
                value = jax.random.key_data(value)
            array = np.asarray(value)
            return array.shape, array.dtype.str, array.tobytes()
        if isinstance(value, type | ModuleType):
            return _Identical(value)
        if id(value) in self.seen:
            return "again", self.seen[id(value)][0]
        if self.depth > DEEPEST or len(self.seen) > LONGEST:
            return _Identical(value)
        self.seen[id(value)] = len(self.seen), value
        self.depth += 1
        key = self._contents(value)
        self.depth -= 1
        return key

    def _contents(self, value: Any) -> Any:
        if isinstance(value, tuple | list):
            return type(value), tuple(self.key(item) for item in value)
        if isinstance(value, dict):
            return dict, tuple((self.key(name), self.key(item)) for name, item in value.items())
        if isinstance(value, MethodType):
            return self.key(value.__func__), self.key(value.__self__)
        if isinstance(value, FunctionType) and (value.__module__ or "").partition(".")[0] not in LIBRARIES:
            return self._function(value)
        if isinstance(value, eqx.Module):
            return type(value), self.key(vars(value))
        return _Identical(value), self.key(getattr(value, "__dict__", None))

    def _function(self, function: FunctionType) -> Any:
        code = function.__code__
        cells = [cell.cell_contents for cell in function.__closure__ or () if _is_filled(cell)]
        names = [name for name in dict.fromkeys(_names(code)) if name in function.__globals__]
        read = [function.__defaults__, function.__kwdefaults__, cells, [function.__globals__[name] for name in names]]
        return code, self.key(read)


def _is_filled(cell: Any) -> bool:
    try:
        _ = cell.cell_contents
    except ValueError:  # a name of an enclosing function that has no value yet
        return False
    return True


def _names(code: CodeType) -> list[str]:
    """Names that a function may read from its module, those of functions inside it included."""
    inner = [name for constant in code.co_consts if isinstance(constant, CodeType) for name in _names(constant)]
    return [*code.co_names, *inner]
