"""What a solve takes, without what compiling its kernels takes: that is done once for a computer."""

import time
from types import TracebackType
from typing import Any, Self, final

_COMPILING: Any = "numba:compile"


@final
class Stopwatch:
    """Seconds since it was made, apart from those in which Numba has compiled in the body of ``with``."""

    def __init__(self) -> None:
        from numba.core import event  # here: who only imports the library does not wait for Numba

        self._event, self._began, self._heard = event, time.perf_counter(), event.TimingListener()

    def __enter__(self) -> Self:
        self._event.register(_COMPILING, self._heard)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._event.unregister(_COMPILING, self._heard)

    def seconds(self) -> tuple[float, float]:
        """Seconds that kernels took to compile, of all threads together, and all others."""
        compiling = self._heard.duration if self._heard.done else 0.0
        return compiling, max(0.0, time.perf_counter() - self._began - compiling)
