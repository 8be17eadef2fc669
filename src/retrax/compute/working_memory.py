"""Arrays that begin at a cache line, so that no vector of the processor lies across two lines."""

import math
import threading
from collections.abc import Sequence

import numpy as np

LINE = 8  # numbers in a cache line
KEPT_SCRATCH = 2**19  # numbers of a thread: larger arrays are made anew, which takes no time beside their use

Shapes = tuple[tuple[int, ...], ...]


def aligned_array(*shape: int) -> np.ndarray:
    """An array of numbers that are not set."""
    return aligned_arrays([shape])[0]


def aligned_arrays(shapes: Sequence[tuple[int, ...]]) -> list[np.ndarray]:
    """Arrays of these shapes, of numbers that are not set, in one piece of memory."""
    sizes = [math.prod(shape) for shape in shapes]
    room = np.empty(sum(sizes) + LINE * len(sizes))
    first, found = -(room.__array_interface__["data"][0] // 8) % LINE, []
    for shape, size in zip(shapes, sizes, strict=True):
        found.append(room[first : first + size].reshape(shape))
        first += -(-size // LINE) * LINE
    return found


class _Scratch(threading.local):
    def __init__(self) -> None:
        self.known: dict[Shapes, list[np.ndarray]] = {}
        self.size = 0


_scratch = _Scratch()


def scratch(shapes: Shapes) -> list[np.ndarray]:
    """Working arrays of these shapes, of numbers that are not set.

    The next call in the thread for the same shapes returns the same arrays.
    """
    found = _scratch.known.get(shapes)
    if found is not None:
        return found
    found, size = aligned_arrays(shapes), sum(map(math.prod, shapes))
    if size <= KEPT_SCRATCH:
        if _scratch.size + size > KEPT_SCRATCH:
            _scratch.known, _scratch.size = {}, 0
        _scratch.known[shapes] = found
        _scratch.size += size
    return found
