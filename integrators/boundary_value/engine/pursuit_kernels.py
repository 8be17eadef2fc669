"""Iterations of Newton's method on one trajectory in one compiled pass: trials, and after those that are accepted the
next step."""

import numpy as np

from ....kernels import pasted
from ....linked import view
from .acceptance_kernels import judged
from .extent_kernels import left_over
from .trial_kernels import AT_COMPLETE, AT_SOLVE, AT_TRIAL, complete, laid_out, measure, solve, trial
from .vectors import compiled, inner

FAR, TRIED, ARRIVED, GOING, LOST = range(5)  # how a pass ends
# What stands between the trials of a pass.
PROMISED, TURNED, MISSING, COST, HELD, FUNNEL, BEST, FIRST, CORRECTION, ISOLATED = range(10)


@inner
def _set_out(standing: np.ndarray, numbers: np.ndarray) -> None:
    """The merit where a search begins, and a funnel as wide."""
    standing[MISSING], standing[COST], standing[HELD] = numbers[9, 0], numbers[10, 0], numbers[11, 0]
    standing[FUNNEL], standing[BEST], standing[FIRST] = max(numbers[9, 0], 1.0), numbers[8, 0], 1.0


@inner
def _accepted(standing: np.ndarray, numbers: np.ndarray, cost: float, rules: tuple) -> bool:
    """Whether a whole step is taken and the next is to be a whole one; what stands then follows it."""
    made = True, standing[PROMISED], standing[TURNED], 1.0, 1.0, 1.0
    before, now = (standing[MISSING], standing[COST], standing[HELD]), (numbers[9, 0], numbers[10, 0], numbers[11, 0])
    reached = standing[FUNNEL], standing[BEST], 0.0, numbers[8, 0], numbers[13, 0], cost
    funnel, shift, _, best, good, _ = judged(made, before, now, reached, standing[FIRST] > 0, rules[0], rules[1])
    if not good or shift > 0:
        return False
    standing[MISSING], standing[COST], standing[HELD] = now
    standing[FUNNEL], standing[BEST], standing[FIRST] = funnel, best, 0.0
    return True


@inner
def _scales(curvature: np.ndarray, units: tuple, softest: float, out: np.ndarray) -> None:
    """Typical curvatures of the coordinates in their units, of which Hessians have a share."""
    (unknowns, _, cost), most = units, 0.0
    for i in range(out.shape[1]):
        out[0, i] = curvature[0, i] * unknowns[0, i] * unknowns[0, i] / cost[0]
        most = max(most, out[0, i])
    for i in range(out.shape[1]):
        out[0, i] = max(out[0, i], softest * most) if softest * most > 0 else 1.0


@inner
def _kept_size(points: np.ndarray, groups: np.ndarray, e: int, unchanged: float) -> float:
    """The size of the entries of the group that an entry belongs to, if they keep it from point to point, else -1."""
    least, most = np.inf, 0.0
    for k in range(points.shape[0]):
        square = 0.0
        for i in range(groups.size):
            if groups[i] == groups[e]:
                square += points[k, i] * points[k, i]
        least, most = min(least, square), max(most, square)
    most = np.sqrt(most)
    return most if most - np.sqrt(least) <= unchanged * most else -1.0


@inner
def _may_move(a: int, by: float, support: np.ndarray, points: np.ndarray, groups: tuple, unchanged: float) -> bool:
    """Whether a coordinate moves nothing of constant size by more than this size; an array that is zero all along, as
    rates at rest, does not count."""
    (columns, arrays), within = groups, True
    for e in range(arrays.size):
        if support[0, a, e] > unchanged:
            size = _kept_size(points, arrays, e, unchanged)
            if size < 0:
                size = _kept_size(points, columns, e, unchanged)
            if size < 0:
                return True
            within &= size == 0 or by <= size
    return within


