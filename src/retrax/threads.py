"""Threads that share the loops of compiled kernels, which run without Python's lock."""

import itertools
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache

WORTH_A_THREAD = 300_000  # operations that one thread does before a second is worth its start
_alone: ContextVar[bool] = ContextVar("retrax_one_thread", default=False)


@contextmanager
def one_thread() -> Iterator[None]:
    """A time in which kernels run in the thread that calls them: the other processors are busy with as much."""
    token = _alone.set(True)
    try:
        yield
    finally:
        _alone.reset(token)


def in_threads(run: Callable[[range], None], count: int, work: float, unit: int = 1) -> None:
    """Run a kernel on ranges of ``count`` items, each of them ``work`` operations, in threads where that is faster.

    All ranges but the last are multiples of ``unit`` long.
    """
    units = -(-count // unit)
    parts = max(1, int(min(units, count * work // WORTH_A_THREAD)))
    if parts > 1:  # the system is asked only where it matters: that takes as long as a small kernel
        parts = 1 if _alone.get() else min(parts, os.cpu_count() or 1)
    ends = [min(count, unit * (units * k // parts)) for k in range(parts + 1)]
    *others, own = (range(a, b) for a, b in itertools.pairwise(ends))
    futures = [_pool().submit(run, part) for part in others]
    run(own)
    for future in futures:
        future.result()


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(thread_name_prefix="retrax")
