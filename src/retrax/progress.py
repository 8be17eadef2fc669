"""Progress of long work: a bar in a terminal or a notebook where tqdm is installed, else lines of the logger
``retrax``."""

import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

LOG_SECONDS = 10.0  # between two lines

Advance = Callable[..., None]


@contextmanager
def progress(what: str, total: int, unit: str, verbose: bool, done: int = 0) -> Iterator[Advance]:
    """A function that reports progress, called with the number of new items and a remark; silent unless ``verbose``.

    Lines are of level INFO, of the logger ``retrax``: ``what``, how many of the ``total`` are done, and how fast.
    """
    if not verbose:
        yield lambda count, remark="": None
        return
    shown = _bar(what, total, unit, done) or _Lines(what, total, unit, done)
    try:
        yield shown.advance
    finally:
        shown.close()


def _bar(what: str, total: int, unit: str, done: int) -> "_Bar | None":
    """A bar; None without a terminal and a notebook, or without tqdm."""
    if not (sys.stderr.isatty() or "ipykernel" in sys.modules):
        return None
    try:
        from tqdm.auto import tqdm
    except ModuleNotFoundError:
        return None
    return _Bar(tqdm(total=total, desc=what, unit=f" {unit}", initial=done))


class _Bar:
    def __init__(self, bar: Any) -> None:
        self._bar = bar

    def advance(self, count: int, remark: str = "") -> None:
        if remark:
            self._bar.set_postfix_str(remark, refresh=False)
        self._bar.update(count)

    def close(self) -> None:
        self._bar.close()


class _Lines:
    def __init__(self, what: str, total: int, unit: str, done: int) -> None:
        self._what, self._total, self._unit = what, total, unit
        self._done = self._first = done
        self._remark, self._began, self._logged = "", time.monotonic(), time.monotonic()

    def advance(self, count: int, remark: str = "") -> None:
        self._done += count
        self._remark = remark or self._remark
        if time.monotonic() - self._logged >= LOG_SECONDS:
            self.close()

    def close(self) -> None:
        now = time.monotonic()
        rate = (self._done - self._first) / max(now - self._began, 1e-9)
        words = f"{self._what}: {self._done} of {self._total} {self._unit}, {rate:.3g} per second"
        logging.getLogger("retrax").info("%s%s", words, f", {self._remark}" if self._remark else "")
        self._logged = now
