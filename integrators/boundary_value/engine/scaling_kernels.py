"""Compiled recursion of the Gramians that tell what controls reach."""

import numpy as np

from .arrays import LANES
from .lu import back_substitute, decompose, product
from .vectors import add_vector, compiled, inner

Work = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@inner
def _load(v: np.ndarray, near: np.ndarray) -> None:
    """``[near_x | 1]``."""
    n, start = near.shape[0], v.shape[1] // 2
    for a in range(n):
        for j in range(v.shape[1]):
            v[a, j] = near[a, j] if j < n else 0.0
        v[a, start + a] = 1.0


@inner
def _move(v: np.ndarray, near: np.ndarray, far: np.ndarray, own: np.ndarray, terms: np.ndarray) -> None:
    """``A' = (far_x near_x^-1)'`` in the first rows of the terms, and ``B' = (far_u - A near_u)'`` in those after them;
    then the same of the sizes of what they are sums of.

    The inverse stands in the second half of ``v``; ``own``: room for it or its sizes, and for A.
    """
    (n, z), start = near.shape, v.shape[1] // 2
    inverse, rows = own[0], own[1]
    for t in range(2):
        for a in range(n):
            for j in range(inverse.shape[1]):
                inverse[a, j] = v[a, start + j] if t == 0 else abs(v[a, start + j])
                rows[a, j] = 0.0
        for c in range(n):
            for a in range(n):
                f = far[a, c] if t == 0 else abs(far[a, c])
                for j in range(0, inverse.shape[1], LANES):
                    add_vector(rows, a, j, f, inverse, c, j)
        for a in range(n):
            for c in range(n):
                terms[t, c, a] = rows[a, c]
            for j in range(n, z):
                terms[t, j, a] = far[a, j] if t == 0 else abs(far[a, j])
        for c in range(n):
            for i in range(n, z):
                f = -near[c, i] if t == 0 else abs(near[c, i])
                for j in range(0, inverse.shape[1], LANES):
                    add_vector(terms[t], i, j, f, terms[t], c, j)


@inner
def _gramian(terms: np.ndarray, variance: np.ndarray, g: np.ndarray, rows: np.ndarray, scaled: np.ndarray) -> None:
    """``g = A g A' + B W B'`` in place, ``terms = [A B]'``; ``rows``: room for ``A g``, ``scaled``: for ``[A g, B
    W]``."""
    n = g.shape[0]
    for i in range(n):
        for j in range(rows.shape[1]):
            rows[i, j] = 0.0
    for k in range(n):
        for i in range(n):
            for j in range(0, rows.shape[1], LANES):
                add_vector(rows, i, j, terms[k, i], g, k, j)
    for i in range(n):
        for j in range(n):
            scaled[i, j] = rows[i, j]
        for j in range(variance.size):
            scaled[i, n + j] = terms[n + j, i] * variance[j]
    product(g, scaled, terms)


@compiled
def gramians(
    left: np.ndarray,
    right: np.ndarray,
    variance: np.ndarray,
    work: Work,
    swaps: np.ndarray,
    out: np.ndarray,
) -> None:
    """Diagonals of the Gramians ``G_k = A G_{k-1} A' + B W B'`` along the steps, from the start and then from the end.

    ``left``, ``right``: the ends of the steps, shape ``(N, n, z)``; ``variance``: the diagonal of ``W``. ``out``, shape
    ``(2, 2, N, n)``: at the far ends, from either side, of the linearised steps and of the sizes of their terms, which
    do not cancel.
    """
    (v, lower, weights, own, terms, g, scaled), (count, n, _) = work, left.shape
    terms[:] = 0.0
    for way in range(2):
        g[:] = 0.0
        for i in range(count):
            k = i if way == 0 else count - 1 - i
            near, far = (left[k], right[k]) if way == 0 else (right[k], left[k])
            _load(v, near)
            decompose(v, swaps, lower, weights)
            back_substitute(v, v.shape[1] // 2, lower)
            _move(v, near, far, own, terms)
            for t in range(2):
                _gramian(terms[t], variance, g[t], own[0], scaled)
                for a in range(n):
                    out[way, t, k, a] = g[t, a, a]
