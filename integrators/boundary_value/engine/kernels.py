"""Compiled loops of the block elimination: the steps of one trajectory after the other.

The front of a step has the rows ``d_k`` and ``c_k``, which are eliminated, and ``c_{k+1}``, on which they leave their Schur
complement: those of the next step. At the last step all are eliminated.
"""

import numpy as np

from .arrays import LANES
from .factors import add_vector, compiled, dot, factorise, inner, scale, substitute

System = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Sizes = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Work = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@inner
def _load_node(work: Work, m: int, k: int, system: System, sizes: Sizes) -> None:
    """Rows of ``c_k``: what the step before left on the node, and those of the next node, still zero."""
    (v, _, _, gaps), gap, nodes = work, system[4], sizes[1]
    count, (n, z), columns = system[1].shape[1], system[1].shape[2:], gap.shape[3]
    p = z + n
    for a in range(n):
        fixed = system[5][m, a] if k == 0 else (system[6][m, a] if k == count else 1.0)
        for j in range(columns):
            gaps[j, a] = gap[m, k, a, j] * (fixed / nodes[m, a])
    if k == count:
        for a in range(n):
            for j in range(columns):
                v[p + a, p + n + j] = -gaps[j, a]
            v[p + a, p + a] = system[6][m, a] - 1
        return
    for a in range(n):
        for b in range(a, n):
            v[z + a, z + b] = v[p + a, p + b]
        for j in range(columns):
            v[z + a, p + n + j] = v[p + a, p + n + j] - gaps[j, a]
        for b in range(n):
            v[z + a, p + b] = 0.0
        for j in range(z, v.shape[1]):
            v[p + a, j] = 0.0


@inner
def _load_constraints(work: Work, m: int, k: int, system: System, sizes: Sizes) -> None:
    """``left`` and ``right`` of a step in units, without the equations of free coordinates."""
    _, left, right, _ = work
    unknowns, nodes, (n, z) = sizes[0], sizes[1], system[1].shape[2:]
    for a in range(n):
        f = (system[5][m, a] if k == 0 else 1.0) / nodes[m, a]
        g = (system[6][m, a] if k == system[1].shape[1] - 1 else 1.0) / nodes[m, a]
        for j in range(z):
            left[a, j] = system[1][m, k, a, j] * (unknowns[m, j] * f)
            right[a, j] = system[2][m, k, a, j] * (unknowns[m, j] * g)


@inner
def _hold(v: np.ndarray, right: np.ndarray, left: np.ndarray, z: int, weight: float) -> None:
    """Add ``weight (right' right - left' left)`` to the Hessian; both constraints are padded with zeros to whole vectors."""
    for a in range(right.shape[0]):
        for i in range(z):
            f, g = weight * right[a, i], weight * left[a, i]
            for j in range(i & -LANES, right.shape[1], LANES):
                add_vector(v, i, j, f, right, a, j)
                add_vector(v, i, j, -g, left, a, j)


@inner
def _load_step(work: Work, m: int, k: int, system: System, sizes: Sizes, shift: np.ndarray, weight: float) -> None:
    """Rows of ``d_k``."""
    (v, left, right, gaps), (unknowns, _, cost, scales) = work, sizes
    hessian, slope, (n, z), columns = system[0], system[3], system[1].shape[2:], system[3].shape[3]
    p = z + n
    for i in range(z):
        f = unknowns[m, i] / cost[m]
        for j in range(z):
            v[i, j] = hessian[m, k, i, j] * (f * unknowns[m, j])
        v[i, i] += shift[m] * scales[m, i]
    _hold(v, right, left, z, weight)
    for i in range(z):
        f = unknowns[m, i] / cost[m]
        for a in range(n):
            v[i, z + a], v[i, p + a] = left[a, i], -right[a, i]
        for j in range(columns):
            side = -slope[m, k, i, j] * f
            for a in range(n):
                side += weight * left[a, i] * gaps[j, a]
            v[i, p + n + j] = side


