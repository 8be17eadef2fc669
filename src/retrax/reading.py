"""Functions of a user are read anew: what JAX traced of them before, with the values they had then, is not found again.

JAX takes what a function reads, a parameter in a closure, an attribute or a global, for constant, and finds its traces
again by the function's identity, also those of ``jit`` and of the bodies of loops inside a function. A changed value
would be ignored.
"""

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import wraps
from typing import Any, ParamSpec, TypeVar, final

import jax
from jax._src.interpreters import partial_eval
from jax.extend.core import ClosedJaxpr

from .undisturbed import with_room

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")

_context = jax.make_user_context(None)  # a part of the keys of JAX's caches, of value None wherever a user traces


@final
class Reading:
    """A time in which the functions of a user do not change; ``known`` is for what was found out during it."""

    def __init__(self) -> None:
        self.known: dict[Hashable, Any] = {}
        self._mark, self._traces = object(), False  # JAX keeps the mark

    def traced(self, function: Callable[..., Any], *examples: Any) -> ClosedJaxpr:
        """``jax.make_jaxpr`` of a function: arrays, or their shapes, as arguments."""
        self._traces = True
        with _context(self._mark):
            return jax.make_jaxpr(lambda *arguments: function(*arguments))(*examples)

    def once(self, key: Hashable, find: Callable[[], T]) -> T:
        """What is found out by ``find``, the first time in this reading."""
        if key not in self.known:
            self.known[key] = find()
        return self.known[key]

    def end(self) -> None:
        """Release the traces: JAX keeps those of functions that live on, as its own under ``jit``, without bound.

        There is no public way to. Versions of JAX in which that cache is another one bound it.
        """
        cache: Any = getattr(partial_eval, "trace_to_jaxpr", None)
        if self._traces and hasattr(cache, "evict_weakref"):
            functions = {key[0] for key in cache.cache_keys() if any(part is self._mark for part in key[1])}
            for function in (reference() for reference in functions):
                if function is not None:
                    cache.evict_weakref(function)


_current: ContextVar[Reading | None] = ContextVar("retrax_reading", default=None)


@contextmanager
def resumed(reading: Reading) -> Iterator[Reading]:
    """A reading that somebody holds, and that goes on."""
    token = _current.set(reading)
    try:
        yield reading
    finally:
        _current.reset(token)


@contextmanager
def one_reading() -> Iterator[Reading]:
    """The reading that goes on, or a new one."""
    current = _current.get()
    if current is not None:
        yield current
        return
    current = Reading()
    try:
        with resumed(current):
            yield current
    finally:
        current.end()


def is_reading() -> bool:
    """Whether a reading goes on."""
    return _current.get() is not None


def reads_once(function: Callable[P, R]) -> Callable[P, R]:
    """A public function during whose call a user's functions do not change: each is read once in it, and again in the
    next."""

    @wraps(function)
    def call(*arguments: P.args, **options: P.kwargs) -> R:
        with one_reading():
            return function(*arguments, **options)

    return call


def traced(function: Callable[..., Any], *examples: Any) -> ClosedJaxpr:
    """The program of a function as it is now, a closed jaxpr; ``examples``: arrays, or their shapes."""
    with one_reading() as reading:
        return with_room(reading.traced, function, *examples)
