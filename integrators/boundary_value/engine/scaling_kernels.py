"""Compiled units of trajectories, with the recursion of the Gramians that tell what controls reach."""

import numpy as np

from .arrays import LANES
from .extent_kernels import STILL, larger
from .lu import back_substitute, decompose
from .vectors import add, compiled, entry, filled, inner, magnitude, put, put_entry, subtract, vector

MATTERS = 1e-3  # of what changes the cost by as much as all others do: a unit is no less
EXPLODES = 64.0  # times as far in twice the time: no chain of six integrators comes as far

Work = tuple[
    np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray
]  # fmt: skip


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
def _drift(terms: np.ndarray, gap: np.ndarray, sign: float, drift: np.ndarray) -> None:
    """What a trajectory has drifted by at the next node, where it lacks ``gap``; in the last row the most so far."""
    n = drift.shape[1]
    for a in range(n):
        drift[1, a] = sign * gap[a]
        for c in range(n):
            drift[1, a] += terms[c, a] * drift[0, c]
    for a in range(n):
        drift[0, a] = drift[1, a]
        drift[2, a] = larger(drift[2, a], abs(drift[0, a]))


@inner
def _lower_gains(terms: np.ndarray, gains: np.ndarray) -> None:
    """Lower the least that a step moves each coordinate by per unit of another one to that of this step."""
    for a in range(gains.shape[0]):
        for c in range(gains.shape[1]):
            gains[a, c] = min(gains[a, c], abs(terms[c, a]))


@inner
def _balance(gains: np.ndarray, nodes: np.ndarray) -> None:
    """Raise units that are next to nothing beside what each step makes of the unit of another coordinate, as that of
    the rate of a body between two that pull equally."""
    n = gains.shape[0]
    for _ in range(n):
        raised = False
        for a in range(n):
            for c in range(n):
                moved = gains[a, c] * nodes[c]
                if a != c and nodes[a] < moved < np.inf:
                    nodes[a], raised = moved, True
        if not raised:
            return


@inner
def _missed(drift: np.ndarray, fixed: np.ndarray, values: np.ndarray, both: np.ndarray, rounding: float) -> float:
    """The size of a trajectory whose controls make up for what its drift misses of an end; ``both``: Gramians there,
    of the linearised steps and of the sizes of their terms."""
    asked = 0.0
    for a in range(fixed.size):
        missed, reach = abs(drift[0, a]), np.sqrt(max(both[0, a], 0.0))
        told = missed > STILL * larger(values[a], drift[2, a]) and reach > rounding * np.sqrt(max(both[1, a], 0.0))
        if fixed[a] > 0 and told and np.isfinite(missed / reach):
            asked = max(asked, missed / reach)
    return asked