@inner
def _keep(v: np.ndarray, rows: np.ndarray, bases: np.ndarray, last: int) -> None:
    for k in range(last):
        for j in range(k // LANES * LANES, v.shape[1]):
            rows[bases[k] + j] = v[k, j]


@compiled
def forward(m: int, system: System, sizes: Sizes, shift: np.ndarray, weight: float, work: Work, factors: tuple) -> tuple:
    """Factorise member m step after step; the number of negative pivots and the size of the smallest."""
    (v, _, _, _), (rows, bases, units, swaps) = work, factors
    count, (n, z) = system[1].shape[1], system[1].shape[2:]
    negative, smallest = 0, np.inf
    for a in range(n):
        for j in range(z, v.shape[1]):
            v[z + n + a, j] = 0.0
        v[z + n + a, z + n + a] = system[5][m, a] - 1
    for k in range(count):
        last = z + n + (n if k == count - 1 else 0)
        _load_node(work, m, k, system, sizes)
        _load_constraints(work, m, k, system, sizes)
        _load_step(work, m, k, system, sizes, shift, weight)
        if k == count - 1:
            _load_node(work, m, count, system, sizes)
        scale(v, units[k], last)
        found, size = factorise(v, swaps[k], last, z + 2 * n)
        negative += found
        if size < smallest or size != size:
            smallest = size
        _keep(v, rows[k], bases, last)
    return negative, smallest


@inner
def _curvature(m: int, system: System, sizes: Sizes, shift: np.ndarray, steps: np.ndarray) -> tuple[float, float]:
    """``d' H d`` with the shifted Hessian and ``d' S d`` with the scales, for the first column."""
    (unknowns, _, cost, scales), z = sizes, steps.shape[2]
    curvature, size, d, zero = 0.0, 0.0, np.empty(z), np.int64(0)
    for k in range(steps.shape[1]):
        for i in range(z):
            d[i] = steps[m, k, i, 0] * unknowns[m, i]
            size += steps[m, k, i, 0] * scales[m, i] * steps[m, k, i, 0]
        for i in range(z):
            row = system[0][m, k, i]
            curvature += d[i] * (2 * dot(row, i + 1, z, d, zero) + row[i] * d[i])
    return curvature / cost[m] + shift[m] * size, size


@inner
def _refuse(m: int, steps: np.ndarray, multipliers: np.ndarray) -> None:
    """NaN everywhere in the columns that are not finite somewhere."""
    for j in range(steps.shape[3]):
        total = 0.0
        for k in range(multipliers.shape[1]):
            for a in range(multipliers.shape[2]):
                total += 0 * multipliers[m, k, a, j]
        for k in range(steps.shape[1]):
            for i in range(steps.shape[2]):
                total += 0 * steps[m, k, i, j]
        if total != 0:
            steps[m, :, :, j] = np.nan
            multipliers[m, :, :, j] = np.nan


@compiled
def backward(
    m: int, system: System, sizes: Sizes, shift: np.ndarray, weight: float, work: Work, factors: tuple, out: tuple
) -> tuple:
    """Steps and multipliers of member m from the last to the first; curvature and size of the first column.

    The weights' share is taken out of the multipliers.
    """
    (_, _, right, x), (rows, bases, units, swaps), (steps, multipliers) = work, factors, out
    count, (n, z), zero = system[1].shape[1], system[1].shape[2:], np.int64(0)
    p = z + n
    for k in range(count - 1, -1, -1):
        last = p + n if k == count - 1 else p
        _load_constraints(work, m, k, system, sizes)
        for j in range(steps.shape[3]):
            for a in range(p, p + n):
                x[j, a] = x[j, a - n]
            substitute(rows[k], bases, swaps[k], x[j], last, p + n + j)
            for i in range(last):
                x[j, i] *= units[k, i]
            for i in range(z):
                steps[m, k, i, j] = x[j, i]
            for a in range(n):
                multipliers[m, k + 1, a, j] = x[j, p + a] - weight * dot(x[j], zero, z, right[a], zero)
    for a in range(n):
        for j in range(steps.shape[3]):
            multipliers[m, 0, a, j] = x[j, z + a]
    _refuse(m, steps, multipliers)
    return _curvature(m, system, sizes, shift, steps)
