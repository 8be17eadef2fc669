"""Compiled passes over trajectories and their KKT systems that find what is largest in them."""

import numpy as np

from .arrays import LANES
from .vectors import add, compiled, filled, higher, inner, magnitude, part, plus, put_part, scaled, view

STILL = 1e-12  # of its value: what an entry that is constant moves by, which rounding has made


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


@inner
def _raise(out: np.ndarray, m: int, x: np.ndarray, k: int, sign: float) -> None:
    """Raise the entries of a row to those of another, times a sign, or to their sizes if that is zero."""
    for j in range(0, out.shape[1], LANES):
        own = part(x, k, j)
        put_part(out, m, j, higher(part(out, m, j), magnitude(own) if sign == 0 else scaled(sign, own)))


@compiled
def survey(first: int, last: int, trajectory: tuple, blocks: tuple, out: tuple) -> None:
    """Survey the members ``first`` to ``last``.

    ``trajectory``: nodes, frames, coordinates of the multipliers, gaps; ``blocks``: Hessian, left, right, slope,
    gradient of the cost; ``out``: the fields of the extent, which come as the least that they can be.
    """
    (nodes, frames, coordinates, gap), (hessian, left, right, slope, gradient) = trajectory, blocks
    highest, lowest, support, sizes, missing, lacking, held, parts, slopes, curvature = out
    (_, count, n, size), z = frames.shape, slope.shape[2]
    for m in range(first, last):
        own = view(support, m * n * size, (1, n * size))
        of_nodes = view(frames, m * count * n * size, (count, n * size))
        for k in range(count):
            _raise(highest, m, nodes[m], k, 1.0)
            _raise(lowest, m, nodes[m], k, -1.0)
            _raise(own, 0, of_nodes, k, 0.0)
            for a in range(n):
                missing[m, a] += abs(gap[m, k, a])
                held[m] += coordinates[m, k, a] * gap[m, k, a]
                lacking[m, a] = larger(lacking[m, a], abs(gap[m, k, a]))
        for k in range(count - 1):
            for j in range(0, z, LANES):
                before, after = filled(0.0), filled(0.0)
                for a in range(n):
                    before = add(before, coordinates[m, k, a], part(left[m, k], a, j))
                    after = add(after, coordinates[m, k + 1, a], part(right[m, k], a, j))
                total = plus(magnitude(part(gradient[m], k, j)), plus(magnitude(before), magnitude(after)))
                put_part(parts, m, j, higher(part(parts, m, j), total))
            _raise(slopes, m, slope[m], k, 0.0)
            for i in range(z):
                curvature[m, i] = larger(curvature[m, i], abs(hessian[m, k, i, i]))
        for a in range(n):
            for e in range(size):
                value = support[m, a, e] * larger(highest[m, e], lowest[m, e])
                sizes[m, a] = larger(sizes[m, a], value)


@compiled
def survey_points(
    first: int,
    last: int,
    defect: np.ndarray,
    multipliers: np.ndarray,
    slope: np.ndarray,
    weights: np.ndarray,
    out: np.ndarray,
) -> None:
    """Survey what the points of the steps of the members ``first`` to ``last`` lack, coordinate by coordinate.

    ``out``, shape ``(B, 6, n)``, comes as zeros: the largest sum of the points of a step, the sum of all, the largest
    of one; the largest multiplier; the largest slope of the Lagrangian over the weight of the point; the sum of the
    multipliers on what is lacking.
    """
    _, count, stages, n = defect.shape
    for m in range(first, last):
        for a in range(n):
            for k in range(count):
                total = 0.0
                for i in range(stages):
                    missed = abs(defect[m, k, i, a])
                    total += missed
                    out[m, 2, a] = larger(out[m, 2, a], missed)
                    out[m, 3, a] = larger(out[m, 3, a], abs(multipliers[m, k, i, a]))
                    out[m, 4, a] = larger(out[m, 4, a], abs(slope[m, k, i, a]) / weights[m, k, i])
                    out[m, 5, a] += multipliers[m, k, i, a] * defect[m, k, i, a]
                out[m, 0, a] = larger(out[m, 0, a], total)
                out[m, 1, a] += total


@inner
def _is_alone(support: np.ndarray, m: int, e: int) -> bool:
    """Whether an entry has a coordinate of its own, which moves nothing else."""
    owner, owners, moved = -1, 0, 0
    for a in range(support.shape[1]):
        if support[m, a, e] > 0:
            owner, owners = a, owners + 1
    for other in range(support.shape[2] if owners == 1 else 0):
        moved += support[m, owner, other] > 0
    return moved == 1


