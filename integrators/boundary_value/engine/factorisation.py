"""Symmetric indefinite factorisation of small matrices with borders, compiled.

A front is a symmetric matrix, all of its entries, some of whose first rows are pivots; those after them are borders, on
which the Schur complement is left; then come columns of right-hand sides. Rows are padded to whole vectors and stay
where they are; what the pivots explain of one is subtracted when the search for the next pivot comes to it, of all of
them at once.
"""

import math

import numpy as np

from .arrays import LANES
from .vectors import (
    entry,
    filled,
    highest,
    inner,
    inverse,
    larger,
    look_at_one,
    look_at_three,
    look_at_two,
    magnitude,
    one_by_one,
    plus,
    put,
    put_entry,
    root,
    scaled,
    sought,
    subtract,
    three_by_one,
    three_by_two,
    times,
    vector,
    within,
    without,
)

# Bounds the growth by one pivot of size two as by two of size one [Bunch, Kaufman 1977].
BALANCE = (1 + math.sqrt(17)) / 8

Pivots = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@inner
def subtract_all(
    y: np.ndarray,
    first: int,
    last: int,
    begin: int,
    end: int,
    f: np.ndarray,
    t: int,
    x: np.ndarray,
    k: int,
    count: int,
) -> None:
    """``y[i, j] -= sum_s f[t + s, i] * x[k + s, j]`` in these rows and columns, so many terms."""
    i = first
    while i < last:
        if i + 2 < last:
            j = begin
            while j + LANES < end:
                three_by_two(y, i, j, f, t, x, k, count)
                j += 2 * LANES
            if j < end:
                three_by_one(y, i, j, f, t, x, k, count)
            i += 3
        else:
            for j in range(begin, end, LANES):
                one_by_one(y, i, j, f, t, x, k, count)
            i += 1


@inner
def _largest(v: np.ndarray, left: np.ndarray, pivots: Pivots, base: int, r: int, count: int, first: int) -> float:
    """Subtract from row r what the pivots explain of it since it was last asked for, ``count`` by now; size of the
    largest entry beside the diagonal in what is left to factorise."""
    divided, rows, _, done = pivots
    known, width = done[r], v.shape[1]
    j, found = first & -LANES, filled(0.0)
    while j + 2 * LANES < width:
        found = larger(look_at_three(v, r, j, divided, base + known, rows, known, count - known, left), found)
        j += 3 * LANES
    if j + LANES < width:
        found = larger(look_at_two(v, r, j, divided, base + known, rows, known, count - known, left), found)
    elif j < width:
        found = larger(look_at_one(v, r, j, divided, base + known, rows, known, count - known, left), found)
    done[r] = count
    return highest(found)


@inner
def _where(left: np.ndarray, first: int, last: int, r: int, size: float) -> int:
    """The first place of the entry of this size in the row that was looked at."""
    for j in range(first & -LANES, last, LANES):
        lane = sought(vector(left, 1, j), size)
        if lane < LANES:
            return j + lane
    return r


@inner
def _chosen(
    v: np.ndarray, left: np.ndarray, pivots: Pivots, base: int, k: int, ends: tuple[int, int], begin: tuple[int, int]
) -> tuple[int, int]:
    """Rows of the next pivot, equal where it is of size one: the entry is the largest in both its rows.

    Such a search bounds the factor, so that the smallest pivot tells how near to singular the matrix is; that of Bunch
    and Kaufman does not [Ashcraft, Grimes, Lewis 1998]. ``begin``: the row where it begins, and one where it looks for
    the largest entry there first: where these are known, the processor does not wait for what is found.
    """
    first, last = ends
    i, r, size = begin[0], begin[0], 0.0
    while True:
        most = _largest(v, left, pivots, base, r, k, first)
        if abs(entry(v, r, r)) >= BALANCE * most:
            return r, r
        if not most > size:
            return i, r
        other = begin[1]
        if size > 0 or other < first or entry(left, 1, other) != most:
            other = _where(left, first, last, r, most)
        if other == i:  # rounding in one of the rows is not that in the other
            return i, r
        i, r, size = r, other, most


@inner
def _divided(v: np.ndarray, pivots: Pivots, base: int, k: int, i: int, r: int, first: int) -> None:
    """Keep the rows of a pivot, and divided by it: a row's entries in those are what is to be subtracted from it of
    these.

    The inverse of a pivot of two is formed relative to the entry beside the diagonal, the largest.
    """
    divided, rows, over = pivots[0], pivots[1], 1 / entry(v, i, r)
    a, c = entry(v, i, i) * over, entry(v, r, r) * over
    both = over / (a * c - 1)
    for j in range(first & -LANES, v.shape[1], LANES):
        x = vector(v, i, j)
        put(rows, k, j, x)
        if i == r:
            put(divided, base + k, j, scaled(over, x))
        else:
            y = vector(v, r, j)
            put(rows, k + 1, j, y)
            put(divided, base + k, j, scaled(both, subtract(scaled(c, x), 1.0, y)))
            put(divided, base + k + 1, j, scaled(both, subtract(scaled(a, y), 1.0, x)))
    if i != r:
        put_entry(divided, base + k, r, 0.0)
        put_entry(divided, base + k + 1, i, 0.0)


