"""Rules of products, reductions and small factorisations, written out entry by entry."""

import math
from collections.abc import Callable, Sequence
from functools import reduce
from itertools import accumulate
from typing import Any

import casadi as ca
import numpy as np

from .arrays import (
    Complex,
    Entries,
    NotRealError,
    NotTraceableError,
    Scalars,
    column,
    is_complex,
    move_entries,
    parts,
    scalars,
)
from .choice import select
from .complex_rules import product
from .elementwise import larger, smaller

LARGEST_FACTOR = 16  # rows of a matrix that is factorised entry by entry: beyond LAPACK is the better choice


def _operand(
    a: Entries, batch: tuple[int, ...], contracted: tuple[int, ...], first: bool
) -> tuple[Entries, tuple[int, ...]]:
    """The array with axes in the order batch, free, contracted, as matrices; and the sizes of its free axes."""
    free = [axis for axis in range(len(a.shape)) if axis not in batch and axis not in contracted]
    order = [*batch, *free, *contracted] if first else [*batch, *contracted, *free]
    sizes = tuple(a.shape[axis] for axis in free)
    inner = math.prod(a.shape[axis] for axis in contracted)
    outer = math.prod(a.shape[axis] for axis in batch)
    shape = (outer, math.prod(sizes), inner) if first else (outer, inner, math.prod(sizes))
    return move_entries(a, lambda b: np.transpose(b, order).reshape(shape)), sizes


def _matrix(a: Entries, k: int) -> ca.SX:
    """The k-th matrix of a batch."""
    return ca.reshape(
        column(move_entries(a, lambda b: b[k])), a.shape[2], a.shape[1]
    ).T  # CasADi's are column by column


def _dot_general(params: dict[str, Any], x: Entries, y: Entries) -> Entries:
    if is_complex(x) or is_complex(y):
        (a, b), (c, d) = parts(x), parts(y)
        ac, bd, ad, bc = (_dot_general(params, *pair) for pair in ((a, c), (b, d), (a, d), (b, c)))
        return Complex(scalars(column(ac) - column(bd), ac.shape), scalars(column(ad) + column(bc), ac.shape))
    (left, right), (batch_left, batch_right) = params["dimension_numbers"]
    a, rows = _operand(x, batch_left, left, True)
    b, columns = _operand(y, batch_right, right, False)
    products = [ca.vec(ca.mtimes(_matrix(a, k), _matrix(b, k)).T) for k in range(a.shape[0])]
    outer = tuple(x.shape[axis] for axis in batch_left)
    return scalars(products[0] if len(products) == 1 else ca.vertcat(*products), (*outer, *rows, *columns))


Row = tuple[ca.SX, ...]  # one column, or two of complex numbers
OfRows = Callable[[Any, Any], Any]


def _alone(function: Callable[[ca.SX, ca.SX], ca.SX]) -> OfRows:
    """A function of real numbers on both parts of rows, or on the one that there is."""
    return lambda x, y: tuple(function(a, b) for a, b in zip(x, y, strict=True))


_plus = _alone(lambda a, b: a + b)


def _times(x: Row, y: Row) -> Row:
    return product((x[0], x[1]), (y[0], y[1])) if len(x) == 2 else (x[0] * y[0],)


def _of_rows(rule: Callable[..., Sequence[Entries]], real: bool) -> Callable[..., Entries]:
    """The rule of an array, made of the rule of its parts; ``real`` rejects complex arrays."""

    def whole(params: dict[str, Any], x: Entries) -> Entries:
        if not is_complex(x):
            return rule(params, (x,))[0]
        if real:
            raise NotRealError("expected a real array, got a complex one")
        return Complex(*rule(params, parts(x)))

    return whole


def _reduction(function: OfRows, *start: float, real: bool = True) -> Callable[..., Entries]:
    def rule(params: dict[str, Any], halves: tuple[Entries, ...]) -> list[Scalars]:
        given, axes = halves[0].shape, tuple(params["axes"])
        kept = [axis for axis in range(len(given)) if axis not in axes]
        shape = tuple(given[axis] for axis in kept)
        count, size = math.prod(given[axis] for axis in axes), math.prod(shape)
        flat = (move_entries(x, lambda a: np.transpose(a, [*axes, *kept]).reshape(count, size)) for x in halves)
        rows = zip(*(ca.vertsplit(column(x), size) for x in flat), strict=True) if count and size else ()
        empty = [ca.SX.ones(size) * a for a in start[: len(halves)]]
        return [scalars(a, shape) for a in (reduce(function, rows) if count and size else empty)]

    return _of_rows(rule, real)


