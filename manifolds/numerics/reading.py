"""Functions of a user are read anew: what JAX traced of them before, with the values they had then, is not found again.

JAX takes what a function reads, a parameter in a closure, an attribute or a global, for constant, and finds its traces again by
the function's identity, also those of ``jit`` and of the bodies of loops inside a function. A changed value would be ignored.
"""

import itertools
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import wraps
from typing import Any, NamedTuple, ParamSpec, TypeVar

import jax

P = ParamSpec("P")
R = TypeVar("R")

_context = jax.make_user_context(None)  # a part of the keys of JAX's caches, of value None wherever a user traces
_numbers = itertools.count(1)


class Reading(NamedTuple):
    """A time in which the functions of a user do not change; ``known`` is for what was found out during it."""

    number: int
    known: dict[Hashable, Any]

    def traced(self, function: Callable, *examples: Any) -> Any:
        """``jax.make_jaxpr`` of a function: arrays, or their shapes, as arguments."""
        with _context(self.number):
            return jax.make_jaxpr(lambda *arguments: function(*arguments))(*examples)


_current: ContextVar[Reading | None] = ContextVar("retrax_reading", default=None)


@contextmanager
def one_reading() -> Iterator[Reading]:
    """The reading that goes on, or a new one."""
    current = _current.get()
    if current is not None:
        yield current
        return
    current = Reading(next(_numbers), {})
    token = _current.set(current)
    try:
        yield current
    finally:
        _current.reset(token)


def is_reading() -> bool:
    """Whether a reading goes on."""
    return _current.get() is not None


def reads_once(function: Callable[P, R]) -> Callable[P, R]:
    """A public function during whose call a user's functions do not change: each is read once in it, and again in the next."""

    @wraps(function)
    def call(*arguments: P.args, **options: P.kwargs) -> R:
        with one_reading():
            return function(*arguments, **options)

    return call


def traced(function: Callable, *examples: Any) -> Any:
    """The program of a function as it is now, a closed jaxpr; ``examples``: arrays, or their shapes."""
    with one_reading() as reading:
        return reading.traced(function, *examples)
