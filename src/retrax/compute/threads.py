"""Threads that share the loops of the compiled core, which run without Python's lock."""

import itertools
import os
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import cache
from typing import TypeVar

WORTH_A_THREAD = 300_000  # operations that one thread does before a second is worth its start

R = TypeVar("R")
_alone: ContextVar[bool] = ContextVar("retrax_one_thread", default=False)


@contextmanager
def one_thread() -> Iterator[None]:
    """A time in which loops run in the thread that calls them: the other processors are busy with as much."""
    token = _alone.set(True)
    try:
        yield
    finally:
        _alone.reset(token)


def in_threads(run: Callable[[range], None], count: int, work: float, unit: int = 1) -> None:
    """Run a loop on ranges of ``count`` items, each of them ``work`` operations, in threads where that is faster.

    All ranges but the last are multiples of ``unit`` long.
    """
    if not worth_threads(count, work):  # the system is asked only where it matters: that takes as long as a loop
        run(range(count))
        return
    units = -(-count // unit)
    parts = 1 if _alone.get() else int(min(units, count * work // WORTH_A_THREAD, os.cpu_count() or 1))
    if parts <= 1:
        run(range(count))
        return
    *others, own = _ranges(count, parts, unit)
    futures = [_pool("loops").submit(run, part) for part in others]
    run(own)
    for future in futures:
        future.result()


def worth_threads(count: int, work: float) -> bool:
    """Whether ``count`` items, each of them ``work`` operations, are enough for a second thread."""
    return count * work >= 2 * WORTH_A_THREAD


def _ranges(count: int, parts: int, unit: int = 1) -> list[range]:
    """Parts of ``count`` items, as many in each as in another, in multiples of ``unit`` but for the last."""
    units = -(-count // unit)
    ends = [min(count, unit * (units * k // parts)) for k in range(parts + 1)]
    return [range(a, b) for a, b in itertools.pairwise(ends)]


def on_its_own(run: Callable[[range], R], part: range) -> "Future[R]":
    """The future result of a part, computed in a thread of its own with loops of one thread."""

    def alone() -> R:
        with one_thread():
            return run(part)

    return _pool("parts").submit(copy_context().run, alone)


def each_in_threads(run: Callable[[int], R], count: int, stop: Callable[[], None]) -> list[R]:
    """The results of a function for the numbers below ``count``, in threads that take one number after the other.

    ``stop`` is called where somebody interrupts, or a call raises an error, which is raised when all have ended.
    """
    threads = 1 if _alone.get() else min(os.cpu_count() or 1, count)
    if threads == 1:
        return [run(k) for k in range(count)]
    numbers, found = iter(range(count)), dict[int, R]()

    def work(_: range) -> None:
        for k in numbers:
            found[k] = run(k)

    going = list["Future[None]"]()
    try:
        going += [on_its_own(work, range(1)) for _ in range(threads)]
        wait(going, return_when=FIRST_EXCEPTION)
    except KeyboardInterrupt:
        stop()  # each call ends with what it has
    if any(future.done() and future.exception() for future in going):
        stop()
    for future in going:
        future.exception()  # until it has ended
    for future in going:
        future.result()
    return [found[k] for k in range(count)]


@cache
def _pool(kind: str) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(os.cpu_count() or 1, thread_name_prefix=f"retrax {kind}")


if hasattr(os, "register_at_fork"):
    # The child of a fork has none of the threads that its pools believe to have.
    os.register_at_fork(after_in_child=_pool.cache_clear)