def _cumulative(function: OfRows, real: bool = True) -> Callable[..., Entries]:
    def rule(params: dict[str, Any], halves: tuple[Entries, ...]) -> list[Entries]:
        if not math.prod(halves[0].shape):
            return list(halves)
        given, axis = halves[0].shape, params["axis"]
        order = range(given[axis])[::-1] if params["reverse"] else range(given[axis])
        along = [tuple(column(move_entries(x, lambda a, k=k: np.take(a, k, axis))) for x in halves) for k in order]
        rows = list(accumulate(along, function))[:: -1 if params["reverse"] else 1]
        shape = (given[axis], *np.delete(given, axis))
        stacked = (scalars(ca.vertcat(*part), shape) for part in zip(*rows, strict=True))
        return [move_entries(x, lambda a: np.moveaxis(a, 0, axis)) for x in stacked]

    return _of_rows(rule, real)


def _extreme(beats: Callable[[ca.SX, ca.SX], ca.SX]) -> Callable[..., Entries]:
    """Place of the first entry that none beats."""

    def rule(params: dict[str, Any], x: Entries) -> Entries:
        (axis,) = params["axes"]
        rows = [column(move_entries(x, lambda a, k=k: np.take(a, k, axis))) for k in range(x.shape[axis])]
        best, place = rows[0], ca.SX.zeros(rows[0].shape[0])
        for k, row in enumerate(rows[1:], 1):
            place, best = select(beats(row, best), k, place), select(beats(row, best), row, best)
        return scalars(place, tuple(np.delete(x.shape, axis)))

    return rule


def matrices(a: Entries) -> list[ca.SX]:
    """The matrices of a batch, one after the other."""
    flat: Any = move_entries(a, lambda b: b.reshape(-1, *a.shape[-2:]))
    return [_matrix(flat, k) for k in range(flat.shape[0])]


def batch(found: list[ca.SX], outer: tuple[int, ...]) -> Scalars:
    """The array of these matrices, with the axes ``outer`` before theirs."""
    shape = (*outer, *found[0].shape) if found else (*outer, 0, 0)
    return scalars(ca.vertcat(*(ca.vec(ca.densify(m).T) for m in found)), shape)


def _require(name: str, rows: int, *arrays: Entries) -> None:
    if rows > LARGEST_FACTOR:
        raise NotTraceableError(
            name, f"here of a matrix of {rows} rows, where at most {LARGEST_FACTOR} are written out"
        )
    if any(is_complex(a) for a in arrays):
        raise NotTraceableError(name, "here of complex numbers")


def _cholesky(params: dict[str, Any], x: Any) -> Entries:
    _require("cholesky", x.shape[-1], x)

    def factor(s: ca.SX) -> ca.SX:
        f = ca.SX.zeros(*s.shape)
        for j in range(s.shape[0]):
            f[j, j] = ca.sqrt(s[j, j] - ca.sumsqr(f[j, :j]))
            for i in range(j + 1, s.shape[0]):
                f[i, j] = (s[i, j] - ca.dot(f[i, :j], f[j, :j])) / f[j, j]
        return f

    return batch([factor(s) for s in matrices(x)], x.shape[:-2])


def _triangular_solve(params: dict[str, Any], x: Any, y: Any) -> Entries:
    _require("triangular_solve", x.shape[-1], x, y)
    left, unit = params["left_side"], params["unit_diagonal"]
    transposed = params["transpose_a"] == left  # X A = B is A' X' = B'
    lower = params["lower"] != transposed
    found = []
    for a, b in zip(matrices(x), matrices(y), strict=True):
        value = substitute(a.T if transposed else a, b if left else b.T, lower, unit)
        found.append(value if left else value.T)
    return batch(found, y.shape[:-2])


def substitute(matrix: ca.SX, right: ca.SX, lower: bool, unit: bool) -> ca.SX:
    """Solution of a triangular system with several right sides."""
    n = matrix.shape[0]
    found = ca.SX(right)
    for i in range(n) if lower else reversed(range(n)):
        known = slice(0, i) if lower else slice(i + 1, n)
        row = right[i, :] - ca.mtimes(matrix[i, known], found[known, :])
        found[i, :] = row if unit else row / matrix[i, i]
    return found