@pasted
def _stepped(
    calls: tuple, own: tuple, ends: tuple, room: tuple, rules: tuple, standing: np.ndarray, out: tuple
) -> bool:
    """Whether Newton's step on the system is one that may be made as a whole; then what it promises stands."""
    (weight, work, factors), units, raised = room
    (gap, (hessian, left, right, _, gradient), extent) = out[0][5], out[2], out[4]
    (slopes, lacks, steps, multipliers, finite, largest, told, change, _), (_, count, n, _) = out[7], left.shape
    fixed, columns, arrays, x = ends[0], ends[2], ends[5], out[8][0]
    _scales(extent[9], units, rules[1], raised[1])
    for i in range(largest.size):
        largest[0, i] = 0.0
    start, end = view(fixed, 0, (1, n)), view(fixed, fixed.size - n, (1, n))
    system = hessian, left, right, slopes, lacks, start, end
    solve(
        calls[AT_SOLVE],
        (0, 1, system, units, raised, weight, work, factors, (steps, multipliers, finite, largest), told),
    )
    if not (finite[0, 0] and told[2][0] >= rules[0] * told[3][0]):
        return False
    for a in range(n):
        followed = largest[0, a] <= rules[2] * extent[3][0, a]
        points, by = view(x, 0, (count, arrays.size)), largest[0, a] / rules[2]
        if not (followed or _may_move(a, by, extent[2], points, (columns, arrays), rules[3])):
            return False
    change[0], change[1] = 0.0, 0.0
    if calls[AT_COMPLETE] != 0:  # what was condensed follows, and changes the cost too
        complete(calls[AT_COMPLETE], (calls, own[0], change, own[1], own[2], own[3]))
    for k in range(steps.shape[1]):
        for i in range(steps.shape[2]):
            change[0] += gradient[0, k, i] * steps[0, k, i, 0]
    for k in range(gap.shape[1]):
        for a in range(n):
            change[1] += multipliers[0, k, a, 0] * gap[0, k, a]
    standing[PROMISED], standing[TURNED] = change[0] / units[2][0], change[1] / units[2][0]
    return True


@pasted
def _leads_on(fixed: np.ndarray, nodes: np.ndarray, rules: tuple, out: tuple) -> bool:
    """Whether a step neither leads far off nor leaves what the linearised constraints ask for."""
    (_, lacks, steps, _, _, largest, _, _, _), (far, unmet, met), (_, count, n) = out[7], rules, out[0][5].shape
    gap, left, right = view(lacks, 0, (1, count, n)), out[2][1], out[2][2]
    highest, lowest, support = out[4][0], out[4][1], out[4][2]
    spread, moved = 0.0, 0.0
    for e in range(support.shape[2]):
        spread = max(spread, highest[0, e] + lowest[0, e])
        for a in range(support.shape[1]):
            moved = max(moved, largest[0, a] * support[0, a, e])
    over, asked = left_over(gap, left, right, steps, view(fixed, 0, (1, count, n)), nodes, 0)
    return spread > 0 and moved <= far * spread and (asked <= met or over <= unmet * asked)


@inner
def _is_resting(numbers: np.ndarray, lacking: np.ndarray, along: np.ndarray, tolerance: float) -> bool:
    """Whether the equations hold and nothing is lacking at a node in any coordinate, but the ends do not meet."""
    holds = numbers[1, 0] <= tolerance and numbers[12, 0] <= np.sqrt(tolerance) and numbers[0, 0] > np.sqrt(tolerance)
    for a in range(along.shape[1]):
        holds &= lacking[0, a] <= tolerance * along[0, a]
    return holds


@pasted
def _settled(standing: np.ndarray, units: tuple, rules: tuple, out: tuple) -> bool:
    """Whether the step that is still wanted where the residuals meet the tolerance is Newton's last but one."""
    grown, (least, shrinks), highest, lowest, support = out[7][5], rules, out[4][0], out[4][1], out[4][2]
    (_, count, z, _), (_, n, size), wanted = out[2][0].shape, support.shape, 0.0
    controls, ((_, judging, _, _, _), (_, share, _)) = view(out[8][1], 0, (count, z - n)), units
    for i in range(z):
        own = share * judging[0, i]
        if i < n:
            for e in range(size):
                value = max(highest[0, e], lowest[0, e])
                own = max(own, support[0, i, e] * (highest[0, e] + lowest[0, e] + value))
        else:
            for k in range(controls.shape[0]):
                own = max(own, abs(controls[k, i - n]))
        wanted = max(wanted, grown[0, i] / own)
    if not wanted <= least or wanted > shrinks * standing[CORRECTION]:
        return False
    standing[CORRECTION], standing[ISOLATED] = wanted, 1.0
    return True


