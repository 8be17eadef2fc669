"""Compiled loops of condensing: the chart velocities of a step as affine functions of its state and controls.

A step is written ``nu = N w + nu_0`` with ``w = (dx, du)``; the columns of ``nu_0`` stand after those of ``N`` in one
array.
"""

import numpy as np

from .arrays import LANES
from .factorisation import subtract_all
from .lu import back_substitute, decompose, solve_transposed
from .vectors import add_vector, compiled, entry, filled, inner, minus, put, put_entry, vector

Arrays = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Table = tuple[np.ndarray, np.ndarray, np.ndarray]


@inner
def _assemble(v: np.ndarray, start: int, t: int, points: Arrays, table: Table) -> None:
    """The equations of all points, ``[C_nu | -C_w | -d]``; the right-hand sides start at a whole vector."""
    (_, constraints, _, defect), (h, matrix, _) = points, table
    (s, n, q), columns = constraints.shape[1:], defect.shape[3]
    m = q - 3 * n
    for i in range(s):
        own, lacking = constraints[t, i], defect[t, i]
        for a in range(n):
            r = i * n + a
            for j in range(0, v.shape[1], LANES):
                put(v, r, j, filled(0.0))
            for j in range(s):
                f = h[t] * matrix[i, j]
                for b in range(n):
                    put_entry(v, r, j * n + b, f * entry(own, a, n + b))
            for b in range(n):
                put_entry(v, r, i * n + b, entry(v, r, i * n + b) + entry(own, a, 2 * n + b))
                put_entry(v, r, start + b, -entry(own, a, b))
            for b in range(m):
                put_entry(v, r, start + n + i * m + b, -entry(own, a, 3 * n + b))
            for j in range(columns):
                put_entry(v, r, start + n + s * m + j, -entry(lacking, a, j))


@inner
def _map(x: np.ndarray, v: np.ndarray, start: int, h: float, weights: np.ndarray, sizes: tuple[int, int, int]) -> None:
    """``(dx, sum_j h weights_j nu_j, nu_i, u_i)`` as affine functions of ``w``; the last two of point i, if there is
    one."""
    n, m, i = sizes
    for a in range(x.shape[0]):
        for j in range(0, x.shape[1], LANES):
            put(x, a, j, filled(0.0))
    for a in range(n):
        put_entry(x, a, a, 1.0)
        for j in range(0, x.shape[1], LANES):
            for k in range(weights.size):
                add_vector(x, n + a, j, h * weights[k], v, k * n + a, start + j)
            if i >= 0:
                add_vector(x, 2 * n + a, j, 1.0, v, i * n + a, start + j)
    if i >= 0:
        for b in range(m):
            put_entry(x, 3 * n + b, n + i * m + b, 1.0)


@inner
def _pull(
    out: np.ndarray, y: np.ndarray, block: np.ndarray, slope: np.ndarray, x: np.ndarray, sizes: tuple[int, int, int]
) -> None:
    """Add ``x' (block x + slope)``: the upper triangle of the condensed Hessian, and the condensed slope after it.

    ``block`` is symmetric. In the rows of ``dx`` and ``u_i`` there is nothing but ones in ``x``; ``y = -(block x +
    slope)``.
    """
    (n, m, i), (z, width), size = sizes, out.shape, block.shape[0]
    controls, last = n + i * m, 3 * n if i >= 0 else 2 * n
    for a in range(size):
        for j in range(0, width, LANES):
            put(y, a, j, filled(0.0))
        for c in range(n):
            put_entry(y, a, c, -entry(block, a, c))
        for c in range(3 * n, size):
            put_entry(y, a, controls + c - 3 * n, -entry(block, a, c))
        for j in range(slope.shape[1]):
            put_entry(y, a, z + j, -entry(slope, a, j))
    subtract_all(y, 0, size, 0, width, block, n, x, n, last - n)
    for j in range(0, width, LANES):
        for a in range(n):
            put(out, a, j, minus(vector(out, a, j), vector(y, a, j)))
        for c in range(3 * n, size):
            put(out, controls + c - 3 * n, j, minus(vector(out, controls + c - 3 * n, j), vector(y, c, j)))
    for first in range(0, z, LANES):
        subtract_all(out, first, min(first + LANES, z), first, width, x, n, y, n, last - n)


