"""Compiled loops of the block elimination: the steps of one trajectory after the other.

The front of a step has the rows ``d_k`` and ``c_k``, which are eliminated, and ``c_{k+1}``, on which they leave their
Schur complement: those of the next step. At the last step all are eliminated.
"""

import numpy as np

from .arrays import LANES
from .factorisation import compiled, copy_vector, dot, factorise, inner, scale, substitute, subtract_two

System = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Units = tuple[np.ndarray, np.ndarray, np.ndarray]
Work = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Factors = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Raised = tuple[np.ndarray, np.ndarray]
Out = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Told = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@inner
def _load_ends(ends: np.ndarray, system: System, units: Units, k: int) -> None:
    """Left and right of step k in units, their rows in turns, without the equations of free coordinates."""
    (_, left, right, _, _, start, end), (d, g, _) = system, units
    for a in range(left.shape[1]):
        before, after = g[a], g[a]
        if k == 0:
            before *= start[a]
        if k == left.shape[0] - 1:
            after *= end[a]
        for i in range(left.shape[2]):
            ends[2 * a, i] = left[k, a, i] * (before * d[i])
            ends[2 * a + 1, i] = right[k, a, i] * (after * d[i])


@inner
def _gap(system: System, units: Units, k: int, a: int, j: int) -> float:
    """What a node lacks, in units; zero in a free coordinate."""
    gap = system[4][k, a, j] * units[1][a]
    if k == 0:
        gap *= system[5][a]
    return gap * system[6][a] if k == system[4].shape[0] - 1 else gap


@inner
def _load_node(v: np.ndarray, system: System, units: Units, k: int) -> None:
    """Rows of ``c_k``: its right-hand sides and what the step before left on the node; those of the next node are
    zero."""
    n, z = system[1].shape[1:]
    p = z + n
    for a in range(n):
        for b in range(a, n):
            v[z + a, z + b] = v[p + a, p + b]
        for j in range(system[4].shape[2]):
            v[z + a, p + n + j] = v[p + a, p + n + j] - _gap(system, units, k, a, j)
        for b in range(n):
            v[z + a, p + b] = 0.0
        for j in range(z, v.shape[1]):
            v[p + a, j] = 0.0


@inner
def _open(v: np.ndarray, n: int, z: int, fixed: np.ndarray) -> None:
    """What is left on the first node, before any step."""
    for a in range(n):
        for j in range(z, v.shape[1]):
            v[z + n + a, j] = 0.0
        v[z + n + a, z + n + a] = fixed[a] - 1


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
def _load_step(system: System, units: Units, raised: Raised, weight: float, k: int, work: Work) -> None:
    """Rows of ``d_k``, with the Hessian ``H + weight (right' right - left' left)``."""
    (hessian, left, _, slope, _, _, _), (d, _, cost), (ends, v, _, f) = system, units, work
    n, z = left.shape[1:]
    sides, inverse = z + 2 * n, 1 / cost[0]
    for i in range(z):
        for j in range(z):
            v[i, j] = hessian[k, i, j] * (d[i] * inverse * d[j])
        v[i, i] += raised[0][0] * raised[1][i]
        for a in range(n):
            v[i, z + a], v[i, z + n + a] = ends[2 * a, i], -ends[2 * a + 1, i]
        for j in range(slope.shape[2]):
            v[i, sides + j] = -slope[k, i, j] * (d[i] * inverse)
        for j in range(sides + slope.shape[2], v.shape[1]):
            v[i, j] = 0.0
    for a in range(n):
        for i in range(z):
            f[0, i], f[1, i] = weight * ends[2 * a, i], -weight * ends[2 * a + 1, i]
        for j in range(0, ends.shape[1], LANES):
            subtract_two(v, 0, min(z, j + LANES), j, f, ends, 2 * a)
        for j in range(slope.shape[2]):
            gap = _gap(system, units, k, a, j)
            for i in range(z):
                v[i, sides + j] += f[0, i] * gap


@inner
def _keep(v: np.ndarray, rows: np.ndarray, k: int, bases: np.ndarray, last: int) -> None:
    for i in range(last):
        for j in range(i & -LANES, v.shape[1], LANES):
            copy_vector(rows, k, bases[i] + j, v, i, j)


@inner
def _forward(
    system: System, units: Units, raised: Raised, weight: float, work: Work, factors: Factors
) -> tuple[int, float]:
    """Factorise a system step after step; the number of negative pivots and the size of the smallest."""
    (ends, v, _, f), (rows, bases, sizes, swaps) = work, factors
    (count, n, z), negative, smallest = system[1].shape, 0, np.inf
    _open(v, n, z, system[5])
    for k in range(count):
        _load_ends(ends, system, units, k)
        _load_node(v, system, units, k)
        _load_step(system, units, raised, weight, k, work)
        last = z + n
        if k == count - 1:
            last += n
            _close(v, system, units)
        scale(v, f, sizes[k], z, last)
        found, size = factorise(v, f, swaps[k], last, z + 2 * n)
        negative += found
        if size < smallest or size != size:
            smallest = size
        _keep(v, rows, k, bases, last)
    return negative, smallest


@inner
def _curvature(hessian: np.ndarray, d: np.ndarray) -> float:
    total, zero = 0.0, np.int64(0)
    for i in range(hessian.shape[0]):
        total += d[i] * dot(d, zero, hessian.shape[0], hessian[i], zero)
    return total


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
    (rows, bases, sizes, swaps), (count, n, z), zero = factors, left.shape, np.int64(0)
    p, curvature, size = z + n, 0.0, 0.0
    for k in range(count - 1, -1, -1):
        last = p + n if k == count - 1 else p
        for j in range(x.shape[0] - 1, -1, -1):
            for a in range(p, p + n):
                x[j, a] = x[j, a - n]
            substitute(rows[k], bases, swaps[k], x[j], last, p + n + j)
            for i in range(last):
                x[j, i] *= sizes[k, i]
            for i in range(z):
                f[0, i] = x[j, i] * d[i]
                out[0][k, i, j] = f[0, i]
            for a in range(n):
                moved = dot(f[0], zero, z, right[k, a], zero) * g[a]
                if k == count - 1:
                    moved *= end[a]
                out[1][k + 1, a, j] = (x[j, p + a] - weight * moved) * (cost[0] * g[a])
        curvature += _curvature(hessian[k], f[0])
        for i in range(z):
            size += raised[1][i] * x[0, i] * x[0, i]
            if not abs(f[0, i]) <= out[3][i]:
                out[3][i] = abs(f[0, i])
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
    ``work``: left and right of a step, the front, columns of unknowns, room for two rows; ``factors``: the rows of all
    steps, their bases, their units, and the swaps; ``told``: negative pivots, the smallest one, curvature and size.
    """
    hessian, left, right, slope, gap, start, end = system
    d, g, cost = units
    for m in range(first, last):
        own = hessian[m], left[m], right[m], slope[m], gap[m], start[m], end[m]
        of, shifted = (d[m], g[m], cost[m : m + 1]), (raised[0][m : m + 1], raised[1][m])
        found = out[0][m], out[1][m], out[2][m], out[3][m]
        told[0][m], told[1][m] = _forward(own, of, shifted, weight, work, factors)
        told[2][m], told[3][m] = _backward(own, of, shifted, weight, work, factors, found)
