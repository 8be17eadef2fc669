"""Symmetric indefinite factorisation of small matrices with borders, compiled.

A front is the upper triangle of a symmetric matrix, row after row, whose first rows are pivots; those after them are
borders, on which the Schur complement is left; then come columns of right-hand sides. Rows are padded to whole vectors
of ``LANES`` entries, and below the diagonal stands what is never read.
"""

import math
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import extending, types
from numba.core import cgutils

from ....inlined import AS_PART
from .arrays import LANES

# Bounds the growth by one pivot of size two as by two of size one [Bunch, Kaufman 1977].
BALANCE = (1 + math.sqrt(17)) / 8

# Numba's own types know neither all of its options nor that it passes an intrinsic its first argument itself.
njit: Any = numba.njit
intrinsic: Any = extending.intrinsic

# None of these functions allocates: without counts of references they are a third shorter.
compiled = njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract"}, _nrt=False)
inner = njit(error_model="numpy", nogil=True, fastmath={"contract"}, _nrt=False, **AS_PART)
reordered = njit(error_model="numpy", nogil=True, fastmath={"contract", "reassoc"}, _nrt=False, **AS_PART)


@reordered
def dot(x: np.ndarray, first: int, last: int, y: np.ndarray, base: int) -> float:
    """``sum_j x[j] y[base + j]``."""
    total = 0.0
    for j in range(first, last):
        total += x[j] * y[base + j]
    return total


VECTOR = ir.VectorType(ir.DoubleType(), LANES)


def _place(context: Any, builder: Any, kind: Any, array: Any, row: Any, column: Any) -> Any:
    """Where the vector begins that stands in a row of an array from a column on."""
    value = context.make_array(kind)(context, builder, array)
    place = builder.add(builder.mul(row, builder.extract_value(value.shape, 1)), column)
    return builder.bitcast(builder.gep(value.data, [place]), VECTOR.as_pointer())


def _ordered(builder: Any, vector: Any, places: list[int]) -> Any:
    """The vector of the entries in these places."""
    return builder.shuffle_vector(vector, vector, ir.Constant(ir.VectorType(ir.IntType(32), LANES), places))