@inner
def _moved(y: np.ndarray, block: np.ndarray, x: np.ndarray) -> None:
    """``y = block x`` at an end of the step, where the first half of the rows of ``x`` are those of ``dx``."""
    n = block.shape[0]
    for a in range(n):
        for j in range(0, x.shape[1], LANES):
            put(y, a, j, filled(0.0))
        for c in range(n):
            put_entry(y, a, c, entry(block, a, c))
    for c in range(n, 2 * n):  # row after row of ``y``: the next one does not wait for what is added to this
        for a in range(n):
            for j in range(0, x.shape[1], LANES):
                add_vector(y, a, j, entry(block, a, c), x, c, j)


@inner
def _store(y: np.ndarray, matrix: np.ndarray, columns: np.ndarray) -> None:
    (rows, z), k = matrix.shape, columns.shape[1]
    for a in range(rows):
        for j in range(z):
            put_entry(matrix, a, j, entry(y, a, j))
        for j in range(k):
            put_entry(columns, a, j, entry(y, a, z + j))


@compiled
def condense(
    first: int, last: int, points: Arrays, ends: Arrays, table: Table, work: tuple, kept: tuple, out: tuple
) -> None:
    """Condense the steps ``first`` to ``last``.

    ``points``: Hessian, constraints, slope, defect; ``ends``: Hessian, left, right, slope; ``table``: step sizes,
    centred matrix and weights; ``kept``: factors of ``C_nu``, their swaps, and ``[N | nu_0]``; ``out``: Hessian, left,
    right, slope, and the shares of ``nu_0`` in the gaps before and after.
    """
    (v, x, y, weights, total), (h, matrix, b), (s, n, q) = work, table, points[1].shape[1:]
    m, start = q - 3 * n, v.shape[1] - total.shape[1]
    for t in range(first, last):
        _assemble(v, start, t, points, table)
        decompose(v, kept[1][t], kept[0][t], weights)
        back_substitute(v, start, kept[0][t])
        for i in range(s * n):
            for j in range(0, total.shape[1], LANES):
                put(kept[2][t], i, j, vector(v, i, start + j))
        for i in range(total.shape[0]):
            for j in range(0, total.shape[1], LANES):
                put(total, i, j, filled(0.0))
        for i in range(s + 1):
            at_ends = i == s
            _map(x, v, start, h[t], b if at_ends else matrix[i], (n, m, -1 if at_ends else i))
            block, slope = (ends[0][t], ends[3][t]) if at_ends else (points[0][t, i], points[2][t, i])
            _pull(total, y, block, slope, x, (n, m, -1 if at_ends else i))
        for i in range(total.shape[0]):
            for j in range(i):
                put_entry(total, i, j, entry(total, j, i))
        _store(total, out[0][t], out[3][t])
        for i in range(2):
            _moved(y, ends[1][t] if i == 0 else ends[2][t], x)
            _store(y, out[1][t] if i == 0 else out[2][t], out[4][t] if i == 0 else out[5][t])


@inner
def place(
    e: np.ndarray, w: np.ndarray, nu: np.ndarray, h: float, weights: np.ndarray, sizes: tuple[int, int, int]
) -> None:
    """``(dx, sum_j weights_j nu_j, nu_i, u_i)``; the last two of point i, if there is one."""
    n, m, i = sizes
    for a in range(n):
        e[a], e[n + a] = w[a], 0.0
        for j in range(weights.size):
            e[n + a] += h * weights[j] * nu[j * n + a]
    if i >= 0:
        for a in range(n):
            e[2 * n + a] = nu[i * n + a]
        for b in range(m):
            e[3 * n + b] = w[n + i * m + b]


