"""Functions that users write: the number that they return, and whether they are called while JAX is transforming the caller."""

from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import get_opaque_trace_state
from jaxtyping import Array

from ..manifolds import InvalidInputError
from ..manifolds.manifold import working_precision
from ..manifolds.numerics.ambient import is_traced
from .results import warn_of_coarse_values


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


def is_transformed(*arguments: Any) -> bool:
    """Whether JAX is transforming the caller or values in the arguments, on which nothing can be checked."""
    return get_opaque_trace_state() != _untransformed() or is_traced(arguments)


@cache
def _untransformed() -> Any:
    """The state of JAX outside of ``jit``, ``vmap`` and ``grad``: that of a new thread."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(get_opaque_trace_state).result()


def require_concrete(name: str, *arguments: Any) -> None:
    """Raise if JAX is transforming the caller, the public function ``name``, which computes with values."""
    if is_transformed(arguments):
        raise InvalidInputError(f"{name} runs outside jit, vmap and grad: it checks its input and compiles its own kernels")
