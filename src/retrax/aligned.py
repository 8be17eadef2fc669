"""Arrays that begin where a cache line begins, so that no vector of the processor lies across two of them."""

import math

import numpy as np

LINE = 64  # bytes


def aligned(*shape: int) -> np.ndarray:
    """An array of numbers that are not set."""
    size = 8 * math.prod(shape)
    room = np.empty(size + LINE, np.uint8)
    first = -room.__array_interface__["data"][0] % LINE
    return room[first : first + size].view(float).reshape(shape)
