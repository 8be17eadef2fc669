"""Compiled units of trajectories, with the recursion of the Gramians that tell what controls reach."""

import numpy as np

from .arrays import LANES
from .extent_kernels import larger
from .lu import back_substitute, decompose
from .vectors import add, compiled, entry, filled, inner, magnitude, put, put_entry, subtract, vector

FARTHEST = 1e2
EXPLODES = 64.0  # times as far in twice the time: no chain of six integrators comes as far

Work = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@inner
def _load(v: np.ndarray, near: np.ndarray) -> None:
    """``[near_x | 1]``."""
    n, start = near.shape[0], v.shape[1] // 2
    for a in range(n):
        for j in range(0, v.shape[1], LANES):
            put(v, a, j, filled(0.0))
        for j in range(n):
            put_entry(v, a, j, entry(near, a, j))
        put_entry(v, a, start + a, 1.0)


@inner
def _move(
    v: np.ndarray, near: np.ndarray, far: np.ndarray, turned: np.ndarray, terms: np.ndarray, sizes: np.ndarray
) -> None:
    """``A' = (far_x near_x^-1)'`` in the first rows of the terms, and ``B' = (far_u - A near_u)'`` in those after them;
    and the sizes of what they are sums of.

    The inverse stands in the second half of ``v``; ``turned``: room for the transpose of ``far``.
    """
    (n, z), start = near.shape, v.shape[1] // 2
    for a in range(n):
        for j in range(z):
            put_entry(turned, j, a, entry(far, a, j))
    for j in range(0, terms.shape[1], LANES):
        for c in range(n):
            row, size = filled(0.0), filled(0.0)
            for b in range(n):
                f, x = entry(v, b, start + c), vector(turned, b, j)
                row, size = add(row, f, x), add(size, abs(f), magnitude(x))
            put(terms, c, j, row)
            put(sizes, c, j, size)
        for i in range(n, z):
            row = vector(turned, i, j)
            size = magnitude(row)
            for c in range(n):
                f = entry(near, c, i)
                row, size = subtract(row, f, vector(terms, c, j)), add(size, abs(f), vector(sizes, c, j))
            put(terms, i, j, row)
            put(sizes, i, j, size)


@inner
def _gramian(terms: np.ndarray, variance: np.ndarray, g: np.ndarray, rows: np.ndarray) -> None:
    """``g = A g A' + B W B'`` in place, ``terms = [A B]'``; ``rows``: room for ``A g``."""
    n = g.shape[0]
    for i in range(n):
        for j in range(0, g.shape[1], LANES):
            row = filled(0.0)
            for k in range(n):
                row = add(row, entry(terms, k, i), vector(g, k, j))
            put(rows, i, j, row)
    for i in range(n):
        for j in range(0, g.shape[1], LANES):
            row = filled(0.0)
            for k in range(n):
                row = add(row, entry(rows, i, k), vector(terms, k, j))
            for k in range(variance.size):
                row = add(row, entry(terms, n + k, i) * variance[k], vector(terms, n + k, j))
            put(g, i, j, row)


