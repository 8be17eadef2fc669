"""Seconds that tracing and XLA's compiling take, apart from running.

JAX reports how long XLA takes only to listeners that cannot be removed, so listeners register here.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Self, final

_listeners: list[Callable[[float], None]] = []  # called with the seconds of each compilation, of any thread


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


@final
class Stopwatch:
    """Seconds since a start, apart from the seconds of tracing and compiling in the body of ``with``."""

    def __init__(self) -> None:
        self._began, self._compiling = time.perf_counter(), 0.0

    def __enter__(self) -> Self:
        _listeners.append(self._add)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        _listeners.remove(self._add)

    def seconds(self) -> tuple[float, float]:
        """Seconds that took to compile, of all threads together, and the remaining seconds."""
        return self._compiling, max(0.0, time.perf_counter() - self._began - self._compiling)

    def _add(self, seconds: float) -> None:
        self._compiling += seconds
