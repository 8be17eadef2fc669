"""Symmetric indefinite factorisation of small matrices with borders, compiled.

A front is the upper triangle of a symmetric matrix, row after row, whose first rows are pivots; those after them are borders, on
which the Schur complement is left; then come columns of right-hand sides. Rows are padded to whole vectors of ``LANES`` entries,
and below the diagonal stands what is never read.
"""

import math
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import extending, types

from .arrays import LANES

BALANCE = (1 + math.sqrt(17)) / 8  # bounds the growth by one pivot of size two as by two of size one [Bunch, Kaufman 1977]

# Numba's own types know neither all of its options nor that it passes an intrinsic its first argument itself.
njit: Any = numba.njit
intrinsic: Any = extending.intrinsic

# None of these functions allocates: without counts of references they are a third shorter.
compiled = njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract"}, _nrt=False)
inner = njit(error_model="numpy", nogil=True, fastmath={"contract"}, _nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True)
reordered = njit(
    error_model="numpy", nogil=True, fastmath={"contract", "reassoc"}, _nrt=False, no_cpython_wrapper=True, no_cfunc_wrapper=True
)


@reordered
def dot(x: np.ndarray, first: int, last: int, y: np.ndarray, base: int) -> float:
    """``sum_j x[j] y[base + j]``."""
    total = 0.0
    for j in range(first, last):
        total += x[j] * y[base + j]
    return total


VECTOR = ir.VectorType(ir.DoubleType(), LANES)


def _place(context: Any, builder: Any, signature: Any, values: Any, first: int) -> Any:
    """Where the vector begins whose array, row and column are the arguments from ``first`` on."""
    value = context.make_array(signature.args[first])(context, builder, values[first])
    row = builder.mul(values[first + 1], builder.extract_value(value.shape, 1))
    return builder.bitcast(builder.gep(value.data, [builder.add(row, values[first + 2])]), VECTOR.as_pointer())


@intrinsic
def add_vector(typing: Any, y: Any, i: Any, j: Any, f: Any, x: Any, k: Any, l: Any) -> Any:  # noqa: E741
    """``y[i, j : j + LANES] += f * x[k, l : l + LANES]`` in one vector: LLVM makes none of a loop whose rows may overlap."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        to, of = (_place(context, builder, signature, values, first) for first in (0, 4))
        factor = ir.Constant(VECTOR, ir.Undefined)
        for t in range(LANES):
            factor = builder.insert_element(factor, values[3], ir.Constant(ir.IntType(32), t))
        product = builder.fmul(factor, builder.load(of, align=8), flags=("contract",))
        builder.store(builder.fadd(builder.load(to, align=8), product, flags=("contract",)), to, align=8)
        return context.get_dummy_value()

    return types.void(y, types.intp, types.intp, types.float64, x, types.intp, types.intp), generate


@intrinsic
def copy_vector(typing: Any, y: Any, i: Any, j: Any, x: Any, k: Any, l: Any) -> Any:  # noqa: E741
    """``y[i, j : j + LANES] = x[k, l : l + LANES]``."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        to, of = (_place(context, builder, signature, values, first) for first in (0, 3))
        builder.store(builder.load(of, align=8), to, align=8)
        return context.get_dummy_value()

    return types.void(y, types.intp, types.intp, x, types.intp, types.intp), generate


@inner
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


@inner
def _chosen(v: np.ndarray, k: int, last: int) -> tuple[int, int]:
    """Rows of the next pivot, equal where it is of size one: the entry is the largest in both its rows.

    Such a search bounds the factor, so that the smallest pivot tells how near to singular the matrix is; that of Bunch and
    Kaufman does not [Ashcraft, Grimes, Lewis 1998].
    """
    i, r, size = k, k, -1.0
    while True:
        larger, j = _largest(v, r, k, last)
        if abs(v[r, r]) >= BALANCE * larger:
            return r, r
        if not larger > size:
            return i, r
        i, r, size = r, j, larger


@inner
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


