"""Compiled recursion of the Gramians that tell what controls reach."""

import numpy as np

from .factors import compiled, inner
from .lu import back_substitute, decompose

Work = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@inner
def _move(near: np.ndarray, far: np.ndarray, v: np.ndarray, move: np.ndarray, push: np.ndarray) -> None:
    """``A = far_x near_x^-1`` and ``B = far_u - A near_u``, then their terms with their sizes.

    The inverse stands in the second half of ``v``; ``move``, ``push``: both pairs.
    """
    (n, z), start = near.shape, v.shape[1] // 2
    for a in range(n):
        for b in range(n):
            total, size = 0.0, 0.0
            for c in range(n):
                term = far[a, c] * v[c, start + b]
                total += term
                size += abs(term)
            move[0, a, b], move[1, a, b] = total, size
        for j in range(n, z):
            total, size = far[a, j], abs(far[a, j])
            for c in range(n):
                total -= move[0, a, c] * near[c, j]
                size += move[1, a, c] * abs(near[c, j])
            push[0, a, j - n], push[1, a, j - n] = total, size


@inner
def _gramian(a: np.ndarray, b: np.ndarray, variance: np.ndarray, g: np.ndarray, rows: np.ndarray) -> None:
    """``g = a g a' + b W b'`` in place; ``rows``: room for ``a g``."""
    n = a.shape[0]
    for i in range(n):
        for k in range(n):
            total = 0.0
            for j in range(n):
                total += a[i, j] * g[j, k]
            rows[i, k] = total
    for i in range(n):
        for k in range(n):
            total = 0.0
            for j in range(n):
                total += rows[i, j] * a[k, j]
            for j in range(variance.size):
                total += b[i, j] * variance[j] * b[k, j]
            g[i, k] = total


@compiled
def gramians(
    left: np.ndarray,
    right: np.ndarray,
    variance: np.ndarray,
    work: Work,
    swaps: np.ndarray,
    g: np.ndarray,
    out: np.ndarray,
) -> None:
    """Diagonals of the Gramians ``G_k = A G_{k-1} A' + B W B'`` along the steps, from the start and then from the end.

    ``left``, ``right``: the ends of the steps, shape ``(N, n, z)``; ``variance``: the diagonal of ``W``; ``g``: room
    for two Gramians. ``out``, shape ``(2, 2, N, n)``: at the far ends, from either side, of the linearised steps and of
    the sizes of their terms, which do not cancel.
    """
    (v, lower, weights, move, push, rows), (count, n, _) = work, left.shape
    start = v.shape[1] // 2
    for way in range(2):
        g[:] = 0.0
        for i in range(count):
            k = i if way == 0 else count - 1 - i
            near, far = (left[k], right[k]) if way == 0 else (right[k], left[k])
            for a in range(n):
                for j in range(v.shape[1]):
                    v[a, j] = near[a, j] if j < n else 0.0
                v[a, start + a] = 1.0
            decompose(v, swaps, lower, weights)
            back_substitute(v, start, lower)
            _move(near, far, v, move, push)
            for t in range(2):
                _gramian(move[t], push[t], variance, g[t], rows)
                for a in range(n):
                    out[way, t, k, a] = g[t, a, a]