@inner
def _gramians(
    left: np.ndarray, right: np.ndarray, variance: np.ndarray, work: Work, swaps: np.ndarray, out: np.ndarray
) -> None:
    """Diagonals of the Gramians ``G_k = A G_{k-1} A' + B W B'`` along the steps, from the start and then from the end.

    ``left``, ``right``: the ends of the steps, shape ``(N, n, z)``; ``variance``: the diagonal of ``W``. ``out``, shape
    ``(4, N, n)``: at the far ends, from either side, of the linearised steps and of the sizes of their terms, which do
    not cancel. A step whose near end is singular leaves what is not finite.
    """
    (v, lower, weights, turned, terms, g, rows), (count, n, _) = work, left.shape
    turned[:] = 0.0
    for way in range(2):
        g[:] = 0.0
        for i in range(count):
            k = i if way == 0 else count - 1 - i
            near, far = (left[k], right[k]) if way == 0 else (right[k], left[k])
            _load(v, near)
            decompose(v, swaps, lower, weights)
            back_substitute(v, v.shape[1] // 2, lower)
            _move(v, near, far, turned, terms[0], terms[1])
            for t in range(2):
                _gramian(terms[t], variance, g[t], rows)
                for a in range(n):
                    out[2 * way + t, k, a] = g[t, a, a]


@inner
def _reached(gramians: np.ndarray, a: int, t: int) -> float:
    """How far controls move a coordinate of a node between two fixed ends; one step has no node between its ends."""
    count, largest = gramians.shape[1], -np.inf
    for k in range(count if count == 1 else count - 1):
        ahead, back = gramians[t, k, a], gramians[t if count == 1 else 2 + t, k if count == 1 else k + 1, a]
        both = back if back < ahead or back != back else ahead
        largest = larger(largest, both)
    return np.sqrt(max(largest, 0.0)) if np.isfinite(largest) else 0.0


@inner
def _explodes(gramians: np.ndarray, a: int) -> bool:
    """Whether controls move a coordinate much farther in half of the time than in a quarter of it."""
    count = gramians.shape[1]
    whole, half = count // 2, count // 4
    if half < 1:
        return False
    far = min(gramians[0, whole - 1, a], gramians[2, whole, a])
    near = min(gramians[0, half - 1, a], gramians[2, count - half, a])
    return far > EXPLODES * EXPLODES * near


@inner
def _or_one(size: float) -> float:
    return size if size > 0 and np.isfinite(size) else 1.0


@inner
def _sums(hessian: np.ndarray, gradient: np.ndarray, curvature: np.ndarray, slope: np.ndarray) -> None:
    """Of all steps, of the sizes of the curvatures and of the slopes of the cost."""
    for i in range(slope.size):
        curvature[i], slope[i] = 0.0, 0.0
        for k in range(gradient.shape[0]):
            curvature[i] += abs(hessian[k, i, i])
            slope[i] += abs(gradient[k, i])


@inner
def _size(sums: tuple, own: np.ndarray, room: np.ndarray, push: np.ndarray, reach: np.ndarray, convex: bool) -> float:
    """The size of a trajectory, what its ends, its guess and the slope of the cost ask for, within its room."""
    (curvature, slope), asked, most, n = sums, 0.0, 0.0, own.size - room.size
    for i in range(own.size):
        if reach[i] > 0:
            asked = larger(asked, own[i] / reach[i])
        if convex:
            asked = larger(asked, slope[i] * reach[i] / (1 + curvature[i] * reach[i] * reach[i]))
    for j in range(room.size):
        most = larger(most, room[j] / push[n + j] if convex else np.inf)
    return most if 0 < most < asked else asked


@inner
def _farthest(own: np.ndarray, reach: np.ndarray, a: int, n: int) -> float:
    """The largest unit of a coordinate of the states that controls move without bound, as where a plant is unstable.

    It is so many times what the coordinate moves itself, or, if it rests, what it moves while another one does.
    """
    if own[a] > 0:
        return FARTHEST * own[a]
    moved = 0.0
    for b in range(n):
        if reach[b] > 0:
            moved = larger(moved, own[b] / reach[b])
    return FARTHEST * moved * reach[a] if moved > 0 else np.inf


@compiled
def units(
    system: tuple, own: tuple, curved: np.ndarray, work: tuple, swaps: np.ndarray, rounding: float, out: tuple
) -> None:
    """Units of the unknowns, of the nodes, and of the cost of each member.

    ``system``: Hessians, left, right, gradients of the cost; ``own``: sizes of states and controls, those of what
    nothing moves, and how far inequalities let the controls go; ``curved``: where curvature in the controls is not
    rounding; ``rounding``: a share of its terms by which something is not reached.
    """
    (hessian, left, right, gradient), (sizes, values, room), (unknowns, nodes, cost) = system, own, out
    (batch, count, n, z), numbers, gramians = left.shape, work[7], work[8]
    curvature, slope, push, reach, variance = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    recursion = work[0], work[1], work[2], work[3], work[4], work[5], work[6]
    for m in range(batch):
        _sums(hessian[m], gradient[m], curvature, slope)
        convex = curved[m]
        for i in range(n, z):
            convex &= curvature[i] > 0
        for i in range(n, z):
            push[i] = 1 / np.sqrt(curvature[i]) if convex else sizes[m, i]
            reach[i], variance[i - n] = push[i], count * push[i] * push[i]
        _gramians(left[m], right[m], variance[: z - n], recursion, swaps, gramians)
        for a in range(n):
            reached = _reached(gramians, a, 0)
            reach[a] = reached if reached > rounding * _reached(gramians, a, 1) else 0.0
        size, most = _size((curvature, slope), sizes[m], room[m], push, reach, convex), 0.0
        for i in range(z):
            unit = larger(sizes[m, i], size * reach[i])
            if i < n and _explodes(gramians, i):
                unit = min(unit, _farthest(sizes[m], reach, i, n))
            unit = _or_one(unit if unit > 0 else values[m, i])
            most = larger(most, larger(curvature[i] * unit * unit, slope[i] * unit))
            unknowns[m, i] = unit
            if i < n:
                nodes[m, i] = unit
        cost[m] = _or_one(most / count)
