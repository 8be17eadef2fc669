"""Compiled loops of the block elimination: the steps of one trajectory after the other.

The front of a step has the rows ``d_k`` and ``c_k``, which are eliminated, and ``c_{k+1}``, on which they leave their
Schur complement: those of the next step. At the last step all are eliminated.
"""

import numpy as np

from .arrays import LANES
from .factorisation import factorise, scale, substitute, subtract_all
from .vectors import (
    add,
    compiled,
    entry,
    filled,
    inner,
    part,
    plus,
    put,
    put_entry,
    scaled,
    times,
    total,
    vector,
)

System = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Units = tuple[np.ndarray, np.ndarray, np.ndarray]
Work = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Factors = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Raised = tuple[np.ndarray, np.ndarray]
Out = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Told = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@inner
def _gap(system: System, units: Units, k: int, a: int, j: int) -> float:
    """What a node lacks, in units; zero in a free coordinate."""
    gap = system[4][k, a, j] * units[1][a]
    if k == 0:
        gap *= system[5][a]
    return gap * system[6][a] if k == system[4].shape[0] - 1 else gap


@inner
def _load_nodes(work: Work, system: System, units: Units, weight: float, k: int) -> None:
    """Rows of ``c_k``, with what the step before left on the node, and of ``c_{k+1}``: left and minus right in units,
    without the equations of free coordinates; and these times the weight."""
    (_, left, right, _, gap, start, end), (_, g, _), (ends, v, _, unit) = system, units, work
    n, z = left.shape[1:]
    p, columns = z + n, gap.shape[2]
    for a in range(n):
        before, after = g[a], g[a]
        if k == 0:
            before *= start[a]
        if k == left.shape[0] - 1:
            after *= end[a]
        for j in range(0, v.shape[1], LANES):
            if j < z:
                x = times(part(left[k], a, j), scaled(before, vector(unit, 0, j)))
                put(v, z + a, j, x)
                put(ends, a, j, scaled(weight, x))
            else:
                put(v, z + a, j, filled(0.0))
        for b in range(n):
            put_entry(v, z + a, z + b, entry(v, p + a, p + b))
        for j in range(p + n, p + n + columns):
            put_entry(v, z + a, j, entry(v, p + a, j) - entry(gap[k], a, j - p - n) * before)
        for j in range(0, v.shape[1], LANES):
            if j < z:
                x = times(part(right[k], a, j), scaled(-after, vector(unit, 0, j)))
                put(v, p + a, j, x)
                put(ends, n + a, j, scaled(-weight, x))
            else:
                put(v, p + a, j, filled(0.0))


@inner
def _open(v: np.ndarray, n: int, fixed: np.ndarray) -> None:
    """What is left on the first node, before any step."""
    p = v.shape[0] - n
    for a in range(n):
        for j in range(0, v.shape[1], LANES):
            put(v, p + a, j, filled(0.0))
        v[p + a, p + a] = fixed[a] - 1


@inner
def _close(v: np.ndarray, system: System, units: Units) -> None:
    """Rows of the last node."""
    n, last = system[1].shape[1], system[1].shape[0]
    p = v.shape[0] - n
    for a in range(n):
        v[p + a, p + a] = system[6][a] - 1
        for j in range(system[4].shape[2]):
            v[p + a, p + n + j] = -_gap(system, units, last, a, j)


@inner
def _load_step(system: System, units: Units, raised: Raised, k: int, work: Work) -> None:
    """Rows of ``d_k``, with the Hessian ``H + weight (right' right - left' left)``."""
    (hessian, left, _, slope, _, _, _), (ends, v, _, f) = system, work
    n, z = left.shape[1:]
    sides = z + 2 * n
    for i in range(z):
        for j in range(0, v.shape[1], LANES):
            row = filled(0.0)
            if j < z:
                row = times(part(hessian[k], i, j), scaled(entry(f, 1, i), vector(f, 0, j)))
            put(v, i, j, row)
    subtract_all(v, 0, z, 0, ends.shape[1], ends, 0, v, z, 2 * n)
    for i in range(z):
        v[i, i] += raised[0][0] * raised[1][i]
        for a in range(z, sides):
            put_entry(v, i, a, entry(v, a, i))
    for j in range(slope.shape[2]):
        for i in range(0, z, LANES):
            row = filled(0.0)
            for a in range(n):
                row = add(row, _gap(system, units, k, a, j), vector(ends, a, i))
            put(f, 2, i, row)
        for i in range(z):
            put_entry(v, i, sides + j, entry(f, 2, i) - entry(slope[k], i, j) * entry(f, 1, i))


@inner
def _forward(
    system: System, units: Units, raised: Raised, weight: float, work: Work, factors: Factors
) -> tuple[int, float]:
    """Factorise a system step after step; the number of negative pivots and the size of the smallest."""
    (_, v, _, f), (divided, rows, order, done, sizes) = work, factors
    (count, n, z), negative, smallest = system[1].shape, 0, np.inf
    p = z + n
    _open(v, n, system[5])
    for k in range(count):
        _load_nodes(work, system, units, weight, k)
        _load_step(system, units, raised, k, work)
        last = z + n
        if k == count - 1:
            last += n
            _close(v, system, units)
        scale(v, sizes, k, z, last)
        found, size = factorise(v, f[2:], (divided, rows, order, done), k * p, last, p if k > 0 else 0)
        subtract_all(v, last, v.shape[0], last & -LANES, v.shape[1], divided, k * p, rows, 0, last)
        negative += found
        if size < smallest or size != size:
            smallest = size
    return negative, smallest