@inner
def _take(left: np.ndarray, r: int) -> None:
    """Row r is not left to factorise."""
    j = r & -LANES
    put(left, 0, j, without(vector(left, 0, j), j, r))


@inner
def factorise(v: np.ndarray, left: np.ndarray, pivots: Pivots, base: int, last: int, known: int) -> tuple[int, float]:
    """Factorise the first ``last`` of the rows, and the number of negative pivots and the size of the smallest.

    ``left``: room for two rows; ``pivots``: from row ``base`` on their rows, divided; room for as many rows as they
    were; from ``base`` on which ones they are; and room for a number of each row of the front. ``known``: how many rows
    before are the pivots of a front like this one, whose order is tried first.
    """
    negative, smallest, k, first, order = 0, np.inf, np.int64(0), np.int64(0), pivots[2]
    for j in range(0, left.shape[1], LANES):
        put(left, 0, j, within(filled(1.0), j, 0, last))
    for i in range(v.shape[0]):
        pivots[3][i] = 0
    while k < last:
        while entry(left, 0, first) == 0:
            first += 1
        begin = first, first
        if k + 1 < known and entry(left, 0, order[base - known + k]) != 0:
            begin = order[base - known + k], order[base - known + k + 1]
        i, r = _chosen(v, left, pivots, base, k, (first, last), begin)
        a, b, c = entry(v, i, i), entry(v, i, r), entry(v, r, r)
        _divided(v, pivots, base, k, i, r, first)
        pivots[2][base + k] = i
        _take(left, i)
        k += 1
        size = abs(a)
        if i != r:
            pivots[2][base + k] = r
            _take(left, r)
            k += 1
            large = (abs(a + c) + math.sqrt((a - c) * (a - c) + 4 * b * b)) / 2
            size = abs(a * (c / large) - b * (b / large))
        negative += 1 if i != r or a < 0 else 0
        if size < smallest or size != size:
            smallest = size
    return negative, smallest


@inner
def scale(v: np.ndarray, u: np.ndarray, k: int, z: int, last: int) -> None:
    """Scale the first ``last`` rows and columns to one size, by the factors that are left in row k of ``u``, else ones.

    First come z unknowns, measured by their largest entries, then equations, by the unknowns in their sizes: so weights
    in the Hessian of the unknowns do not make them small.
    """
    for j in range(0, v.shape[1], LANES):
        most = filled(0.0)
        for i in range(last if j < z else 0):
            most = larger(magnitude(vector(v, i, j)), most)
        put(u, k, j, within(inverse(root(most)), j, 0, z))
    for j in range(z & -LANES, v.shape[1], LANES):
        own, most = filled(0.0), filled(0.0)
        for i in range(z):
            most = larger(scaled(entry(u, k, i), magnitude(vector(v, i, j))), most)
        for i in range(z, last):
            own = larger(magnitude(vector(v, i, j)), own)
        size = within(inverse(larger(most, root(own))), j, z, last)
        put(u, k, j, plus(plus(vector(u, k, j), size), within(filled(1.0), j, last, v.shape[1])))
    for i in range(v.shape[0]):
        for j in range(0, v.shape[1], LANES):
            put(v, i, j, times(vector(v, i, j), scaled(entry(u, k, i), vector(u, k, j))))


@inner
def substitute(pivots: Pivots, base: int, last: int, x: np.ndarray, column: int, side: int) -> None:
    """Solve for the first ``last`` entries of row ``column`` of ``x``, whose others, those of the borders, are known
    and stand from ``last`` up to ``side``, the column of the first right-hand side.

    Entries after ``side + column``: room for as many numbers.
    """
    divided, order = pivots[0], pivots[2]
    for t in range(last):
        value = entry(divided, base + t, side + column)
        for a in range(last, side):
            value -= entry(divided, base + t, a) * entry(x, column, a)
        put_entry(x, column, side + t, value)
    for t in range(last - 1, -1, -1):
        value, i = entry(x, column, side + t), order[base + t]
        put_entry(x, column, i, value)
        for s in range(t):
            put_entry(x, column, side + s, entry(x, column, side + s) - entry(divided, base + s, i) * value)
