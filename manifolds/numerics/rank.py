"""Ranks and null spaces of matrices in floating point, with the evidence for them."""

from typing import NamedTuple

import numpy as np

from .tolerances import RANK, REGULAR, tolerance


class Rank(NamedTuple):
    """A numerical rank, the singular values it was read from, and the gap: last one counted over first one not counted.

    Where none is counted, the gap is the unit over the first.
    """

    rank: int
    singular_values: np.ndarray
    gap: float


def numerical_rank(matrix: np.ndarray, unit: float = 0.0, limit: float | None = None) -> Rank:
    """Number of singular values above ``limit`` times the largest of them, or times ``unit`` if that is larger.

    ``limit``: by default that for matrices of derivatives.
    """
    if not matrix.size:
        return Rank(0, np.zeros(0), np.inf)
    values = np.linalg.svd(matrix, compute_uv=False)
    relative = tolerance(values, RANK) if limit is None else limit
    rank = int(np.sum(values > relative * max(values[0], unit)))
    dropped = values[rank] if rank < len(values) else 0.0
    return Rank(rank, values, float((values[rank - 1] if rank else unit) / dropped) if dropped else np.inf)


def pivotal_values(matrix: np.ndarray) -> np.ndarray:
    """Singular values, descending, of a symmetric matrix whose rows and columns are measured by its diagonal.

    They do not depend on the units of the coordinates. A row without a diagonal entry is measured by its largest one.
    """
    largest = np.max(np.abs(matrix), axis=1, initial=0.0)
    sizes = np.abs(np.diagonal(matrix))
    sizes = np.where(sizes > 0, sizes, largest)
    scale = 1 / np.sqrt(np.where(sizes > 0, sizes, 1.0))
    return np.linalg.svd(scale[:, None] * matrix * scale, compute_uv=False)


def is_regular(values: np.ndarray) -> bool:
    """Whether none of the singular values, descending, is zero to rounding."""
    return bool(values.size == 0 or values[-1] > tolerance(values, REGULAR) * values[0] > 0)


def null_space(matrix: np.ndarray, unit: float = 0.0, limit: float | None = None) -> np.ndarray:
    """Orthonormal basis of the null space, one column each, with the rank that ``numerical_rank`` finds."""
    if not matrix.size:
        return np.eye(matrix.shape[1])
    _, _, directions = np.linalg.svd(matrix)
    return directions[numerical_rank(matrix, unit, limit).rank :].conj().T
