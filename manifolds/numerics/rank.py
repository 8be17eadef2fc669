"""Ranks and null spaces of matrices in floating point, with the evidence for them."""

from typing import NamedTuple

import numpy as np

RANK_POWER = 0.45  # of eps: smallest singular value that counts, relative to the largest: 9e-8, in single precision 8e-4


class Rank(NamedTuple):
    """A numerical rank, the singular values it was read from, and the gap: last one counted over first one not counted.

    Where none is counted, the gap is the unit over the first.
    """

    rank: int
    singular_values: np.ndarray
    gap: float


def numerical_rank(matrix: np.ndarray, unit: float = 0.0) -> Rank:
    """Number of singular values above the tolerance times the largest of them, or times ``unit`` if that is larger."""
    if not matrix.size:
        return Rank(0, np.zeros(0), np.inf)
    values = np.linalg.svd(matrix, compute_uv=False)
    rank = int(np.sum(values > np.finfo(values.dtype).eps ** RANK_POWER * max(values[0], unit)))
    dropped = values[rank] if rank < len(values) else 0.0
    return Rank(rank, values, float((values[rank - 1] if rank else unit) / dropped) if dropped else np.inf)


def null_space(matrix: np.ndarray, unit: float = 0.0) -> np.ndarray:
    """Orthonormal basis of the null space, one column each."""
    if not matrix.size:
        return np.eye(matrix.shape[1])
    _, _, directions = np.linalg.svd(matrix)
    return directions[numerical_rank(matrix, unit).rank :].T