@inner
def _curvature(hessian: np.ndarray, d: np.ndarray) -> float:
    """``d' H d`` of the vectors of the first row."""
    found = filled(0.0)
    for j in range(0, hessian.shape[1], LANES):
        product = filled(0.0)
        for i in range(hessian.shape[0]):
            product = add(product, entry(d, 0, i), part(hessian, i, j))
        found = plus(found, times(product, vector(d, 0, j)))
    return total(found)


@inner
def _moved(block: np.ndarray, a: int, d: np.ndarray) -> float:
    """Row a of a block times the vectors of the first row."""
    found = filled(0.0)
    for j in range(0, block.shape[1], LANES):
        found = plus(found, times(part(block, a, j), vector(d, 0, j)))
    return total(found)


@inner
def _refuse(j: int, steps: np.ndarray, multipliers: np.ndarray) -> bool:
    """Make a column NaN as a whole if it is not finite somewhere, and whether it was finite."""
    total, (count, z) = 0.0, steps.shape[:2]
    for k in range(count + 1):
        for a in range(multipliers.shape[1]):
            total += 0.0 * multipliers[k, a, j]
        for i in range(z if k < count else 0):
            total += 0.0 * steps[k, i, j]
    if total == 0:
        return True
    multipliers[:, :, j] = np.nan
    steps[:, :, j] = np.nan
    return False


@inner
def _backward(
    system: System, units: Units, raised: Raised, weight: float, work: Work, factors: Factors, out: Out
) -> tuple[float, float]:
    """Steps and multipliers from the last to the first; ``sum_k d_k' H_k d_k`` and the size of the first column, in
    units.

    The weights' share is taken out of the multipliers. ``out``: steps, multipliers, which columns are finite, and the
    largest step of each unknown in the first.
    """
    (hessian, left, right, _, _, _, end), (d, g, cost), (_, _, x, f) = system, units, work
    (divided, rows, order, done, sizes), (count, n, z) = factors, left.shape
    p, curvature, size = z + n, 0.0, 0.0
    for k in range(count - 1, -1, -1):
        last = p + n if k == count - 1 else p
        for j in range(x.shape[0] - 1, -1, -1):
            for a in range(p, p + n):
                x[j, a] = x[j, a - n]
            substitute((divided, rows, order, done), k * p, last, x, j, p + n)
            for i in range(last):
                x[j, i] *= sizes[k, i]
            for i in range(z):
                f[2, i] = x[j, i] * d[i]
                out[0][k, i, j] = f[2, i]
            for a in range(n):
                moved = _moved(right[k], a, f[2:]) * g[a]
                if k == count - 1:
                    moved *= end[a]
                out[1][k + 1, a, j] = (x[j, p + a] - weight * moved) * (cost[0] * g[a])
        curvature += _curvature(hessian[k], f[2:])
        for i in range(z):
            size += raised[1][i] * x[0, i] * x[0, i]
            if not abs(f[2, i]) <= out[3][i]:
                out[3][i] = abs(f[2, i])
    for j in range(x.shape[0]):
        for a in range(n):
            out[1][0, a, j] = x[j, z + a] * (cost[0] * g[a])
        out[2][j] = _refuse(j, out[0], out[1])
    if not out[2][0]:
        size, out[3][:] = np.nan, np.nan
    return curvature / cost[0] + raised[0][0] * size, size


@compiled
def solve(
    first: int,
    last: int,
    system: System,
    units: Units,
    raised: Raised,
    weight: float,
    work: Work,
    factors: Factors,
    out: Out,
    told: Told,
) -> None:
    """Solve the systems of the members ``first`` to ``last``, one after the other.

    ``system``: Hessians, left, right, slopes, gaps, and 1 where a coordinate of either end is fixed; ``units``: of the
    unknowns, inverse ones of the nodes, and of the cost; ``raised``: the shift, and the diagonal that it raises;
    ``work``: left and right of a step, the front, columns of unknowns, room for four rows; ``factors``: the divided
    rows of the pivots of all steps, room for those of one, which rows they are, room for a number of each row, and the
    units of the rows; ``told``: negative pivots, the smallest one, curvature and size.
    """
    hessian, left, right, slope, gap, start, end = system
    d, g, cost = units
    for m in range(first, last):
        own = hessian[m], left[m], right[m], slope[m], gap[m], start[m], end[m]
        of, shifted = (d[m], g[m], cost[m : m + 1]), (raised[0][m : m + 1], raised[1][m])
        found = out[0][m], out[1][m], out[2][m], out[3][m]
        for i in range(d.shape[1]):
            work[3][0, i], work[3][1, i] = d[m, i], d[m, i] / cost[m]
        told[0][m], told[1][m] = _forward(own, of, shifted, weight, work, factors)
        told[2][m], told[3][m] = _backward(own, of, shifted, weight, work, factors, found)