@compiled
def find_alone(support: np.ndarray, out: np.ndarray) -> None:
    """Which entries have a coordinate of their own, shape (B, E)."""
    for m in range(support.shape[0]):
        for e in range(support.shape[2]):
            out[m, e] = _is_alone(support, m, e)


@inner
def find_moves(
    highest: np.ndarray,
    lowest: np.ndarray,
    support: np.ndarray,
    columns: np.ndarray,
    rounding: float,
    m: int,
    work: np.ndarray,
    moved: np.ndarray,
    sizes: np.ndarray,
) -> None:
    """What each coordinate of the nodes of a member moves by, zero where that is rounding, and its size; ``work``: room
    for two numbers of each entry."""
    size = columns.size
    for e in range(size):
        work[1, columns[e]] = 0.0
    for e in range(size):
        work[1, columns[e]] = larger(work[1, columns[e]], larger(highest[m, e], lowest[m, e]))
    for e in range(size):
        work[0, e] = 0.0 if _is_alone(support, m, e) else work[1, columns[e]]
    for a in range(support.shape[1]):
        far, most, whole = 0.0, 0.0, 0.0
        for e in range(size):
            f, value = support[m, a, e], larger(highest[m, e], lowest[m, e])
            spread = highest[m, e] + lowest[m, e]
            if spread > STILL * value:
                far = larger(far, f * spread)
            whole = larger(whole, f * work[0, e])
            most = larger(most, f * larger(value, work[0, e]))
        moved[m, a], sizes[m, a] = far if far > rounding * whole else 0.0, most


@compiled
def moves(
    highest: np.ndarray,
    lowest: np.ndarray,
    support: np.ndarray,
    columns: np.ndarray,
    rounding: float,
    work: np.ndarray,
    moved: np.ndarray,
    sizes: np.ndarray,
) -> None:
    """Of each member what ``find_moves`` finds, shape (B, n)."""
    for m in range(len(support)):
        find_moves(highest, lowest, support, columns, rounding, m, work, moved, sizes)


@inner
def left_over(
    gap: np.ndarray,
    left: np.ndarray,
    right: np.ndarray,
    steps: np.ndarray,
    fixed: np.ndarray,
    nodes: np.ndarray,
    m: int,
) -> tuple[float, float]:
    """The most that a step leaves of what the linearised constraints of a member ask for, and the most that they ask
    for, in units of the nodes."""
    (_, count, n, z), remaining, asked = left.shape, 0.0, 0.0
    for k in range(count + 1):
        for a in range(n):
            value = gap[m, k, a]
            asked = larger(asked, abs(value) / nodes[m, a])
            for i in range(z if k < count else 0):
                value += left[m, k, a, i] * steps[m, k, i, 0]
            for i in range(z if k > 0 else 0):
                value -= right[m, k - 1, a, i] * steps[m, k - 1, i, 0]
            remaining = larger(remaining, abs(value * fixed[m, k, a]) / nodes[m, a])
    return remaining, asked


@compiled
def leave(
    gap: np.ndarray,
    left: np.ndarray,
    right: np.ndarray,
    steps: np.ndarray,
    fixed: np.ndarray,
    nodes: np.ndarray,
    out: np.ndarray,
) -> None:
    """Of each member what ``left_over`` finds, shape (2, B)."""
    for m in range(len(gap)):
        out[0, m], out[1, m] = left_over(gap, left, right, steps, fixed, nodes, m)


@inner
def _measures(extent: tuple, nodes: np.ndarray, shares: tuple, m: int, along: np.ndarray, entries: np.ndarray) -> None:
    """What gaps are measured by, in the coordinates and entry by entry."""
    (highest, lowest, support), (value, share, rounding), (n, size) = extent[:3], shares, extent[2].shape[1:]
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
    for e in range(size):
        for a in range(n):
            entries[m, e] = larger(entries[m, e], support[m, a, e] * along[m, a])


