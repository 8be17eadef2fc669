"""Functions of a user are read anew: what JAX traced of them before, with the values they had then, is not found again.

JAX takes what a function reads, a parameter in a closure, an attribute or a global, for constant, and finds its traces
again by the function's identity, also those of ``jit`` and of the bodies of loops inside a function. A changed value
would be ignored.
"""

from collections.abc import Callable, Hashable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from functools import partial
from traceback import walk_tb
from types import FrameType
from typing import Any, ParamSpec, Self, TypeVar, final

import jax
from jax._src.interpreters import partial_eval
from jax.extend.core import ClosedJaxpr

from .errors import NotDifferentiableError, RetraxError, concise
from .undisturbed import with_room

# Parts of what JAX says of functions without derivatives, and what may be tried.
WITHOUT = {
    "to a custom_vjp function": "jax.custom_jvp, whose rule serves both ways",
    "does not work for lax.while_loop": (
        "jax.lax.fori_loop with a number of rounds that no value decides, jax.lax.scan, or find_root for an equation"
    ),
    "allbacks do not support JVP": "the same in jax.numpy, or jax.custom_jvp with a rule around the callback",
    "supported for the pure_callback": (
        "the same in jax.numpy, or vmap_method='sequential' and a jax.custom_jvp with a rule around it"
    ),
}

LIBRARIES = frozenset({"contextlib", "equinox", "functools", "jax", "jaxlib", "jaxtyping", "numpy", "retrax"})

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")

_context = jax.make_user_context(None)  # a part of the keys of JAX's caches, of value None wherever a user traces


@final
class Tracing:
    """A time in which the functions of a user do not change.

    ``known`` holds results that were found during this time, ``traces`` counts the traced programs.
    """

    def __init__(self) -> None:
        self.known: dict[Hashable, Any] = {}
        self._mark, self.traces = object(), 0  # JAX keeps the mark

    def __enter__(self) -> Self:
        self._token = _current.set(self)
        return self

    def __exit__(self, *_: object) -> None:
        _current.reset(self._token)
        self.end()

    def trace(self, function: Callable[..., Any], *examples: Any) -> ClosedJaxpr:
        """``jax.make_jaxpr`` of a function: arrays, or their shapes, as arguments."""
        self.traces += 1
        with _context(self._mark):
            return jax.make_jaxpr(lambda *arguments: function(*arguments))(*examples)

    def once(self, key: Hashable, find: Callable[[], T]) -> T:
        """The result of ``find``, which runs at the first call in this reading."""
        if key not in self.known:
            self.known[key] = find()
        return self.known[key]

    def end(self) -> None:
        """Release the traces, which JAX would keep without bound for functions that live on, as for its own under
        ``jit``.

        There is no public way to. Versions of JAX in which that cache is another one bound it.
        """
        cache: Any = getattr(partial_eval, "trace_to_jaxpr", None)
        if self.traces and hasattr(cache, "evict_weakref"):
            functions = {key[0] for key in cache.cache_keys() if any(part is self._mark for part in key[1])}
            for function in (reference() for reference in functions):
                if function is not None:
                    cache.evict_weakref(function)


_current: ContextVar[Tracing | None] = ContextVar("retrax_reading", default=None)


@contextmanager
def resume_tracing(reading: Tracing) -> Iterator[Tracing]:
    """A reading that somebody holds, and that goes on."""
    token = _current.set(reading)
    try:
        yield reading
    finally:
        _current.reset(token)


def one_tracing() -> AbstractContextManager[Tracing]:
    """The reading that goes on, or a new one."""
    current = _current.get()
    return Tracing() if current is None else nullcontext(current)


def is_tracing() -> bool:
    """Whether a reading goes on."""
    return _current.get() is not None


def in_one_tracing(method: Callable[..., Any], own: Any) -> Callable[..., Any]:
    """The method of an object as a function that JAX traces once in the reading that goes on, if one does.

    Its derivatives are traced once too, in each mode.
    """
    reading = _current.get()
    if reading is None:
        return partial(method, own)
    return reading.once((method, id(own)), lambda: (jax.jit(partial(method, own)), own))[0]


def reads_once(function: Callable[P, R]) -> Callable[P, R]:
    """A public function during whose call a user's functions do not change: each is read once in it, and again in the
    next."""
    return concise(function, within=one_tracing)


def trace_program(function: Callable[..., Any], *examples: Any) -> ClosedJaxpr:
    """The program of a function as it is now, a closed jaxpr, traced with arrays or their shapes as ``examples``.

    Raises ``NotDifferentiableError`` where it has derivatives of a function of which JAX knows none.
    """
    with one_tracing() as reading, differentiable():
        return with_room(reading.trace, function, *examples)


@contextmanager
def differentiable() -> Iterator[None]:
    """A time in which JAX traces or compiles: what it says of functions without derivatives is a
    ``NotDifferentiableError``."""
    try:
        yield
    except RetraxError:
        raise
    except (TypeError, ValueError, NotImplementedError) as error:
        words = _undifferentiable(error)
        if words:
            raise NotDifferentiableError(words) from error
        raise


def _undifferentiable(error: Exception) -> str:
    """Words on an error of JAX about a function without derivatives; empty for other errors."""
    said = " ".join(str(error).split())
    hint = next((hint for part, hint in WITHOUT.items() if part in said), "")
    if not hint:
        return ""
    line = users_line(error)
    where = line and f", called in {line},"
    return (
        f"JAX cannot differentiate, or map, a function{where} and says: {said.rstrip('.')}; expected one with "
        f"derivatives, forward and backward, because costates and Newton's method need them; try {hint}"
    )


def users_line(error: Exception) -> str:
    """The line of a user that led to an error, and its file; empty if there is none."""
    frames = [(frame.f_code.co_filename, line) for frame, line in walk_tb(error.__traceback__) if _is_users(frame)]
    return f"line {frames[-1][1]} of {frames[-1][0]}" if frames else ""


def _is_users(frame: FrameType) -> bool:
    return frame.f_globals.get("__name__", "").partition(".")[0] not in LIBRARIES
