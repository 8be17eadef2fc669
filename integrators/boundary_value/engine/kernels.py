"""Compiled loops of the block elimination: the steps of one trajectory after the other.

The front of a step has the rows ``d_k`` and ``c_k``, which are eliminated, and ``c_{k+1}``, on which they leave their Schur
complement: those of the next step. At the last step all are eliminated.
"""

import numpy as np

from .factors import LANES, compiled, dot, factorise, scale, substitute

System = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Sizes = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Work = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@compiled
def _padded(size: int) -> int:
    return (size + LANES - 1) // LANES * LANES


@compiled
def _load_node(work: Work, m: int, k: int, system: System, sizes: Sizes) -> None:
    """Rows of ``c_k``: what the step before left on the node, and those of the next node, still zero."""
    (w, v, left, right, gaps), gap, nodes = work, system[4], sizes[1]
    count, (n, columns), z = system[1].shape[1], gaps.shape, system[0].shape[3]
    p = z + n
    for a in range(n):
        fixed = system[5][m, a] if k == 0 else (system[6][m, a] if k == count else 1.0)
        for j in range(columns):
            gaps[a, j] = gap[m, k, a, j] * (fixed / nodes[m, a])
    if k == count:
        for a in range(n):
            for j in range(columns):
                v[p + a, p + n + j] = -gaps[a, j]
            v[p + a, p + a] = system[6][m, a] - 1
        return
    for a in range(n):
        for b in range(a, n):
            v[z + a, z + b] = v[p + a, p + b]
        for j in range(columns):
            v[z + a, p + n + j] = v[p + a, p + n + j] - gaps[a, j]
        for b in range(n):
            v[z + a, p + b] = 0.0
        for c in range((p + a) // LANES, w.shape[1]):
            for t in range(LANES):
                w[p + a, c, t] = 0.0


@compiled
def _load_constraints(work: Work, m: int, k: int, system: System, sizes: Sizes) -> None:
    """``left`` and ``right`` of a step in units, without the equations of free coordinates."""
    _, _, left, right, _ = work
    unknowns, nodes, (n, z) = sizes[0], sizes[1], system[1].shape[2:]
    for a in range(n):
        f = (system[5][m, a] if k == 0 else 1.0) / nodes[m, a]
        g = (system[6][m, a] if k == system[1].shape[1] - 1 else 1.0) / nodes[m, a]
        for j in range(z):
            left[a, j] = system[1][m, k, a, j] * (unknowns[m, j] * f)
            right[a, j] = system[2][m, k, a, j] * (unknowns[m, j] * g)


@compiled
def _hold(w: np.ndarray, right: np.ndarray, left: np.ndarray, z: int, weight: float) -> None:
    """Add ``weight (right' right - left' left)`` to the Hessian; both constraints are padded with zeros to whole vectors."""
    for a in range(right.shape[0]):
        for i in range(z):
            f, g = weight * right[a, i], weight * left[a, i]
            for c in range(i // LANES, right.shape[1] // LANES):
                for t in range(LANES):
                    w[i, c, t] += f * right[a, c * LANES + t] - g * left[a, c * LANES + t]


@compiled
def _load_step(work: Work, m: int, k: int, system: System, sizes: Sizes, shift: np.ndarray, weight: float) -> None:
    """Rows of ``d_k``."""
    (w, v, left, right, gaps), (unknowns, _, cost, scales) = work, sizes
    hessian, slope, (n, columns), z = system[0], system[3], gaps.shape, system[0].shape[3]
    p = z + n
    for i in range(z):
        f = unknowns[m, i] / cost[m]
        for j in range(z):
            v[i, j] = hessian[m, k, i, j] * (f * unknowns[m, j])
        v[i, i] += shift[m] * scales[m, i]
    _hold(w, right, left, z, weight)
    for i in range(z):
        f = unknowns[m, i] / cost[m]
        for a in range(n):
            v[i, z + a], v[i, p + a] = left[a, i], -right[a, i]
        for j in range(columns):
            side = -slope[m, k, i, j] * f
            for a in range(n):
                side += weight * left[a, i] * gaps[a, j]
            v[i, p + n + j] = side


@compiled
def _keep(v: np.ndarray, rows: np.ndarray, bases: np.ndarray, last: int) -> None:
    for k in range(last):
        for j in range(k // LANES * LANES, v.shape[1]):
            rows[bases[k] + j] = v[k, j]


@compiled
def _forward(m: int, system: System, sizes: Sizes, shift: np.ndarray, weight: float, work: Work, factors: tuple) -> tuple:
    """Factorise step after step; the number of negative pivots and the size of the smallest."""
    (w, v, _, _, _), (rows, bases, units, swaps) = work, factors
    count, (n, z) = system[1].shape[1], system[1].shape[2:]
    negative, smallest = 0, np.inf
    v[:] = 0.0
    for a in range(n):
        v[z + n + a, z + n + a] = system[5][m, a] - 1
    for k in range(count):
        last = z + n + (n if k == count - 1 else 0)
        _load_node(work, m, k, system, sizes)
        _load_constraints(work, m, k, system, sizes)
        _load_step(work, m, k, system, sizes, shift, weight)
        if k == count - 1:
            _load_node(work, m, count, system, sizes)
        scale(w, v, units[k], last)
        found, size = factorise(w, v, swaps[k], last, z + 2 * n)
        negative += found
        if size < smallest or size != size:
            smallest = size
        _keep(v, rows[k], bases, last)
    return negative, smallest


@compiled
def _backward(m: int, system: System, sizes: Sizes, weight: float, work: Work, factors: tuple, out: tuple) -> None:
    """Steps and multipliers from the last to the first; the weights' share is taken out of the multipliers."""
    (_, _, left, right, _), (rows, bases, units, swaps), (steps, multipliers) = work, factors, out
    count, (n, z), columns = system[1].shape[1], system[1].shape[2:], steps.shape[3]
    p = z + n
    x = np.zeros((columns, p + n))
    for k in range(count - 1, -1, -1):
        last = p + n if k == count - 1 else p
        _load_constraints(work, m, k, system, sizes)
        for j in range(columns):
            for a in range(p, last if k == count - 1 else p + n):
                x[j, a] = x[j, a - n]
            substitute(rows[k], bases, swaps[k], x[j], last, p + n + j)
            for i in range(last):
                x[j, i] *= units[k, i]
            for i in range(z):
                steps[m, k, i, j] = x[j, i]
            for a in range(n):
                multipliers[m, k + 1, a, j] = x[j, p + a] - weight * dot(x[j], 0, z, right[a], 0)
                if k == 0:
                    multipliers[m, 0, a, j] = x[j, z + a]


@compiled
def _curvature(m: int, system: System, sizes: Sizes, shift: np.ndarray, steps: np.ndarray) -> tuple[float, float]:
    """``d' H d`` with the shifted Hessian and ``d' S d`` with the scales, for the first column."""
    (unknowns, _, cost, scales), z = sizes, steps.shape[2]
    curvature, size, d = 0.0, 0.0, np.empty(z)
    for k in range(steps.shape[1]):
        for i in range(z):
            d[i] = steps[m, k, i, 0] * unknowns[m, i]
            size += steps[m, k, i, 0] * scales[m, i] * steps[m, k, i, 0]
        for i in range(z):
            row = system[0][m, k, i]
            curvature += d[i] * (2 * dot(row, i + 1, z, d, 0) + row[i] * d[i])
    return curvature / cost[m] + shift[m] * size, size


@compiled
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
def eliminate(first: int, last: int, system: System, sizes: Sizes, shift: np.ndarray, weight: float, out: tuple) -> None:
    """Solve the systems of the members ``first`` to ``last``.

    ``system``: the arrays of a ``BlockSystem``; ``sizes``: units of unknowns, nodes and cost, and scales of the shift; ``out``: steps,
    multipliers, number of negative pivots, size of the smallest, curvature and size of the first column.
    """
    count, (n, z), columns = system[1].shape[1], system[1].shape[2:], system[3].shape[3]
    steps, multipliers, negative, smallest, curvature, size = out
    width = _padded(z + 2 * n + columns)
    w = np.zeros((z + 2 * n, width // LANES, LANES))
    work = w, w.reshape((z + 2 * n, width)), np.zeros((n, _padded(z))), np.zeros((n, _padded(z))), np.zeros((n, columns))
    bases, total = np.zeros(z + 2 * n, np.int64), 0
    for i in range(z + 2 * n):
        bases[i] = total - i // LANES * LANES
        total += width - i // LANES * LANES
    factors = np.empty((count, total)), bases, np.empty((count, width)), np.empty((count, z + 2 * n), np.int64)
    for m in range(first, last):
        negative[m], smallest[m] = _forward(m, system, sizes, shift, weight, work, factors)
        _backward(m, system, sizes, weight, work, factors, (steps, multipliers))
        _refuse(m, steps, multipliers)
        curvature[m], size[m] = _curvature(m, system, sizes, shift, steps)