@inner
def _gramians(
    steps: tuple, values: np.ndarray, variance: np.ndarray, work: Work, swaps: np.ndarray, rounding: float,
    out: np.ndarray,
) -> float:  # fmt: skip
    """Diagonals of the Gramians ``G_k = A G_{k-1} A' + B W B'`` along the steps, from the start and then from the end;
    and the size of a trajectory between its ends.

    ``steps``: their ends, shape ``(N, n, z)``, what the nodes lack, and which coordinates of the ends are fixed;
    ``values``: sizes of coordinates; ``variance``: the diagonal of ``W``. ``out``, shape ``(4, N, n)``: at the far
    ends, from either side, of the linearised steps and of the sizes of their terms, which do not cancel. A step whose
    near end is singular leaves what is not finite.
    """
    (left, right, gap, start, end), (v, lower, weights, turned, terms, g, rows, drift, gains) = steps, work
    (count, n, _), asked = left.shape, np.inf
    turned[:], gains[:] = 0.0, np.inf
    for way in range(2):
        g[:], drift[:], sign, first = 0.0, 0.0, 2.0 * way - 1.0, count * way
        for a in range(n):
            drift[0, a] = sign * gap[first, a, 0] * (start[a] if way == 0 else end[a])
        for i in range(count):
            k = i if way == 0 else count - 1 - i
            near, far = (left[k], right[k]) if way == 0 else (right[k], left[k])
            _load(v, near)
            decompose(v, swaps, lower, weights)
            back_substitute(v, v.shape[1] // 2, lower)
            _move(v, near, far, turned, terms[0], terms[1])
            _drift(terms[0], gap[k + 1 - way, :, 0], sign, drift)
            if way == 0:
                _lower_gains(terms[0], gains)
            for t in range(2):
                _gramian(terms[t], variance, g[t], rows)
                for a in range(n):
                    out[2 * way + t, k, a] = g[t, a, a]
        last = (count - 1) * (1 - way)
        own = _missed(drift, end if way == 0 else start, values, out[2 * way : 2 * way + 2, last], rounding)
        asked = min(asked, own)
    return asked


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
def _size(sums: tuple, own: tuple, reach: np.ndarray, asked: float, convex: bool, rounding: float) -> float:
    """The size of a trajectory, what its ends, its controls and the slope of the cost ask for, within its room.

    It moves one of its coordinates as far as the guess does; where all else asks for rounding, one that the guess
    moves, if that costs no more than the guess.
    """
    (curvature, slope), (sizes, room, push), least, any_least = sums, own, np.inf, np.inf
    most, n, costs = 0.0, sizes.size - room.size, 0.0
    for i in range(sizes.size):
        if reach[i] > 0:
            ratio = sizes[i] / reach[i]
            asked = larger(asked, ratio if i >= n else 0.0)
            least = min(least, ratio if i < n else np.inf)
            any_least = min(any_least, ratio if ratio > 0 and i < n else np.inf)
        if convex:
            asked = larger(asked, slope[i] * reach[i] / (1 + curvature[i] * reach[i] * reach[i]))
            costs = larger(costs, larger(curvature[i] * sizes[i] * sizes[i], slope[i] * sizes[i]) if i < n else 0.0)
    for j in range(room.size):
        most = larger(most, room[j] / push[n + j] if convex else np.inf)
    asked = max(asked, least if least < np.inf else 0.0)
    any_least = min(any_least, np.sqrt(costs)) if costs > 0 else any_least
    asked = any_least if any_least < np.inf and asked <= rounding * any_least else asked
    return most if 0 < most < asked else asked


@inner
def _farthest(own: np.ndarray, reach: np.ndarray, a: int, n: int) -> float:
    """The largest unit of a coordinate of the states that controls move without bound, as where a plant is unstable.

    It is what the coordinate moves itself, or, if it rests, what it moves while another one does.
    """
    if own[a] > 0:
        return own[a]
    moved = 0.0
    for b in range(n):
        if reach[b] > 0:
            moved = larger(moved, own[b] / reach[b])
    return moved * reach[a] if moved > 0 else np.inf


@inner
def _most(curvature: np.ndarray, slope: np.ndarray, unknowns: np.ndarray) -> float:
    """The most that a coordinate changes the cost by that moves by its unit."""
    most = 0.0
    for i in range(unknowns.size):
        most = larger(most, larger(curvature[i] * unknowns[i] * unknowns[i], slope[i] * unknowns[i]))
    return most


@inner
def _costly(curvature: float, slope: float, most: float) -> float:
    """What a coordinate moves by that changes the cost by so much; zero if its cost is not curved."""
    if not (curvature > 0 and most < np.inf):
        return 0.0
    far = np.sqrt(most / curvature)
    return min(far, most / slope) if slope > 0 else far


@inner
def _unknowns(of: tuple, size: float, gramians: np.ndarray, out: np.ndarray) -> None:
    """Units of the unknowns of a trajectory of this size."""
    (sizes, values, curvature, slope, room, reach), n = of, gramians.shape[2]
    for i in range(out.size):
        unit = larger(sizes[i], size * reach[i])
        if i < n and _explodes(gramians, i):
            unit = min(unit, _farthest(sizes, reach, i, n))
        out[i] = _or_one(unit if unit > 0 else values[i])
    most = _most(curvature, slope, out)
    for i in range(out.size):
        far = MATTERS * _costly(curvature[i], slope[i], most)
        out[i] = max(out[i], far if i < n or not room[i - n] > 0 else min(far, room[i - n]))


@compiled
def units(
    system: tuple, own: tuple, curved: np.ndarray, work: tuple, swaps: np.ndarray, rounding: float, out: tuple
) -> None:
    """Units of the unknowns, of the nodes, and of the cost of each member.

    ``system``: Hessians, left, right, gradients of the cost, what nodes lack, and which coordinates of the ends are
    fixed; ``own``: sizes of states and controls, those of what nothing moves, and how far inequalities let the controls
    go; ``curved``: where curvature in the controls is not rounding; ``rounding``: a share of its terms by which
    something is not reached.
    """
    (hessian, left, right, gradient, gap, start, end), (sizes, values, room) = system, own
    (batch, count, n, z), numbers, gramians, (unknowns, nodes, cost) = left.shape, work[9], work[10], out
    curvature, slope, push, reach, variance = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    recursion = work[0], work[1], work[2], work[3], work[4], work[5], work[6], work[7], work[8]
    for m in range(batch):
        _sums(hessian[m], gradient[m], curvature, slope)
        convex = curved[m]
        for i in range(n, z):
            convex &= curvature[i] > 0
        widest = 0.0
        for i in range(n, z):
            widest = larger(widest, room[m, i - n] * np.sqrt(curvature[i]) if convex else np.inf)
        for i in range(n, z):
            push[i] = 1 / np.sqrt(curvature[i]) if convex else sizes[m, i]
            push[i] = room[m, i - n] / widest if room[m, i - n] > 0 and 0 < widest < np.inf else push[i]
            reach[i], variance[i - n] = push[i], count * push[i] * push[i]
        steps = left[m], right[m], gap[m], start[m], end[m]
        asked = _gramians(steps, values[m], variance[: z - n], recursion, swaps, rounding, gramians)
        for a in range(n):
            reached = _reached(gramians, a, 0)
            reach[a] = reached if reached > rounding * _reached(gramians, a, 1) else 0.0
        size = _size((curvature, slope), (sizes[m], room[m], push), reach, asked, convex, rounding)
        _unknowns((sizes[m], values[m], curvature, slope, room[m], reach), size, gramians, unknowns[m])
        _balance(work[8], unknowns[m, :n])
        for a in range(n):
            nodes[m, a] = unknowns[m, a]
        cost[m] = _or_one(_most(curvature, slope, unknowns[m]) / count)