@inner
def _stationarity(
    parts: np.ndarray, slope: np.ndarray, curvature: np.ndarray, d: np.ndarray, along: np.ndarray, units: tuple
) -> tuple:
    """The derivative of the Lagrangian relative to the parts that cancel in it, and the scale of these.

    ``along``: the sizes of the states, where these exceed their units. ``units``: what sets the scale where all parts
    vanish, zero where the curvature does, and the share of the scale that a part is at least measured by.
    """
    (least, share), found = units, 0.0
    scale = least
    for i in range(d.size):
        scale = larger(scale, d[i] * parts[i])
        if least == 0:
            scale = larger(scale, d[i] * (larger(d[i], along[i]) if i < along.size else d[i]) * curvature[i])
    for i in range(d.size):
        size = larger(d[i] * parts[i], share * scale)
        found = larger(found, slope[i] * d[i] / (size if size > 0 else 1.0))
    return found, scale


@inner
def _in_all(of: tuple, points: np.ndarray, judging: np.ndarray, measured: np.ndarray, m: int, out: np.ndarray) -> None:
    """The sum of what is lacking, of the multipliers on it, and the most that a node or a point lacks."""
    missing, lacking, held = of
    out[11, m] = held[m]
    for a in range(judging.size):
        most = larger(lacking[m, a], points[m, 2, a])
        out[9, m] += (missing[m, a] + points[m, 1, a]) / measured[a]
        out[11, m] += points[m, 5, a]
        out[12, m] = larger(out[12, m], most / judging[a])
        out[13, m] = larger(out[13, m], most / measured[a])


@compiled
def measure(
    extent: tuple,
    points: np.ndarray,
    trajectory: tuple,
    units: tuple,
    limits: tuple,
    shares: tuple[float, float, float],
    out: tuple,
) -> None:
    """How far trajectories are from their conditions, relative to what these are made of.

    ``extent``: highest, lowest, support, missing, lacking, held, parts, slope, curvature; ``points``: their survey, if
    there are any that were condensed, else zeros; ``trajectory``: largest distances between ends, the mean step, the
    cost; ``units``: of nodes and unknowns that success is judged by; what sets the scale of the slopes where their
    parts vanish, zero where the curvature does; of nodes and of the cost that steps are measured by; ``limits``: the
    survey of the inequalities, their barrier, and its unit; ``shares``: of a value, of a unit, and of the largest entry
    of a frame vector, up to which others are rounding.

    ``out``: sizes by which gaps are measured along the coordinates and entry by entry, and numbers of shape ``(14, B)``
    that come as zeros: the fields of ``Residuals``; the sum of what is lacking; the cost with its barrier, and the
    multipliers on what is lacking, in the unit of the cost; the most that a node or a point lacks in a coordinate, in
    units of success, and in units of steps.
    """
    (highest, lowest, support, missing, lacking, held, parts, slope, curvature), (distance, mean, cost) = (
        extent,
        trajectory,
    )
    (nodes, unknowns, least, wide, unit), (surveyed, barrier, rate), (along, entries, found) = units, limits, out
    share = shares[1]
    for m in range(nodes.shape[0]):
        _measures((highest, lowest, support), nodes, shares, m, along, entries)
        found[1, m], scale = _stationarity(parts[m], slope[m], curvature[m], unknowns[m], along[m], (least[m], share))
        for e in range(entries.shape[1]):
            found[0, m] = larger(found[0, m], distance[m, e] / (entries[m, e] if entries[m, e] > 0 else 1.0))
        for a in range(nodes.shape[1]):
            found[0, m] = larger(found[0, m], points[m, 0, a] / (along[m, a] if along[m, a] > 0 else 1.0))
            size = larger(nodes[m, a] * points[m, 3, a], share * scale)
            found[1, m] = larger(found[1, m], nodes[m, a] * points[m, 4, a] / (size if size > 0 else 1.0))
        found[2, m], found[3, m], found[4, m] = surveyed[0, m], surveyed[1, m], surveyed[2, m] / rate[m]
        off = larger(surveyed[2, m] - barrier[m], barrier[m] - surveyed[3, m])
        found[5, m] = larger(0.0, off) / rate[m]
        found[6, m] = larger(larger(found[0, m], found[1, m]), found[2, m])
        found[7, m] = larger(found[6, m], larger(found[3, m], found[4, m]))
        found[8, m] = larger(found[6, m], found[5, m])
        _in_all((missing, lacking, held), points, nodes[m], wide[m], m, found)
        found[9, m] += surveyed[4, m] / mean[m]
        found[10, m] = (cost[m] + surveyed[5, m]) / unit[m]
        found[11, m] = (found[11, m] + surveyed[6, m]) / unit[m]
