"""Ranks of matrices whose entries are known to a precision of their own, by elimination that no scaling changes.

A matrix comes as a stack: what it is at a point, and at points a tiny step away. What an entry changes by between them
holds its rounding and the error of the point; entries count only if they are large beside that. Every step of the
elimination is taken in the whole stack, so that this is known of its results as well.
"""

from typing import NamedTuple

import numpy as np

from ....manifolds.numerics.tolerances import EPS

COUNTED = 1e3  # an entry is not zero if it is this many times what it changes by
# Ranks are decided where all that counts is at least the first, and all else at most the second.
CERTAIN, RANK_GAP = 1e4, 1e2
LARGEST_RATIO = 1 / EPS  # of an entry to its change: a smaller change is rounding
# Relative changes of all entries, so that the rounding of the elimination itself is not the same in a stack.
JITTER = 1e-13
BALANCED = 4  # sweeps that scale rows and columns


class Echelon(NamedTuple):
    """Reduced echelon forms of a batch of stacks, ``(batch, 1 + samples, rows, columns)``.

    ``rows``: the row with the pivot of each column, -1 where it has none. ``smallest`` and ``largest``: significance of
    what was counted and of what was not.
    """

    matrix: np.ndarray
    rows: np.ndarray
    smallest: np.ndarray
    largest: np.ndarray

    @property
    def decided(self) -> np.ndarray:
        """Where the ranks are clear."""
        return (self.smallest >= CERTAIN) & (self.largest <= RANK_GAP)

    def steps(self) -> np.ndarray:
        """Largest component of the least step to where the equations hold whose values are the last column,
        ``(batch,)``.

        Not of the step of the pivots alone: any number serves for a pivot, also one beside which others are large.
        """
        has = np.stack([np.isin(np.arange(self.matrix.shape[2]), rows) for rows in self.rows])
        solved = np.where(has[..., None], self.matrix[:, 0], 0.0)
        solved /= np.where(has, np.linalg.norm(solved[..., :-1], axis=2), 1.0)[..., None]
        finite = np.array(np.isfinite(solved).all(axis=(1, 2)))
        known = np.where(finite[:, None, None], solved, 0.0)
        found = np.linalg.pinv(known[..., :-1], rcond=JITTER) @ known[..., -1:]
        return np.where(finite, np.max(np.abs(found), axis=(1, 2), initial=0.0), np.inf)

    def null_basis(self, block: slice) -> np.ndarray:
        """Null vectors of the rows with pivots in a block of columns, one for each column without pivot; otherwise
        zeros."""
        rows = self.rows[:, block]
        basis = np.zeros((*self.matrix.shape[:2], rows.shape[1], rows.shape[1]))
        for b, pivots in enumerate(rows):
            has = pivots >= 0
            basis[b, :, has] = -np.moveaxis(self.matrix[b][:, pivots[has], block], 1, 0)
            basis[b][:, ~has, ~has] = 1.0
            basis[b][:, :, has] = 0.0
        return basis


def significance(stack: np.ndarray) -> np.ndarray:
    """Sizes of the entries at the point over what they change by, zero for zeros; shape ``(batch, ...)``."""
    size, change = np.abs(stack[:, 0]), np.max(np.abs(stack[:, 1:] - stack[:, :1]), axis=1)
    return size / np.where(size > 0, np.maximum(change, size / LARGEST_RATIO), 1.0)


def without_small(stack: np.ndarray, least: np.ndarray, steady: float) -> np.ndarray:
    """The stack with zeros for entries of at most these sizes that change by no more than a multiple ``steady`` of
    their own."""
    size, change = np.abs(stack[:, 0]), np.max(np.abs(stack[:, 1:] - stack[:, :1]), axis=1)
    return np.where(((size <= least) & (change <= steady * size))[:, None], 0.0, stack)


def eliminate(stack: np.ndarray, blocks: tuple[slice, ...], level: np.ndarray) -> Echelon:
    """Gauss-Jordan elimination of blocks of columns in turn, with the largest balanced pivot in the lowest level of
    rows."""
    finite = np.array(np.isfinite(stack).all(axis=(1, 2, 3)))
    matrix = np.where(finite[:, None, None, None], stack, 0.0)
    matrix[:, 1:] *= 1 + JITTER * np.random.default_rng(0).standard_normal(matrix[0, 1:].shape)
    scale, (count, _, height, width) = _balance(matrix), matrix.shape
    rows, free = np.full((count, width), -1), np.ones((count, height), bool)
    smallest, largest = np.where(finite, LARGEST_RATIO, 0.0), np.zeros(count)
    for block in blocks:
        while True:
            known = significance(matrix[..., block]) * free[..., None]
            lowest = np.min(np.where((known > COUNTED).any(axis=2), level, height), axis=1, initial=height)
            eligible = (known > COUNTED) & (level == lowest[:, None])[..., None]
            where = np.flatnonzero(eligible.any(axis=(1, 2)))
            if not where.size:
                break
            sizes = np.where(eligible, np.abs(matrix[:, 0, :, block]) * scale[..., block], 0.0)[where]
            r, c = np.divmod(np.argmax(sizes.reshape(len(where), -1), axis=1), sizes.shape[2])
            smallest[where] = np.minimum(smallest[where], known[where, r, c])
            _pivot(matrix, where, r, c + block.start)
            rows[where, c + block.start], free[where, r] = r, False
        largest = np.maximum(largest, np.max(known, axis=(1, 2), initial=0.0))
    return Echelon(matrix, rows, smallest, largest)


def _pivot(matrix: np.ndarray, where: np.ndarray, r: np.ndarray, c: np.ndarray) -> None:
    """Eliminate columns ``c`` with rows ``r`` in the chosen members of the batch, in place."""
    row = matrix[where, :, r, :] / matrix[where, :, r, c][..., None]
    matrix[where] -= matrix[where, :, :, c][..., None] * row[:, :, None]
    matrix[where, :, r, :] = row
    matrix[where, :, :, c] = 0.0
    matrix[where, :, r, c] = 1.0


def _balance(matrix: np.ndarray) -> np.ndarray:
    """Factors that make the largest entry of every row and column one, among entries that count."""
    known = np.where(significance(matrix) > COUNTED, np.abs(matrix[:, 0]), 0.0)
    scale = np.ones_like(known)
    for axis in (2, 1) * BALANCED:
        largest = np.max(known * scale, axis=axis, keepdims=True, initial=0.0)
        scale = scale / np.where(largest > 0, largest, 1.0)
    return scale
