"""Compiled loops of the block elimination: the steps of one trajectory after the other.

The front of a step has the rows ``d_k`` and ``c_k``, which are eliminated, and ``c_{k+1}``, on which they leave their Schur
complement: those of the next step. At the last step all are eliminated.
"""

import numpy as np

from .arrays import LANES
from .factors import compiled, copy_vector, dot, factorise, inner, scale, substitute, subtract_one

Blocks = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Work = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Units = tuple[np.ndarray, np.ndarray, np.ndarray]


@inner
def _in_units(out: np.ndarray, block: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> None:
    """A block in units, with rows of whole vectors."""
    for i in range(block.shape[0]):
        for j in range(block.shape[1]):
            out[i, j] = block[i, j] * (rows[i] * columns[j])


@inner
def _load_blocks(blocks: Blocks, units: Units, k: int, work: Work) -> None:
    """Hessian, left and right of step k in units, without the equations of free coordinates."""
    (hessian, left, right, _, _), (rows, columns, nodes), last = blocks, units, blocks[1].shape[0] - 1
    _in_units(work[0], hessian[k], rows[0], columns)
    for i in range(columns.size):
        work[0][i, i] += rows[1, i]
    _in_units(work[1], left[k], nodes[0 if k == 0 else 1], columns)
    _in_units(work[2], right[k], nodes[2 if k == last else 1], columns)


@inner
def _load_nodes(v: np.ndarray, z: int, sides: np.ndarray) -> None:
    """Rows of ``c_k``: its right-hand sides and what the step before left on the node; those of the next node are zero."""
    n, columns = sides.shape
    p = z + n
    for a in range(n):
        for b in range(a, n):
            v[z + a, z + b] = v[p + a, p + b]
        for j in range(columns):
            v[z + a, p + n + j] = v[p + a, p + n + j] + sides[a, j]
        for b in range(n):
            v[z + a, p + b] = 0.0
        for j in range(z, v.shape[1]):
            v[p + a, j] = 0.0


@inner
def _close(v: np.ndarray, sides: np.ndarray, fixed: np.ndarray) -> None:
    """Rows of the last node."""
    n, columns = sides.shape
    p = v.shape[0] - n
    for a in range(n):
        v[p + a, p + a] = fixed[a] - 1
        for j in range(columns):
            v[p + a, p + n + j] = sides[a, j]


@inner
def _load_step(v: np.ndarray, work: Work, sides: np.ndarray, weight: float) -> None:
    """Rows of ``d_k``, with the Hessian ``H + weight (right' right - left' left)``."""
    (hessian, left, right, _, _, f), n = work, work[1].shape[0]
    z, width = hessian.shape
    for i in range(z):
        for j in range(0, width, LANES):
            copy_vector(v, i, j, hessian, i, j)
        for j in range(width, v.shape[1]):
            v[i, j] = 0.0
    for side, ends in ((weight, left), (-weight, right)):
        for a in range(n):
            for i in range(z):
                f[0, i] = side * ends[a, i]
            for j in range(0, width, LANES):
                subtract_one(v, 0, min(z, j + LANES), j, f, ends, a)
    for i in range(z):
        for j in range(z, width):
            v[i, j] = 0.0
        for a in range(n):
            v[i, z + a], v[i, z + n + a] = left[a, i], -right[a, i]
        for j in range(sides.shape[1]):
            v[i, z + 2 * n + j] = sides[i, j]


@inner
def _keep(v: np.ndarray, rows: np.ndarray, k: int, bases: np.ndarray, last: int) -> None:
    for i in range(last):
        for j in range(i & -LANES, v.shape[1], LANES):
            copy_vector(rows, k, bases[i] + j, v, i, j)


@compiled
def forward(blocks: Blocks, units: Units, weight: float, fixed: np.ndarray, work: Work, factors: tuple) -> tuple[int, float]:
    """Factorise step after step; the number of negative pivots and the size of the smallest.

    ``blocks``: Hessians, left, right, and right-hand sides of steps and nodes, the latter in units; ``units``: for the rows of
    the Hessians with what raises their diagonals, for the columns, and for the equations of the first node, of others, and of
    the last; ``fixed``: 1 where a coordinate of either end is; ``work``: Hessian, left and right of a step, the front, columns
    of unknowns, room for two rows; ``factors``: the rows of all steps, their bases, their units, and the swaps.
    """
    (_, lefts, _, steps, nodes), (_, _, _, v, _, f), (rows, bases, sizes, swaps) = blocks, work, factors
    (count, n, z), negative, smallest = lefts.shape, 0, np.inf
    for a in range(n):
        for j in range(z, v.shape[1]):
            v[z + n + a, j] = 0.0
        v[z + n + a, z + n + a] = fixed[0, a] - 1
    for k in range(count):
        _load_blocks(blocks, units, k, work)
        _load_nodes(v, z, nodes[k])
        _load_step(v, work, steps[k], weight)
        last = z + n
        if k == count - 1:
            last += n
            _close(v, nodes[count], fixed[1])
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


@compiled
def backward(blocks: Blocks, units: Units, weight: float, work: Work, factors: tuple, out: tuple) -> float:
    """Steps and multipliers from the last to the first, and ``sum_k d_k' H_k d_k`` of the first column.

    The weights' share is taken out of the multipliers.
    """
    (hessian, _, right, _, x, _), (rows, bases, sizes, swaps), (steps, multipliers) = work, factors, out
    (count, n, z), zero, curvature = blocks[1].shape, np.int64(0), 0.0
    p = z + n
    for k in range(count - 1, -1, -1):
        last = p + n if k == count - 1 else p
        _load_blocks(blocks, units, k, work)
        for j in range(x.shape[0]):
            for a in range(p, p + n):
                x[j, a] = x[j, a - n]
            substitute(rows[k], bases, swaps[k], x[j], last, p + n + j)
            for i in range(last):
                x[j, i] *= sizes[k, i]
            for i in range(z):
                steps[k, i, j] = x[j, i]
            for a in range(n):
                multipliers[k + 1, a, j] = x[j, p + a] - weight * dot(x[j], zero, z, right[a], zero)
        curvature += _curvature(hessian, x[0])
    for a in range(n):
        for j in range(x.shape[0]):
            multipliers[0, a, j] = x[j, z + a]
    return curvature