@inner
def _push(
    x: np.ndarray,
    e: np.ndarray,
    block: np.ndarray,
    slope: np.ndarray,
    h: float,
    weights: np.ndarray,
    sizes: tuple[int, int, int],
) -> None:
    """Add the rows of the chart velocities in ``block e + slope``."""
    n, _, i = sizes
    for a in range(n):
        value = slope[n + a]
        for c in range(block.shape[1]):
            value += block[n + a, c] * e[c]
        for j in range(weights.size):
            x[j * n + a] += h * weights[j] * value
        if i >= 0:
            value = slope[2 * n + a]
            for c in range(block.shape[1]):
                value += block[2 * n + a, c] * e[c]
            x[i * n + a] += value


@compiled
def expand(
    first: int,
    last: int,
    points: Arrays,
    ends: Arrays,
    table: Table,
    work: tuple,
    kept: tuple,
    solved: tuple,
    out: tuple,
) -> None:
    """Chart velocities and multipliers of the points of the steps ``first`` to ``last``, one column.

    ``solved``: steps of the unknowns and of the multipliers before and after each step, which column of what is kept
    has ``nu_0``, and the columns of the slopes of points and ends; ``out``: ``dnu`` and ``dlambda``.
    """
    (h, matrix, b), (w, before, after, column, slopes, pulls), (s, n, q) = table, solved, points[1].shape[1:]
    (e, x, pull), m = work, q - 3 * n
    for t in range(first, last):
        nu = out[0][t]
        for i in range(s * n):
            nu[i], x[i] = kept[2][t, i, column], 0.0
            for j in range(w.shape[1]):
                nu[i] += kept[2][t, i, j] * w[t, j]
        for c in range(n, 2 * n):  # the rows of what was condensed
            pull[c] = pulls[t, c]
            for a in range(n):
                pull[c] += ends[1][t, a, c] * before[t, a] - ends[2][t, a, c] * after[t, a]
        for i in range(s + 1):
            at_ends = i == s
            weights, sizes = b if at_ends else matrix[i], (n, m, -1 if at_ends else i)
            place(e, w[t], nu, h[t], weights, sizes)
            block, slope = (ends[0][t], pull) if at_ends else (points[0][t, i], slopes[t, i])
            _push(x, e, block, slope, h[t], weights, sizes)
        solve_transposed(kept[0][t], kept[1][t], x)
        for i in range(s * n):
            out[1][t, i] = -x[i]


@compiled
def slopes(
    first: int, last: int, own: tuple, pull: np.ndarray, maps: np.ndarray, table: Table, inside: tuple, out: tuple
) -> None:
    """The slopes of the steps ``first`` to ``last`` by the velocities, and by what is left of their unknowns.

    ``own``: slopes by the unknowns of the points, of the Lagrangian and of the cost alone; ``pull``: the first one's by
    ``(dx, deta)`` of the ends; ``maps``: the velocities as functions of what is left; ``inside``, ``out``: of both.
    """
    (h, matrix, weights), (_, s, q), n = table, own[0].shape, pull.shape[1] // 2
    m, z = q - 3 * n, n + s * (q - 3 * n)
    for t in range(2):
        slope, inner_slope, outer = own[t], inside[t], out[t]
        for k in range(first, last):
            for a in range(n):
                outer[k, a] = pull[k, a] if t == 0 else 0.0
                for i in range(s):
                    outer[k, a] += slope[k, i, a]
            for i in range(s):
                for b in range(m):
                    outer[k, n + i * m + b] = slope[k, i, 3 * n + b]
            for i in range(s):
                for a in range(n):
                    total = h[k] * weights[i] * pull[k, n + a] if t == 0 else 0.0
                    for j in range(s):
                        total += h[k] * matrix[j, i] * slope[k, j, n + a]
                    total += slope[k, i, 2 * n + a]
                    inner_slope[k, i * n + a] = total
                    for b in range(z):
                        outer[k, b] += maps[k, i * n + a, b] * total