def factorise(matrix: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """``L`` and ``U`` in one matrix, interchanges and permutation, with partial pivoting as LAPACK does it."""
    a, n = ca.densify(matrix), matrix.shape[0]
    width = min(matrix.shape)
    order, pivots = ca.SX(ca.DM(range(n))), ca.SX.zeros(width)
    for k in range(width):
        best, place = ca.fabs(a[k, k]), ca.SX(k)
        for i in range(k + 1, n):
            bigger = ca.fabs(a[i, k]) > best
            place, best = select(bigger, i, place), select(bigger, ca.fabs(a[i, k]), best)
        pivots[k] = place
        for i in range(k + 1, n):
            for rows in (a, order):
                top, low = rows[k, :], rows[i, :]
                rows[k, :], rows[i, :] = select(place == i, low, top), select(place == i, top, low)
        for i in range(k + 1, n):
            a[i, k] = a[i, k] / a[k, k]
            a[i, k + 1 :] = a[i, k + 1 :] - a[i, k] * a[k, k + 1 :]
    return a, pivots, order


def _lu(params: dict[str, Any], x: Any) -> list[Entries]:
    _require("lu", x.shape[-2], x)
    factors, pivots, orders = zip(*map(factorise, matrices(x)), strict=True)
    outer = x.shape[:-2]
    columns = (scalars(ca.vertcat(*part), (*outer, part[0].shape[0])) for part in (pivots, orders))
    return [batch(list(factors), outer), *columns]


def inverse(matrix: ca.SX) -> ca.SX:
    """Inverse of a matrix, by blocks that no entry couples."""
    found = ca.SX(*matrix.shape)
    for block in _blocks(matrix):
        _require("custom_linear_solve", len(block))
        factors, _, order = factorise(matrix[block, block])
        n = len(block)
        units = ca.vertcat(*(ca.horzcat(*(order[i] == j for j in range(n))) for i in range(n)))
        lower = substitute(factors, units, lower=True, unit=True)
        found[block, block] = substitute(factors, lower, lower=False, unit=False)
    return found


def _blocks(matrix: ca.SX) -> list[list[int]]:
    """Indices that nonzero entries of a square matrix connect, in groups."""
    group = list(range(matrix.shape[0]))
    for i, j in zip(*matrix.sparsity().get_triplet(), strict=True):
        if group[i] != group[j]:
            old, new = group[i], group[j]
            group = [new if g == old else g for g in group]
    return [[k for k, g in enumerate(group) if g == name] for name in dict.fromkeys(group)]


def _qr(params: dict[str, Any], x: Any) -> list[Entries]:
    """Householder's reflections with the signs of LAPACK."""
    if params.get("pivoting"):
        raise NotTraceableError("qr", "here with pivoting")
    m, n = x.shape[-2:]
    _require("qr", m, x)
    width = m if params["full_matrices"] else min(m, n)
    found = [_householder(a) for a in matrices(x)]
    outer = x.shape[:-2]
    return [batch([q[:, :width] for q, _ in found], outer), batch([r[:width, :] for _, r in found], outer)]


def _householder(matrix: ca.SX) -> tuple[ca.SX, ca.SX]:
    m, n = matrix.shape
    r, q = ca.densify(matrix), ca.densify(ca.SX.eye(m))
    for k in range(min(m - 1, n)):
        below, square = ca.sum1(ca.fabs(r[k + 1 :, k])), ca.sumsqr(r[k:, k])
        none = square == 0
        size = ca.sqrt(select(none, 1.0, square))
        head = select(none, 0.0, select(r[k, k] < 0, size, -size))
        direction = ca.vertcat(1, r[k + 1 :, k] / select(none, 1.0, r[k, k] - head))
        factor = select(none, 0.0, (head - r[k, k]) / select(none, 1.0, head))
        r[k:, :] -= factor * ca.mtimes(direction, ca.mtimes(direction.T, r[k:, :]))
        q[:, k:] -= factor * ca.mtimes(ca.mtimes(q[:, k:], direction), direction.T)
        # LAPACK leaves a column alone that is zero below: the same but for its sign, and with derivatives as others.
        turned = select(ca.logic_or(below > 0, none), 1.0, -1.0)
        r[k, :] *= turned
        q[:, k] *= turned
    return q, ca.triu(r)


LINEAR: dict[str, Callable[..., Entries | list[Entries]]] = {
    "argmax": _extreme(lambda a, b: a > b),
    "argmin": _extreme(lambda a, b: a < b),
    "cholesky": _cholesky,
    "cummax": _cumulative(_alone(larger)),
    "cummin": _cumulative(_alone(smaller)),
    "cumprod": _cumulative(_times, real=False),
    "cumsum": _cumulative(_plus, real=False),
    "dot_general": _dot_general,
    "lu": _lu,
    "qr": _qr,
    "reduce_and": _reduction(_alone(ca.logic_and), 1.0),
    "reduce_max": _reduction(_alone(larger), -np.inf),
    "reduce_min": _reduction(_alone(smaller), np.inf),
    "reduce_or": _reduction(_alone(ca.logic_or), 0.0),
    "reduce_prod": _reduction(_times, 1.0, 0.0, real=False),
    "reduce_sum": _reduction(_plus, 0.0, 0.0, real=False),
    "triangular_solve": _triangular_solve,
}
