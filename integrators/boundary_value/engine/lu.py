"""Gauss's elimination of small dense matrices with padded right-hand sides, compiled."""

import numpy as np

from .arrays import LANES
from .factorisation import subtract_all
from .vectors import add_vector, entry, inner, over, put, put_entry, vector

TOGETHER = 3  # rows that are solved for at once
ALONE = 1e300  # the weight of a row that has nothing but its diagonal


@inner
def _pivot_row(v: np.ndarray, k: int, weights: np.ndarray) -> int:
    r, largest = k, abs(entry(v, k, k)) * weights[k]
    for i in range(k + 1, v.shape[0]):
        size = abs(entry(v, i, k)) * weights[i]
        if size > largest:
            r, largest = i, size
    return r


@inner
def decompose(v: np.ndarray, swaps: np.ndarray, lower: np.ndarray, weights: np.ndarray) -> None:
    """Gauss's elimination; rows of one size choose the pivots. ``lower``: the factors of the rows in the order of their
    time.

    A row that has nothing but its diagonal, as that of a state which rests, gives the pivot of its column: another one
    would leave rounding where it has zeros, and with that nothing is at rest.
    """
    p = v.shape[0]
    for i in range(p):
        largest, others = abs(entry(v, i, i)), 0.0
        for j in range(p):
            if j != i:
                others = max(others, abs(entry(v, i, j)))
        weights[i] = ALONE if others == 0 and largest > 0 else 1 / max(largest, others)
    for k in range(p):
        r = _pivot_row(v, k, weights)
        swaps[k] = r
        if r != k:
            weights[k], weights[r] = weights[r], weights[k]
            for j in range(0, v.shape[1], LANES):
                x = vector(v, k, j)
                put(v, k, j, vector(v, r, j))
                put(v, r, j, x)
        for i in range(k + 1, p):
            f = entry(v, i, k) / entry(v, k, k)
            put_entry(lower, i, k, f)
            if f != 0:
                for j in range(k & -LANES, v.shape[1], LANES):
                    add_vector(v, i, j, -f, v, k, j)


@inner
def back_substitute(v: np.ndarray, start: int, upper: np.ndarray) -> None:
    """Solve for all right-hand sides in place, and keep the upper triangle, which stands below the diagonal too
    then."""
    p = v.shape[0]
    for k in range(p):
        for j in range(k, p):
            f = entry(v, k, j)
            put_entry(upper, k, j, f)
            put_entry(v, j, k, f)
    last = p
    while last > 0:
        first = max(last - TOGETHER, 0)
        subtract_all(v, first, last, start, v.shape[1], v, last, v, last, p - last)
        for k in range(last - 1, first - 1, -1):
            for i in range(k + 1, last):
                for j in range(start, v.shape[1], LANES):
                    add_vector(v, k, j, -entry(v, i, k), v, i, j)
            for j in range(start, v.shape[1], LANES):
                put(v, k, j, over(vector(v, k, j), entry(v, k, k)))
        last = first


@inner
def solve_transposed(factors: np.ndarray, swaps: np.ndarray, x: np.ndarray) -> None:
    """Solve with the transposed matrix in place; lower and upper triangle in one array."""
    p = x.size
    for k in range(p):
        x[k] /= factors[k, k]
        for j in range(k + 1, p):
            x[j] -= factors[k, j] * x[k]
    for k in range(p - 1, -1, -1):
        for i in range(k + 1, p):
            x[k] -= factors[i, k] * x[i]
        x[k], x[swaps[k]] = x[swaps[k]], x[k]
