"""Arrays as the kernels take them."""

import numpy as np

LANES = 8  # numbers of a vector of the kernels


def whole(size: int) -> int:
    """The size of whole vectors."""
    return -(-size // LANES) * LANES


def plain(array: np.ndarray) -> np.ndarray:
    """What the kernels take."""
    return np.ascontiguousarray(array, dtype=float)
