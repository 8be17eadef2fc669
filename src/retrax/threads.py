"""Threads that share the loops of compiled kernels, which run without Python's lock."""

import itertools
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache

THREADS = 8  # of XLA, so many that its decompositions do not wait for one another
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
    if count * work < 2 * WORTH_A_THREAD:  # the system is asked only where it matters: that takes as long as a kernel
        run(range(count))
        return
    units = -(-count // unit)
    parts = 1 if _alone.get() else int(min(units, count * work // WORTH_A_THREAD, os.cpu_count() or 1))
    if parts <= 1:
        run(range(count))
        return
    ends = [min(count, unit * (units * k // parts)) for k in range(parts + 1)]
    *others, own = (range(a, b) for a, b in itertools.pairwise(ends))
    futures = [_pool().submit(run, part) for part in others]
    run(own)
    for future in futures:
        future.result()


def ask_for_threads() -> None:
    """Ask XLA for eight threads where there are fewer processors, unless the user asks for some number.

    Each of jaxlib's batched decompositions waits on a thread of XLA for its parts, which other threads do: two at once,
    as in a logarithm on SO(n) x U(n), wait for ever where there are two threads [jaxlib 0.10.2]. It counts before JAX
    computes anything.
    """
    if (os.cpu_count() or 1) < THREADS:
        os.environ.setdefault("PJRT_NPROC", str(THREADS))


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(thread_name_prefix="retrax")
