"""Arrays as the kernels take them, and threads that share the members of a batch."""

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np

LANES = 8  # numbers of a vector of the kernels
WORTH_A_THREAD = 300_000  # products that one thread does before a second is worth its start


def in_threads(run: Callable[[range], None], members: int, work: float) -> None:
    """Run a compiled kernel on ranges of the members of a batch, each of them of some work, in threads where that is faster."""
    parts = int(max(1, min(members, os.cpu_count() or 1, members * work // WORTH_A_THREAD)))
    bounds = [members * k // parts for k in range(parts + 1)]
    shares = [range(a, b) for a, b in itertools.pairwise(bounds)]
    if parts == 1:
        run(shares[0])
    else:
        list(_threads().map(run, shares))


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(thread_name_prefix="retrax-elimination")


def whole(size: int) -> int:
    """The size of whole vectors."""
    return -(-size // LANES) * LANES


def plain(array: np.ndarray) -> np.ndarray:
    """What the kernels take."""
    return np.ascontiguousarray(array, dtype=float)
