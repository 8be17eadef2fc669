"""Compiled recursion of the Gramians that tell what controls reach."""

import numpy as np

from .arrays import LANES
from .lu import back_substitute, decompose
from .vectors import add, compiled, entry, filled, inner, magnitude, put, put_entry, subtract, vector

Work = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@inner
def _load(v: np.ndarray, near: np.ndarray) -> None:
    """``[near_x | 1]``."""
    n, start = near.shape[0], v.shape[1] // 2
    for a in range(n):
        for j in range(0, v.shape[1], LANES):
            put(v, a, j, filled(0.0))
        for j in range(n):
            put_entry(v, a, j, entry(near, a, j))
        put_entry(v, a, start + a, 1.0)


@inner
def _move(
    v: np.ndarray, near: np.ndarray, far: np.ndarray, turned: np.ndarray, terms: np.ndarray, sizes: np.ndarray
) -> None:
    """``A' = (far_x near_x^-1)'`` in the first rows of the terms, and ``B' = (far_u - A near_u)'`` in those after them;
    and the sizes of what they are sums of.

    The inverse stands in the second half of ``v``; ``turned``: room for the transpose of ``far``.
    """
    (n, z), start = near.shape, v.shape[1] // 2
    for a in range(n):
        for j in range(z):
            put_entry(turned, j, a, entry(far, a, j))
    for j in range(0, terms.shape[1], LANES):
        for c in range(n):
            row, size = filled(0.0), filled(0.0)
            for b in range(n):
                f, x = entry(v, b, start + c), vector(turned, b, j)
                row, size = add(row, f, x), add(size, abs(f), magnitude(x))
            put(terms, c, j, row)
            put(sizes, c, j, size)
        for i in range(n, z):
            row = vector(turned, i, j)
            size = magnitude(row)
            for c in range(n):
                f = entry(near, c, i)
                row, size = subtract(row, f, vector(terms, c, j)), add(size, abs(f), vector(sizes, c, j))
            put(terms, i, j, row)
            put(sizes, i, j, size)


@inner
def _gramian(terms: np.ndarray, variance: np.ndarray, g: np.ndarray, rows: np.ndarray) -> None:
    """``g = A g A' + B W B'`` in place, ``terms = [A B]'``; ``rows``: room for ``A g``."""
    n = g.shape[0]
    for i in range(n):
        for j in range(0, g.shape[1], LANES):
            row = filled(0.0)
            for k in range(n):
                row = add(row, entry(terms, k, i), vector(g, k, j))
            put(rows, i, j, row)
    for i in range(n):
        for j in range(0, g.shape[1], LANES):
            row = filled(0.0)
            for k in range(n):
                row = add(row, entry(rows, i, k), vector(terms, k, j))
            for k in range(variance.size):
                row = add(row, entry(terms, n + k, i) * variance[k], vector(terms, n + k, j))
            put(g, i, j, row)


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
    (v, lower, weights, turned, terms, g, rows), (count, n, _) = work, left.shape
    turned[:] = 0.0
    for way in range(2):
        g[:] = 0.0
        for i in range(count):
            k = i if way == 0 else count - 1 - i
            near, far = (left[k], right[k]) if way == 0 else (right[k], left[k])
            _load(v, near)
            decompose(v, swaps, lower, weights)
            back_substitute(v, v.shape[1] // 2, lower)
            _move(v, near, far, turned, terms[0], terms[1])
            for t in range(2):
                _gramian(terms[t], variance, g[t], rows)
                for a in range(n):
                    out[way, t, k, a] = g[t, a, a]
