"""Compiled functions of what a user passes: arrays are data, everything else is fixed when the function is compiled."""

import time
from collections.abc import Callable
from functools import cache
from typing import Any

import equinox as eqx
import jax
import numpy as np

from ..manifolds.manifold import working_precision
from .functions import by_data

_compiled: dict[Any, Any] = {}  # executables by function and structure of the arguments, oldest first
MOST_COMPILED = 256


def _is_data(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray | np.generic)


def call_compiled(function: Callable, *arguments: Any) -> tuple[Any, float, float]:
    """Value of ``function(*arguments)``; seconds to trace and compile it, 0 if that was done before, and to run it.

    Arrays in the arguments are data, all other leaves are part of the function and hashable; functions compare by their data.
    """
    leaves, structure = jax.tree.flatten(by_data(arguments))
    data = [leaf for leaf in leaves if _is_data(leaf)]
    fixed = tuple(_is_data if _is_data(leaf) else leaf for leaf in leaves)
    key = (function, fixed, structure, tuple((a.shape, a.dtype) for a in data), working_precision())
    began = time.perf_counter()
    seconds = 0.0
    if key not in _compiled:
        compiled = jax.jit(lambda data: function(*_merged(structure, fixed, data))).lower(data).compile(compiler_options())
        if len(_compiled) >= MOST_COMPILED:
            del _compiled[next(iter(_compiled))]
        _compiled[key] = compiled
        seconds = time.perf_counter() - began
    began = time.perf_counter()
    value = _compiled[key](data)
    jax.block_until_ready(jax.tree.leaves(value)[:1])  # all outputs of one executable become ready together
    return value, seconds, time.perf_counter() - began


def compiled(function: Callable, *, quickly: bool = False) -> Callable:
    """``equinox.filter_jit(function)``, with the functions among its arguments compared by their data.

    ``quickly``: with the options of ``compiler_options``, for kernels that take longer to compile than to run.
    """
    options: dict[str, Any] = {"compiler_options": compiler_options()} if quickly else {}
    jitted = eqx.filter_jit(function, **options)

    def call(*arguments: Any) -> Any:
        return jitted(*by_data(arguments))

    call.__doc__ = function.__doc__
    return call


def _merged(structure: Any, fixed: tuple, data: list) -> Any:
    """The arguments: ``fixed`` with ``data`` in the places that are marked."""
    remaining = iter(data)
    return jax.tree.unflatten(structure, [next(remaining) if leaf is _is_data else leaf for leaf in fixed])


@cache
def compiler_options() -> dict[str, str | bool]:
    """Per-function options that halve XLA's time to compile on a CPU and leave the running time unchanged.

    The fusion emitters of jaxlib 0.10 spend most of a compilation on the many small loops of per-stage derivatives, and
    LLVM's higher levels find nothing more to do in them. A jaxlib without the options compiles with its defaults. Nothing
    global is set, and ``jax_disable_most_optimizations`` asks for less still.
    """
    options: dict[str, str | bool] = {"xla_cpu_use_fusion_emitters": False}
    if not jax.config.read("jax_disable_most_optimizations"):
        options["xla_backend_optimization_level"] = "1"
    if jax.default_backend() != "cpu":
        return {}
    try:
        jax.jit(lambda x: x).lower(0.0).compile(options)
    except jax.errors.JaxRuntimeError:
        return {}
    return options