@inner
def _eliminated(v: np.ndarray, k: int, width: int, rows: int) -> None:
    """Subtract what the pivot of one or two rows from k on explains of the rows after it.

    The inverse of a pivot of two is formed relative to the entry beside the diagonal, the largest.
    """
    h = k + width - 1
    inverse = 1 / v[k, h]
    a, c = v[k, k] * inverse, v[h, h] * inverse
    both = inverse / (a * c - 1)
    for i in range(h + 1, rows):
        f, g = v[k, i] * inverse, 0.0
        if width == 2:
            f, g = both * (c * v[k, i] - v[h, i]), both * (a * v[h, i] - v[k, i])
        if f != 0 or g != 0:
            for j in range(i & -LANES, v.shape[1], LANES):
                add_vector(v, i, j, -f, v, k, j)
                if width == 2:
                    add_vector(v, i, j, -g, v, h, j)


@inner
def factorise(v: np.ndarray, swaps: np.ndarray, last: int, rows: int) -> tuple[int, float]:
    """Factorise the first ``last`` of the rows in place, and the number of negative pivots and the size of the smallest.

    ``swaps``: the row exchanged with each, as -1 - row in a pivot of size two.
    """
    negative, smallest, k = 0, np.inf, np.int64(0)
    while k < last:
        i, r = _chosen(v, k, last)
        a, b, c = float(v[i, i]), float(v[min(i, r), max(i, r)]), float(v[r, r])
        width = 1 if i == r else 2
        for t in range(width):
            other = i if t == 0 or r == k else r
            _swap(v, k, k + t, other)
            swaps[k + t] = other if width == 1 else -1 - other
        _eliminated(v, k, width, rows)
        k += width
        large = (abs(a + c) + math.hypot(a - c, 2 * b)) / 2
        size = abs(a) if width == 1 else abs(a * (c / large) - b * (b / large))
        negative += 1 if width == 2 or a < 0 else 0
        if size < smallest or size != size:
            smallest = size
    return negative, smallest


@inner
def _sizes(v: np.ndarray, u: np.ndarray, z: int, last: int) -> None:
    """Sizes of the rows: of unknowns by their largest entry, of the equations after them by the unknowns in their sizes."""
    for i in range(u.size):
        u[i] = 0.0
    for i in range(z):
        largest = u[i]
        for j in range(i, last):
            largest = abs(v[i, j]) if abs(v[i, j]) > largest else largest
            u[j] = abs(v[i, j]) if j < z and abs(v[i, j]) > u[j] else u[j]
        u[i] = math.sqrt(largest)
        inverse = 1 / u[i] if largest > 0 else 0.0
        for j in range(z, last):
            size = abs(v[i, j]) * inverse
            u[j] = size if size > u[j] else u[j]
    for i in range(z, last):
        for j in range(i, last):
            size = math.sqrt(abs(v[i, j]))
            u[i] = size if size > u[i] else u[i]
            u[j] = size if size > u[j] else u[j]


@inner
def scale(v: np.ndarray, u: np.ndarray, z: int, last: int) -> None:
    """Scale the first ``last`` rows and columns to one size, by the factors that are left in ``u``, else ones.

    First come z unknowns. The entries of the equations after them are made one too, so that weights in the Hessian of the
    unknowns do not make them small.
    """
    _sizes(v, u, z, last)
    for i in range(u.size):
        u[i] = 1 / u[i] if u[i] > 0 else 1.0
    for i in range(last):
        for j in range(i, v.shape[1]):
            v[i, j] *= u[i] * u[j]


@inner
def substitute(rows: np.ndarray, bases: np.ndarray, swaps: np.ndarray, x: np.ndarray, last: int, side: int) -> None:
    """Solve for the first ``last`` entries of ``x``, whose others, those of the borders, are known.

    ``rows`` are factorised rows one after the other, entry ``j`` of row ``k`` at ``bases[k] + j``; ``side``: the column of the
    right-hand side.
    """
    k = last - 1
    while k >= 0:
        width = 1 if swaps[k] >= 0 else 2
        h = k - width + 1
        f, g = 0.0, 0.0
        for i in range(h, k + 1):
            f, g = g, rows[bases[i] + side] - dot(x, k + 1, x.size, rows, bases[i])
        inverse = 1 / rows[bases[h] + k]
        a, c = rows[bases[h] + h] * inverse, rows[bases[k] + k] * inverse
        both = inverse / (a * c - 1)
        x[k] = g * inverse if width == 1 else both * (a * g - f)
        if width == 2:
            x[h] = both * (c * f - g)
        for i in range(k, h - 1, -1):
            r = swaps[i] if width == 1 else -1 - swaps[i]
            x[i], x[r] = x[r], x[i]
        k = h - 1
