"""What a solve takes, without what compiling takes: that of kernels is done once for a computer, that of XLA for a
problem."""

import time
from functools import cache
from types import TracebackType
from typing import Any, Self, final

from ...compiling import ignore, listen

_COMPILING: Any = "numba:compile"


@final
class Stopwatch:
    """Seconds since it was made, apart from those in which Numba or XLA has compiled in the body of ``with``."""

    def __init__(self) -> None:
        self._event = _events()
        self._began, self._heard, self._told = time.perf_counter(), self._event.TimingListener(), 0.0

    def __enter__(self) -> Self:
        self._event.register(_COMPILING, self._heard)
        listen(self._add)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        ignore(self._add)
        self._event.unregister(_COMPILING, self._heard)

    def seconds(self) -> tuple[float, float]:
        """Seconds that took to compile, of all threads together, and all others."""
        compiling = self._told + (self._heard.duration if self._heard.done else 0.0)
        return compiling, max(0.0, time.perf_counter() - self._began - compiling)

    def _add(self, seconds: float) -> None:
        self._told += seconds


@cache
def _events() -> Any:
    from numba.core import event  # here: who only imports the library does not wait for Numba

    return event
