"""Symmetric indefinite factorisation of small matrices with borders, compiled.

A front is the upper triangle of a symmetric matrix, row after row, whose first rows are pivots; those after them are borders, on
which the Schur complement is left; then come columns of right-hand sides. Rows are padded to vectors of ``LANES`` entries:
``w`` of shape ``(rows, vectors, LANES)`` and ``v``, the same numbers as ``(rows, vectors * LANES)``.
"""

import math

import numba
import numpy as np

LANES = 8
BALANCE = (1 + math.sqrt(17)) / 8  # bounds the growth by one pivot of size two as by two of size one [Bunch, Kaufman 1977]

compiled = numba.njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract"})
reordered = numba.njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract", "reassoc"})


@reordered
def dot(x: np.ndarray, first: int, last: int, y: np.ndarray, base: int) -> float:
    """``sum_j x[j] y[base + j]``."""
    total = 0.0
    for j in range(first, last):
        total += x[j] * y[base + j]
    return total


@compiled
def _subtract(w: np.ndarray, i: int, k: int, f: float) -> None:
    """Row i less f times row k, from the diagonal on."""
    for c in range(i // LANES, w.shape[1]):
        a, b, d, e = f * w[k, c, 0], f * w[k, c, 1], f * w[k, c, 2], f * w[k, c, 3]
        p, q, r, s = f * w[k, c, 4], f * w[k, c, 5], f * w[k, c, 6], f * w[k, c, 7]
        a, b, d, e = w[i, c, 0] - a, w[i, c, 1] - b, w[i, c, 2] - d, w[i, c, 3] - e
        p, q, r, s = w[i, c, 4] - p, w[i, c, 5] - q, w[i, c, 6] - r, w[i, c, 7] - s
        w[i, c, 0], w[i, c, 1], w[i, c, 2], w[i, c, 3] = a, b, d, e
        w[i, c, 4], w[i, c, 5], w[i, c, 6], w[i, c, 7] = p, q, r, s


@compiled
def _subtract_two(w: np.ndarray, i: int, k: int, f: float, g: float) -> None:
    """Row i less f times row k and g times the row after it, from the diagonal on."""
    h = k + 1
    for c in range(i // LANES, w.shape[1]):
        a, b = f * w[k, c, 0] + g * w[h, c, 0], f * w[k, c, 1] + g * w[h, c, 1]
        d, e = f * w[k, c, 2] + g * w[h, c, 2], f * w[k, c, 3] + g * w[h, c, 3]
        p, q = f * w[k, c, 4] + g * w[h, c, 4], f * w[k, c, 5] + g * w[h, c, 5]
        r, s = f * w[k, c, 6] + g * w[h, c, 6], f * w[k, c, 7] + g * w[h, c, 7]
        a, b, d, e = w[i, c, 0] - a, w[i, c, 1] - b, w[i, c, 2] - d, w[i, c, 3] - e
        p, q, r, s = w[i, c, 4] - p, w[i, c, 5] - q, w[i, c, 6] - r, w[i, c, 7] - s
        w[i, c, 0], w[i, c, 1], w[i, c, 2], w[i, c, 3] = a, b, d, e
        w[i, c, 4], w[i, c, 5], w[i, c, 6], w[i, c, 7] = p, q, r, s


@compiled
def _largest(v: np.ndarray, r: int, first: int, last: int) -> tuple[float, int]:
    """Size and place of the largest entry beside the diagonal in row r of what is left to factorise."""
    size, place = 0.0, r
    for i in range(first, r):
        if abs(v[i, r]) > size:
            size, place = abs(v[i, r]), i
    for j in range(r + 1, last):
        if abs(v[r, j]) > size:
            size, place = abs(v[r, j]), j
    return size, place


@compiled
def _chosen(v: np.ndarray, k: int, last: int) -> tuple[int, int]:
    """Rows of the next pivot, equal where it is of size one: the entry is the largest in both its rows.

    Such a search bounds the factor, so that the smallest pivot tells how near to singular the matrix is; that of Bunch and Kaufman
    does not [Ashcraft, Grimes, Lewis 1998].
    """
    size, r = _largest(v, k, k, last)
    if abs(v[k, k]) >= BALANCE * size or r == k:
        return k, k
    i = k
    while True:
        larger, j = _largest(v, r, k, last)
        if abs(v[r, r]) >= BALANCE * larger:
            return r, r
        if not larger > size:
            return i, r
        i, r, size = r, j, larger


@compiled
def _swap(v: np.ndarray, first: int, k: int, r: int) -> None:
    """Exchange rows and columns ``k < r`` of what is left to factorise from row ``first`` on."""
    if r == k:
        return
    for i in range(first, k):
        v[i, k], v[i, r] = v[i, r], v[i, k]
    v[k, k], v[r, r] = v[r, r], v[k, k]
    for i in range(k + 1, r):
        v[k, i], v[i, r] = v[i, r], v[k, i]
    for j in range(r + 1, v.shape[1]):
        v[k, j], v[r, j] = v[r, j], v[k, j]


@compiled
def _eliminated_one(w: np.ndarray, v: np.ndarray, k: int, rows: int) -> None:
    inverse = 1 / v[k, k]
    for i in range(k + 1, rows):
        f = v[k, i] * inverse
        if f != 0:
            _subtract(w, i, k, f)


@compiled
def _eliminated_two(w: np.ndarray, v: np.ndarray, k: int, rows: int) -> None:
    """The inverse is formed relative to the entry beside the diagonal, the largest."""
    inverse = 1 / v[k, k + 1]
    a, c = v[k, k] * inverse, v[k + 1, k + 1] * inverse
    inverse /= a * c - 1
    for i in range(k + 2, rows):
        f, g = inverse * (c * v[k, i] - v[k + 1, i]), inverse * (a * v[k + 1, i] - v[k, i])
        if f != 0 or g != 0:
            _subtract_two(w, i, k, f, g)


@compiled
def factorise(w: np.ndarray, v: np.ndarray, swaps: np.ndarray, last: int, rows: int) -> tuple[int, float]:
    """Factorise the first ``last`` of the rows in place, and the number of negative pivots and the size of the smallest.

    ``swaps``: the row exchanged with each, as -1 - row in a pivot of size two.
    """
    negative, smallest, k = 0, np.inf, 0
    while k < last:
        i, r = _chosen(v, k, last)
        a, b, c = v[i, i], v[min(i, r), max(i, r)], v[r, r]
        _swap(v, k, k, i)
        if i == r:
            swaps[k] = i
            negative, size = negative + (a < 0), abs(a)
            _eliminated_one(w, v, k, rows)
            k += 1
        else:
            r = i if r == k else r
            _swap(v, k, k + 1, r)
            swaps[k], swaps[k + 1] = -1 - i, -1 - r
            large = (abs(a + c) + math.hypot(a - c, 2 * b)) / 2
            negative, size = negative + 1, abs(a * (c / large) - b * (b / large))
            _eliminated_two(w, v, k, rows)
            k += 2
        if size < smallest or size != size:
            smallest = size
    return negative, smallest


@compiled
def scale(w: np.ndarray, v: np.ndarray, u: np.ndarray, last: int) -> None:
    """Scale the first ``last`` rows and columns to one size, by the factors that are left in ``u``, else ones."""
    u[:] = 0.0
    for i in range(last):
        largest = u[i]
        for j in range(i, last):
            size = abs(v[i, j])
            largest = size if size > largest else largest
            u[j] = size if size > u[j] else u[j]
        u[i] = largest
    for i in range(u.size):
        u[i] = 1 / math.sqrt(u[i]) if u[i] > 0 else 1.0
    for i in range(last):
        for c in range(i // LANES, w.shape[1]):
            for t in range(LANES):
                w[i, c, t] *= u[i] * u[c * LANES + t]


@compiled
def substitute(rows: np.ndarray, bases: np.ndarray, swaps: np.ndarray, x: np.ndarray, last: int, side: int) -> None:
    """Solve for the first ``last`` entries of ``x``, whose others, those of the borders, are known.

    ``rows`` are factorised rows one after the other, entry ``j`` of row ``k`` at ``bases[k] + j``; right-hand side: column ``side``.
    """
    size, k = x.size, last - 1
    while k >= 0:
        base, r = bases[k], swaps[k]
        if r >= 0:
            x[k] = (rows[base + side] - dot(x, k + 1, size, rows, base)) / rows[base + k]
            x[k], x[r] = x[r], x[k]
            k -= 1
        else:
            other, r, i = bases[k - 1], -1 - r, -1 - swaps[k - 1]
            f = rows[other + side] - dot(x, k + 1, size, rows, other)
            g = rows[base + side] - dot(x, k + 1, size, rows, base)
            inverse = 1 / rows[other + k]
            a, c = rows[other + k - 1] * inverse, rows[base + k] * inverse
            inverse /= a * c - 1
            x[k - 1], x[k] = inverse * (c * f - g), inverse * (a * g - f)
            x[k], x[r] = x[r], x[k]
            x[k - 1], x[i] = x[i], x[k - 1]
            k -= 2
