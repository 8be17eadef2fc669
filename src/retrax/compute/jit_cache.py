"""Compiled functions of what a user passes: each call reads the functions anew, and equal programs are compiled
once."""

import time
from collections.abc import Callable, Hashable
from functools import cache, wraps
from typing import Any, NamedTuple, ParamSpec, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import is_transformed
from ..manifolds.numerics.compiler import Option, known_options
from ..tracing import differentiable, one_tracing, trace_program
from ..undisturbed import with_room
from .compile_time import report_compile_time
from .program_digest import PLAIN, content_key, program_key

P = ParamSpec("P")
R = TypeVar("R")

MOST_COMPILED = 256  # programs that are kept, so that memory has a bound
CHUNK = 256  # rows that a program takes at once
_compiled: dict[Hashable, Any] = {}  # executables by program and settings, oldest first


class _Program(NamedTuple):
    """A traced function: its program with constants, a digest, and how its outputs become its value."""

    closed: ClosedJaxpr
    key: bytes
    structure: Any
    fixed: Any


def compile_and_call(function: Callable[..., R], *arguments: Any) -> tuple[R, float, float]:
    """Value of ``function(*arguments)``; seconds to trace and compile it, and to run it.

    Arrays in the arguments are data, all other leaves are part of the function. Programs that differ in their constants
    only have one executable. Where JAX is transforming the caller, or ``jit`` is disabled, the function is called as it
    is.
    """
    return _call(compiler_options(), function, *arguments)


def optimize_and_call(function: Callable[..., R], *arguments: Any) -> tuple[R, float, float]:
    """The results of ``call_compiled`` for a function that runs long or often.

    The function takes half as long as by ``call_compiled``, and two to three times as long to compile.
    """
    return _call(compiler_options(optimized=True), function, *arguments)


def _call(options: dict[str, Option], function: Callable[..., R], *arguments: Any) -> tuple[R, float, float]:
    if is_transformed(arguments) or jax.config.jax_disable_jit:  # pyright: ignore[reportAttributeAccessIssue]  # made at run time
        return function(*arguments), 0.0, 0.0
    leaves, structure = jax.tree.flatten(arguments)
    data = [leaf for leaf in leaves if _is_data(leaf)]
    began = time.perf_counter()
    program = _read(function, structure, leaves, data)
    executable = _executable(program.closed, program.key, data, options)
    called = time.perf_counter()
    outputs = executable(program.closed.consts, data)
    jax.block_until_ready(outputs[:1])  # all outputs of one executable become ready together
    value = eqx.combine(jax.tree.unflatten(program.structure, outputs), program.fixed)
    return value, called - began, time.perf_counter() - called


def compile_function(function: Callable[P, R]) -> Callable[P, R]:
    """A function with the values of ``call_compiled``."""

    @wraps(function)
    def call(*arguments: P.args, **options: P.kwargs) -> R:
        return compile_and_call(function, *arguments, **options)[0]

    return call


def call_in_chunks(function: Callable[..., Any], *rows: Any, size: int = CHUNK) -> Any:
    """The values of a compiled function at each row; one program serves any number of rows.

    The function is called with ``size`` rows at once, the last of them repeated.
    """
    count, parts = len(jax.tree.leaves(rows)[-1]), []
    for begin in range(0, count, size):
        which = np.minimum(np.arange(begin, begin + size), count - 1)
        own = vec.taken(rows, which)
        parts.append(function(*own))
    return vec.taken(vec.joined(parts), slice(count))


def _is_data(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray | np.generic)


def _read(function: Callable[..., Any], structure: Any, leaves: list, data: list) -> _Program:
    """The program of a function of ``data``, traced if that was not done in this reading."""
    # What is held in the reading keeps its identity.
    fixed = tuple("data" if _is_data(leaf) else repr(leaf) if isinstance(leaf, PLAIN) else id(leaf) for leaf in leaves)
    key = id(function), fixed, tuple(jax.typeof(leaf) for leaf in data), structure
    with one_tracing() as reading:
        try:
            known = reading.known.get(key)
        except TypeError:  # a static field that cannot be hashed
            return _trace(function, structure, leaves, data)
        if known is None:
            known = reading.known[key] = _trace(function, structure, leaves, data), function, leaves
        return known[0]


def _trace(function: Callable[..., Any], structure: Any, leaves: list, data: list) -> _Program:
    """The program of a function of ``data``."""
    found = []

    def flat(data: list) -> list:
        remaining = iter(data)
        merged = [next(remaining) if _is_data(leaf) else leaf for leaf in leaves]
        value = function(*jax.tree.unflatten(structure, merged))
        arrays, fixed = eqx.partition(value, eqx.is_array)
        outputs, shape = jax.tree.flatten(arrays)
        found.append((shape, fixed))
        return outputs

    closed = trace_program(flat, data)
    return _Program(closed, program_key(closed), *found[-1])


def _executable(
    closed: ClosedJaxpr, digest: bytes, data: list, options: dict[str, Option], rows: int | None = None
) -> Any:
    """The compiled program, as a function of its constants and ``data``; of so many ``rows`` of these at once, if there
    are any."""
    device = jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]  # made at run time
    settings = jax.default_backend(), device, tuple(options.items())
    key = digest, rows, settings
    if key not in _compiled:

        def run(constants: list, data: list) -> list:
            function = jaxpr_as_fun(ClosedJaxpr(closed.jaxpr, constants))
            return function(*data) if rows is None else jax.vmap(function)(*data)

        if len(_compiled) >= MOST_COMPILED:
            del _compiled[next(iter(_compiled))]
        with report_compile_time(), differentiable():
            lowered = with_room(jax.jit(run).lower, closed.consts, data)
            _compiled[key] = lowered.compile(options)
    return _compiled[key]


def of_rows(closed: ClosedJaxpr) -> Callable[..., list[Any]]:
    """The function of rows of arguments, compiled for each number of them; programs that differ in their constants only
    have one executable."""
    digest, known = program_key(closed), dict[int, Any]()

    def call(*data: np.ndarray) -> list[Any]:
        rows = len(data[0])
        if rows not in known:
            known[rows] = _executable(closed, digest, list(data), compiler_options(optimized=True), rows)
        return known[rows](closed.consts, list(data))

    return call


def digest(function: Callable[..., Any], *shapes: Any) -> bytes | None:
    """A digest that functions share that compute the same of arrays of these shapes, with the values that they read
    now.

    None where that cannot be told, as with a callback to Python.
    """
    return content_key(trace_program(function, *shapes))


@cache
def compiler_options(optimized: bool = False) -> dict[str, Option]:
    """Per-function options that shorten XLA's time to compile on a CPU.

    The fusion emitters of jaxlib 0.10 spend most of a compilation on the many small loops of per-stage derivatives; of
    LLVM's levels the first makes loops twice as fast, and higher ones find nothing more to do in them.
    ``jax_disable_most_optimizations`` asks for none.
    """
    options: dict[str, Option] = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": "0"}
    if not optimized:
        options["xla_llvm_disable_expensive_passes"] = True
    elif not jax.config.read("jax_disable_most_optimizations"):
        options["xla_backend_optimization_level"] = "1"
    return known_options(options)
