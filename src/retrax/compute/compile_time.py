"""Seconds that compiling takes, apart from running: of kernels once for a computer, of XLA for a problem.

Nothing in JAX says how long XLA takes in a way that can be taken back, so listeners are told here.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from types import TracebackType
from typing import Any, Self, final

from ..optional import numba_is_there

_listeners: list[Callable[[float], None]] = []


@contextmanager
def report_compile_time() -> Iterator[None]:
    """Tell all that listen how many seconds the body takes."""
    began = time.perf_counter()
    try:
        yield
    finally:
        seconds = time.perf_counter() - began
        for listener in list(_listeners):
            listener(seconds)


def listen(listener: Callable[[float], None]) -> None:
    """Have a function called with the seconds of each compilation, of any thread."""
    _listeners.append(listener)


def stop_listening(listener: Callable[[float], None]) -> None:
    """Stop calling a listener."""
    _listeners.remove(listener)


_COMPILING: Any = "numba:compile"


@final
class Stopwatch:
    """Seconds since a start, apart from the seconds in which Numba or XLA has compiled in the body of ``with``."""

    def __init__(self) -> None:
        self._began, self._told = time.perf_counter(), 0.0
        self._event = _events()
        self._heard = self._event and self._event.TimingListener()

    def __enter__(self) -> Self:
        if self._event:
            self._event.register(_COMPILING, self._heard)
        listen(self._add)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        stop_listening(self._add)
        if self._event:
            self._event.unregister(_COMPILING, self._heard)

    def seconds(self) -> tuple[float, float]:
        """Seconds that took to compile, of all threads together, and the remaining seconds."""
        compiling = self._told + (self._heard.duration if self._heard and self._heard.done else 0.0)
        return compiling, max(0.0, time.perf_counter() - self._began - compiling)

    def _add(self, seconds: float) -> None:
        self._told += seconds


@cache
def _events() -> Any:
    """The events of Numba; None where it is not."""
    if not numba_is_there():
        return None
    from numba.core import event  # here: who only imports the library does not wait for Numba

    return event