def _filled(builder: Any, value: Any, kind: Any = VECTOR) -> Any:
    """The vector of one number."""
    first = builder.insert_element(ir.Constant(kind, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    return _ordered(builder, first, [0] * LANES)


def _larger(builder: Any, a: Any, b: Any) -> Any:
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


def _absolute(builder: Any, vector: Any) -> Any:
    kind = ir.FunctionType(VECTOR, [VECTOR])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.fabs.v{LANES}f64"), [vector])


@intrinsic
def add_vector(typing: Any, y: Any, i: Any, j: Any, f: Any, x: Any, k: Any, l: Any) -> Any:  # noqa: E741
    """``y[i, j : j + LANES] += f * x[k, l : l + LANES]`` in one vector: LLVM makes none of a loop whose rows may
    overlap."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        kinds = signature.args
        to, of = (_place(context, builder, kinds[first], *values[first : first + 3]) for first in (0, 4))
        product = builder.fmul(_filled(builder, values[3]), builder.load(of, align=8), flags=("contract",))
        builder.store(builder.fadd(builder.load(to, align=8), product, flags=("contract",)), to, align=8)
        return context.get_dummy_value()

    return types.void(y, types.intp, types.intp, types.float64, x, types.intp, types.intp), generate


@intrinsic
def copy_vector(typing: Any, y: Any, i: Any, j: Any, x: Any, k: Any, l: Any) -> Any:  # noqa: E741
    """``y[i, j : j + LANES] = x[k, l : l + LANES]``."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        to, of = (_place(context, builder, signature.args[first], *values[first : first + 3]) for first in (0, 3))
        builder.store(builder.load(of, align=8), to, align=8)
        return context.get_dummy_value()

    return types.void(y, types.intp, types.intp, x, types.intp, types.intp), generate


def _subtraction(count: int) -> Any:
    """``subtract(y, first, last, j, f, x, k)``: ``y[i, j : j + LANES] -= sum_t f[t, i] * x[k + t, j : j + LANES]``,
    count terms.

    ``i``: the rows from ``first`` to ``last``.
    """

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        y, first, last, j, f, x, k = values
        kinds, one = signature.args, ir.Constant(first.type, 1)
        factors = context.make_array(kinds[4])(context, builder, f)
        width = builder.extract_value(factors.shape, 1)
        terms = []
        for t in range(count):
            number = ir.Constant(first.type, t)
            vector = builder.load(_place(context, builder, kinds[5], x, builder.add(k, number), j), align=8)
            terms.append((builder.gep(factors.data, [builder.mul(number, width)]), vector))
        with cgutils.for_range_slice(builder, first, last, one) as (i, _):
            place = _place(context, builder, kinds[0], y, i, j)
            left = builder.load(place, align=8)
            for row, vector in terms:
                product = builder.fmul(
                    _filled(builder, builder.load(builder.gep(row, [i]))), vector, flags=("contract",)
                )
                left = builder.fsub(left, product, flags=("contract",))
            builder.store(left, place, align=8)
        return context.get_dummy_value()

    def typed(typing: Any, y: Any, first: Any, last: Any, j: Any, f: Any, x: Any, k: Any) -> Any:
        return types.void(y, types.intp, types.intp, types.intp, f, x, types.intp), generate

    return intrinsic(typed)


subtract_one, subtract_two = _subtraction(1), _subtraction(2)


@intrinsic
def largest_in_row(typing: Any, v: Any, r: Any, first: Any, last: Any) -> Any:
    """The largest size of the entries of a row from ``first`` to ``last``, zero if there are none."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        v, r, first, last = values
        index = ir.VectorType(first.type, LANES)
        none, found = ir.Constant(VECTOR, None), cgutils.alloca_once_value(builder, ir.Constant(VECTOR, None))
        begin, step = builder.and_(first, ir.Constant(first.type, -LANES)), ir.Constant(first.type, LANES)
        low, high = (_filled(builder, bound, index) for bound in (first, last))
        with cgutils.for_range_slice(builder, begin, last, step) as (j, _):
            places = builder.add(_filled(builder, j, index), ir.Constant(index, list(range(LANES))))
            inside = builder.and_(builder.icmp_signed(">=", places, low), builder.icmp_signed("<", places, high))
            entries = builder.load(_place(context, builder, signature.args[0], v, r, j), align=8)
            sizes = builder.select(inside, _absolute(builder, entries), none)
            builder.store(_larger(builder, sizes, builder.load(found)), found)
        vector, width = builder.load(found), LANES
        while width > 1:  # the two halves of what is left
            width //= 2
            order = [t % width for t in range(LANES)], [width + t % width for t in range(LANES)]
            vector = _larger(builder, *(_ordered(builder, vector, places) for places in order))
        return builder.extract_element(vector, ir.Constant(ir.IntType(32), 0))

    return types.float64(v, types.intp, types.intp, types.intp), generate


@intrinsic
def swap_vectors(typing: Any, v: Any, k: Any, r: Any, j: Any) -> Any:
    """Exchange ``v[k, j : j + LANES]`` and ``v[r, j : j + LANES]``."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        v, k, r, j = values
        places = [_place(context, builder, signature.args[0], v, row, j) for row in (k, r)]
        vectors = [builder.load(place, align=8) for place in places]
        for place, vector in zip(places, reversed(vectors), strict=True):
            builder.store(vector, place, align=8)
        return context.get_dummy_value()

    return types.void(v, types.intp, types.intp, types.intp), generate


@intrinsic
def scale_row(typing: Any, v: Any, i: Any, f: Any, u: Any) -> Any:
    """``v[i, j] *= f u[j]`` from the vector of the diagonal on."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        v, i, f, _ = values
        array, sizes = (context.make_array(signature.args[t])(context, builder, values[t]) for t in (0, 3))
        begin, step = builder.and_(i, ir.Constant(i.type, -LANES)), ir.Constant(i.type, LANES)
        factor = _filled(builder, f)
        with cgutils.for_range_slice(builder, begin, builder.extract_value(array.shape, 1), step) as (j, _):
            place = _place(context, builder, signature.args[0], v, i, j)
            of = builder.load(builder.bitcast(builder.gep(sizes.data, [j]), VECTOR.as_pointer()), align=8)
            builder.store(builder.fmul(builder.load(place, align=8), builder.fmul(factor, of)), place, align=8)
        return context.get_dummy_value()

    return types.void(v, types.intp, types.float64, u), generate


@intrinsic
def raise_to(typing: Any, y: Any, v: Any, i: Any, f: Any, first: Any, last: Any) -> Any:
    """``y[j] = max(y[j], f |v[i, j]|)`` in the vectors from that of ``first`` up to ``last``."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        y, v, i, f, first, last = values
        sizes, size = context.make_array(signature.args[0])(context, builder, y).data, _filled(builder, f)
        begin, step = builder.and_(first, ir.Constant(first.type, -LANES)), ir.Constant(first.type, LANES)
        with cgutils.for_range_slice(builder, begin, last, step) as (j, _):
            place = builder.bitcast(builder.gep(sizes, [j]), VECTOR.as_pointer())
            entries = builder.load(_place(context, builder, signature.args[1], v, i, j), align=8)
            new = builder.fmul(_absolute(builder, entries), size)
            builder.store(_larger(builder, new, builder.load(place, align=8)), place, align=8)
        return context.get_dummy_value()

    return types.void(y, v, types.intp, types.float64, types.intp, types.intp), generate


@inner
def _beside(v: np.ndarray, r: int, first: int, last: int) -> float:
    """Size of the largest entry beside the diagonal in row r of what is left to factorise."""
    size = largest_in_row(v, r, r + 1, last)
    for i in range(first, r):
        size = abs(v[i, r]) if abs(v[i, r]) > size else size
    return size


@inner
def _where(v: np.ndarray, r: int, first: int, last: int, size: float) -> int:
    """The place of the entry of this size."""
    for i in range(first, r):
        if abs(v[i, r]) == size:
            return i
    for j in range(r + 1, last):
        if abs(v[r, j]) == size:
            return j
    return r


@inner
def _chosen(v: np.ndarray, k: int, last: int) -> tuple[int, int]:
    """Rows of the next pivot, equal where it is of size one: the entry is the largest in both its rows.

    Such a search bounds the factor, so that the smallest pivot tells how near to singular the matrix is; that of Bunch
    and Kaufman does not [Ashcraft, Grimes, Lewis 1998].
    """
    i, r, size = k, k, -1.0
    while True:
        larger = _beside(v, r, k, last)
        if abs(v[r, r]) >= BALANCE * larger:
            return r, r
        if not larger > size:
            return i, r
        i, r, size = r, _where(v, r, k, last, larger), larger


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
    whole = (r + LANES) & -LANES
    for j in range(r + 1, whole):
        v[k, j], v[r, j] = v[r, j], v[k, j]
    for j in range(whole, v.shape[1], LANES):
        swap_vectors(v, k, r, j)


@inner
def _eliminated(v: np.ndarray, f: np.ndarray, k: int, width: int, rows: int) -> None:
    """Subtract what the pivot of one or two rows from k on explains of the rows after it; ``f``: room for two columns.

    The inverse of a pivot of two is formed relative to the entry beside the diagonal, the largest.
    """
    h = k + width - 1
    inverse = 1 / v[k, h]
    a, c = v[k, k] * inverse, v[h, h] * inverse
    both = inverse / (a * c - 1)
    for i in range(h + 1, rows):
        f[0, i] = v[k, i] * inverse if width == 1 else both * (c * v[k, i] - v[h, i])
        f[1, i] = both * (a * v[h, i] - v[k, i])
    for j in range((h + 1) & -LANES, v.shape[1], LANES):
        if width == 1:
            subtract_one(v, h + 1, min(rows, j + LANES), j, f, v, k)
        else:
            subtract_two(v, h + 1, min(rows, j + LANES), j, f, v, k)


@inner
def factorise(v: np.ndarray, f: np.ndarray, swaps: np.ndarray, last: int, rows: int) -> tuple[int, float]:
    """Factorise the first ``last`` of the rows in place, and the number of negative pivots and the size of the
    smallest.

    ``swaps``: the row exchanged with each, as -1 - row in a pivot of size two; ``f``: room for two rows.
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
        _eliminated(v, f, k, width, rows)
        k += width
        size = abs(a)
        if width == 2:
            large = (abs(a + c) + math.sqrt((a - c) * (a - c) + 4 * b * b)) / 2
            size = abs(a * (c / large) - b * (b / large))
        negative += 1 if width == 2 or a < 0 else 0
        if size < smallest or size != size:
            smallest = size
    return negative, smallest


@inner
def scale(v: np.ndarray, f: np.ndarray, u: np.ndarray, z: int, last: int) -> None:
    """Scale the first ``last`` rows and columns to one size, by the factors that are left in ``u``, else ones.

    First come z unknowns, measured by their largest entries, then equations, by the unknowns in their sizes: so weights
    in the Hessian of the unknowns do not make them small. ``f``: room for two rows.
    """
    for i in range(u.size):
        u[i], f[0, i], f[1, i] = 1.0, 0.0, 0.0
    for i in range(z):
        raise_to(f[0], v, i, 1.0, i, last)
        size = max(f[0, i], largest_in_row(v, i, i, last))
        if size > 0:
            u[i] = 1 / math.sqrt(size)
            raise_to(f[1], v, i, u[i], z, last)
    for i in range(z, last):
        f[0, i] = 0.0
    for i in range(z, last):
        raise_to(f[0], v, i, 1.0, i, last)
        size = max(f[1, i], math.sqrt(max(f[0, i], largest_in_row(v, i, i, last))))
        if size > 0:
            u[i] = 1 / size
    for i in range(last):
        scale_row(v, i, u[i], u)


@inner
def substitute(rows: np.ndarray, bases: np.ndarray, swaps: np.ndarray, x: np.ndarray, last: int, side: int) -> None:
    """Solve for the first ``last`` entries of ``x``, whose others, those of the borders, are known.

    ``rows`` are factorised rows one after the other, entry ``j`` of row ``k`` at ``bases[k] + j``; ``side``: the column
    of the right-hand side.
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
