"""Compiled passes over trajectories and their KKT systems that find what is largest in them."""

import numpy as np

from .vectors import compiled, inner


@inner
def larger(a: float, b: float) -> float:
    """The larger of both; what is not a number stays."""
    return b if b > a or b != b else a


@inner
def _far(gaps: np.ndarray, columns: np.ndarray, widest: np.ndarray, share: float, work: np.ndarray) -> bool:
    """Whether a column of a gap is larger than a share of the largest one of the nodes."""
    for e in range(columns.size):
        work[columns[e]] = 0.0
    for e in range(columns.size):
        work[columns[e]] = larger(work[columns[e]], abs(gaps[e]))
    far = False
    for e in range(columns.size):
        if work[columns[e]] > share * widest[columns[e]]:
            far = True
    return far


@compiled
def meet(
    begins: np.ndarray,
    finishes: np.ndarray,
    ends: tuple,
    columns: np.ndarray,
    share: float,
    work: np.ndarray,
    out: tuple,
) -> bool:
    """The nodes of trajectories, the gaps there, whether each is far, and the largest gap entry by entry; and whether
    any is far.

    ``ends``: points, and which of their entries are prescribed; ``columns``: of the entries; ``work``: room for two
    numbers of each column; ``out``: nodes, gaps, far, largest.
    """
    (start, end, start_entries, end_entries), (nodes, gaps, far, largest), widest, own = ends, out, work[0], work[1]
    (batch, count, size), any_far = nodes.shape, False
    for m in range(batch):
        for e in range(size):
            widest[columns[e]], largest[m, e] = 0.0, 0.0
        for k in range(count):
            for e in range(size):
                before = finishes[m, k - 1, e] if k > 0 else begins[m, 0, e]
                after = begins[m, k, e] if k < count - 1 else finishes[m, k - 1, e]
                if k == 0 and start_entries[e]:
                    before = start[m, e]
                if k == count - 1 and end_entries[e]:
                    after = end[m, e]
                nodes[m, k, e] = before if k < count - 1 else after
                gaps[m, k, e] = after - before
                widest[columns[e]] = larger(widest[columns[e]], abs(nodes[m, k, e]))
                largest[m, e] = larger(largest[m, e], abs(gaps[m, k, e]))
        for k in range(count):
            far[m, k] = _far(gaps[m, k], columns, widest, share, own)
            any_far |= far[m, k]
    return any_far


@compiled
def survey(first: int, last: int, trajectory: tuple, blocks: tuple, out: tuple) -> None:
    """Survey the members ``first`` to ``last``.

    ``trajectory``: nodes, frames, coordinates of the multipliers, gaps; ``blocks``: Hessian, left, right, slope,
    gradient of the cost; ``out``: the fields of the extent, which come as the least that they can be, and room for two
    sums.
    """
    (nodes, frames, coordinates, gap), (hessian, left, right, slope, gradient) = trajectory, blocks
    highest, lowest, support, missing, lacking, held, parts, slopes, curvature, sums = out
    (_, count, n, size), z = frames.shape, slope.shape[2]
    for m in range(first, last):
        for k in range(count):
            for e in range(size):
                highest[m, e], lowest[m, e] = (
                    larger(highest[m, e], nodes[m, k, e]),
                    larger(lowest[m, e], -nodes[m, k, e]),
                )
            for a in range(n):
                missing[m, a] += abs(gap[m, k, a])
                held[m] += coordinates[m, k, a] * gap[m, k, a]
                lacking[m, a] = larger(lacking[m, a], abs(gap[m, k, a]))
                for e in range(size):
                    support[m, a, e] = larger(support[m, a, e], abs(frames[m, k, a, e]))
        for k in range(count - 1):
            for i in range(z):
                sums[0, i], sums[1, i] = 0.0, 0.0
            for a in range(n):
                for i in range(z):
                    sums[0, i] += left[m, k, a, i] * coordinates[m, k, a]
                    sums[1, i] += right[m, k, a, i] * coordinates[m, k + 1, a]
            for i in range(z):
                parts[m, i] = larger(parts[m, i], abs(gradient[m, k, i]) + abs(sums[0, i]) + abs(sums[1, i]))
                slopes[m, i] = larger(slopes[m, i], abs(slope[m, k, i]))
                curvature[m, i] = larger(curvature[m, i], abs(hessian[m, k, i, i]))


@compiled
def measure(extent: tuple, distance: np.ndarray, units: tuple, shares: tuple[float, float, float], out: tuple) -> None:
    """How far trajectories are from their conditions, relative to what these are made of.

    ``extent``: highest, lowest, support, parts, slope, curvature; ``units``: of the nodes and of the unknowns, and what
    sets the scale of the slopes where their parts vanish, zero where the curvature does; ``shares``: of a value, of a
    unit, and of the largest entry of a frame vector, up to which others are rounding; ``out``: sizes by which gaps are
    measured along the coordinates and entry by entry, the gap, the stationarity, and that scale.
    """
    (highest, lowest, support, parts, slope, curvature), (nodes, unknowns, least) = extent, units
    (along, entries, gap, stationarity, scale), (batch, n, size), (value, share, rounding) = out, support.shape, shares
    for m in range(batch):
        for a in range(n):
            along[m, a] = 0.0
            for e in range(size):
                along[m, a] = larger(along[m, a], support[m, a, e])
        for e in range(size):
            values, is_moved = larger(highest[m, e], lowest[m, e]), False
            for a in range(n):
                is_moved |= support[m, a, e] > rounding * along[m, a]
            if not is_moved:  # the manifold's equations say what it is, and hold to a share of one
                values = larger(values, 1.0)
            entries[m, e] = larger(highest[m, e] + lowest[m, e], value * values)
        for a in range(n):
            along[m, a] = share * nodes[m, a]
            for e in range(size):
                along[m, a] = larger(along[m, a], support[m, a, e] * entries[m, e])
        gap[m], stationarity[m], scale[m] = 0.0, 0.0, least[m]
        for e in range(size):
            for a in range(n):
                entries[m, e] = larger(entries[m, e], support[m, a, e] * along[m, a])
            gap[m] = larger(gap[m], distance[m, e] / (entries[m, e] if entries[m, e] > 0 else 1.0))
        for i in range(unknowns.shape[1]):
            d = unknowns[m, i]
            scale[m] = larger(scale[m], d * parts[m, i])
            if least[m] == 0:
                scale[m] = larger(scale[m], d * d * curvature[m, i])
        for i in range(unknowns.shape[1]):
            d = unknowns[m, i]
            size_of_parts = larger(d * parts[m, i], share * scale[m])
            stationarity[m] = larger(stationarity[m], slope[m, i] * d / (size_of_parts if size_of_parts > 0 else 1.0))