@inner
def _copied(to: np.ndarray, numbers: np.ndarray) -> None:
    """Copy numbers."""
    for i in range(numbers.size):
        to[i] = numbers[i]


@compiled
def pursue(
    calls: tuple,
    tapes: tuple,
    before: tuple,
    data: tuple,
    ends: tuple,
    units: tuple,
    limits: tuple,
    places: tuple,
    room: tuple,
    rules: tuple,
    standing: np.ndarray,
    most: int,
    fresh: bool,
) -> tuple[int, int]:
    """Iterations of Newton's method while whole steps are taken: how many were, and how the pass ends.

    It ends ``FAR`` where a step leads to ends of steps that are not near each other; ``TRIED`` where a trial is
    written, and is not one of those that are only followed here, or none is to be judged, ``most`` being 0; ``LOST``
    where the first step of a search is not; ``ARRIVED`` where a trial meets the conditions whose step was Newton's
    last; else ``GOING``. Trials are written in turn in two places, each with the step from there where it was gone on
    from. ``fresh``: a system without a step is written in a third place, from which the search sets out.

    ``calls``: addresses; ``tapes``: the programs of a trial, one after the other, a table of where each stands, reads
    and writes, memory, and the places; ``before``: states, controls, and what the transcription has besides; steps,
    those of the multipliers, what is known of what was condensed, and its steps; coordinates of the multipliers,
    frames, and the part of the steps that is made; without steps the unknowns stay; ``data``: lengths of the steps,
    parameters, a tableau; ``ends``: 1 for the coordinates of the nodes that count; the points and which of their
    entries are prescribed; columns; the mean step; from which share on ends are far apart; arrays of the entries;
    ``units``: of ``measure``, and its shares; ``limits``: slacks, their steps, parts of these, what a multiplier is
    kept within, units, weights, what measures values, prices; ``places``: those of ``OUT``, and the transcription's
    own; ``room``: the weight of an elimination and what it works in, its units, and what raises Hessians; ``rules``:
    the tolerance; those of ``judge``; the least curvature of a step, the softest one of a coordinate, by which share of
    a point's size a coordinate moves at most, and by which share sizes differ; those of ``_leads_on``; those of
    ``_settled``; and a residual that is rounding.
    """
    (codes, registers, values, sources, targets, table, memory, rooms), done, tolerance = tapes, 0, rules[0]
    slacked = limits[0], limits[1], limits[2], limits[3]
    while True:
        written = rooms[2] if fresh else rooms[done % 2]
        own = codes, registers, values, sources, targets, table, memory, written
        out = laid_out(written, places[0])
        if not fresh and not trial(calls[AT_TRIAL], (calls, own, before, data, ends, slacked, places[0], places[1])):
            return done, FAR
        measure(calls, ends[3], units, limits, out)
        numbers, cost, kept = out[5][2], out[3][5], out[7][8]
        _copied(kept, standing)
        if fresh:
            _set_out(kept, numbers)
        elif most == 0 or not _accepted(kept, numbers, cost[0], rules):
            return done, TRIED
        arrived, resting = numbers[7, 0] <= tolerance, _is_resting(numbers, out[4][5], out[5][0], tolerance)
        last, of = arrived and kept[ISOLATED] > 0, (written, data, places[0], places[1])
        refused = not (last or _stepped(calls, of, ends, room, rules[2], kept, out))
        if fresh and (refused or arrived or resting or not _leads_on(ends[0], units[0][3], rules[3], out)):
            return done, LOST
        if refused:
            return done, TRIED
        _copied(standing, kept)
        if last:
            return done, ARRIVED
        if not fresh:
            done += 1
            if done == most or resting:
                return done, GOING
            if arrived and (numbers[8, 0] <= rules[5] or not _settled(standing, units, rules[4], out)):
                return done, GOING
        fresh, (x, u, others, steps, multipliers, known, inner_steps) = False, out[8]
        before = x, u, others, steps, multipliers, known, inner_steps, out[0][6], out[0][4], before[9]
