"""Arrays that begin where a cache line begins, so that no vector of the processor lies across two of them."""

import math
from collections.abc import Sequence

import numpy as np

LINE = 8  # numbers in a cache line


def aligned(*shape: int) -> np.ndarray:
    """An array of numbers that are not set."""
    return aligned_all([shape])[0]


def aligned_all(shapes: Sequence[tuple[int, ...]]) -> list[np.ndarray]:
    """Arrays of these shapes, of numbers that are not set, in one piece of memory."""
    sizes = [math.prod(shape) for shape in shapes]
    room = np.empty(sum(sizes) + LINE * len(sizes))
    first, found = -(room.__array_interface__["data"][0] // 8) % LINE, []
    for shape, size in zip(shapes, sizes, strict=True):
        found.append(room[first : first + size].reshape(shape))
        first += -(-size // LINE) * LINE
    return found
