"""Iterations of Newton's method on one trajectory in one compiled pass: trials, and after those that are accepted the
next step."""

import numpy as np

from ....kernels import pasted
from ....linked import view
from . import limit_kernels, trial_kernels
from .acceptance_kernels import judged
from .extent_kernels import STILL, find_moves, larger, left_over
from .limit_kernels import (
    BEST,
    CHEAP,
    CORRECTION,
    COST,
    FIRST,
    FUNNEL,
    HELD,
    ISOLATED,
    LESS,
    MISSING,
    PROMISED,
    SHIFT,
    TURNED,
    drive,
    is_jammed,
    lower,
    set_out,
    turn,
)
from .trial_kernels import (
    AT_COMPLETE,
    AT_DRIVE,
    AT_JAMMED,
    AT_LOWER,
    AT_SOLVE,
    AT_TRIAL,
    AT_TURN,
    AT_UNITS,
    along_of,
    barrier_of,
    blocks_of,
    change_of,
    clear,
    columns_of,
    complete,
    cost_of,
    curvature_of,
    dual_of,
    factors_of,
    fixed_of,
    found_of,
    gap_of,
    gradient_of,
    grown_of,
    lacking_of,
    lacks_of,
    line_of,
    measure,
    multipliers_of,
    numbers_of,
    part_of,
    price_of,
    raising_of,
    sizes_of,
    solve,
    spread_of,
    standing_of,
    steps_of,
    survey,
    trial,
    u_of,
    unit_sizes_of,
    unit_work_of,
    units_by,
    units_of,
    way_of,
    wide_of,
    work_of,
    x_of,
)
from .vectors import compiled, inner

NO_LIMITS = (0,) * 8

FAR, TRIED, ARRIVED, GOING, LOST, APART, CHANGED, EXACT = range(8)  # how a pass ends


def addresses(limited: bool) -> tuple[int, ...]:
    """Where the kernels stand in this process that all passes call; those of inequalities only if there are any."""
    return *trial_kernels.addresses(), *(limit_kernels.addresses() if limited else NO_LIMITS)


@inner
def _accepted(standing: np.ndarray, numbers: np.ndarray, cost: float, reach: float, stiff: float, rules: tuple) -> bool:
    """Whether a whole step, as far as it may go, is taken and the next is to be a whole one, with inequalities by less
    of a shift than a stiff one; what stands then follows it."""
    made = True, standing[PROMISED], standing[TURNED], reach, 1.0, 1.0
    before, now = (standing[MISSING], standing[COST], standing[HELD]), (numbers[9, 0], numbers[10, 0], numbers[11, 0])
    reached = standing[FUNNEL], standing[BEST], standing[SHIFT], numbers[8, 0], numbers[13, 0], cost
    funnel, shift, _, best, good, _ = judged(made, before, now, reached, standing[FIRST] > 0, rules[0], rules[1])
    if not good or shift >= stiff:
        return False
    standing[MISSING], standing[COST], standing[HELD] = now
    standing[FUNNEL], standing[BEST], standing[FIRST], standing[SHIFT] = funnel, best, 0.0, shift
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
def _fixed_ends(setting: np.ndarray, rows: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """1 for the coordinates of the first node that are prescribed, and for those of the last."""
    fixed = fixed_of(setting, rows)
    return view(fixed, 0, (1, n)), view(fixed, fixed.size - n, (1, n))


@pasted
def _first_units(
    calls: tuple,
    room: np.ndarray,
    setting: np.ndarray,
    given: np.ndarray,
    written: np.ndarray,
    rows: np.ndarray,
    rounding: float,
) -> None:
    """Units of the system that is written."""
    (nodes, unknowns, _, wide_nodes, unit), (wide, inverse, cost) = units_of(given, rows), wide_of(given, rows)
    (hessian, left, right, _, gradient), u = blocks_of(written, rows), u_of(written, rows)
    ((sizes, values, ways), curved), (_, count, n, z) = unit_sizes_of(room, rows), left.shape
    (highest, lowest, support), work = spread_of(written, rows), line_of(written, rows)
    find_moves(highest, lowest, support, columns_of(setting, rows)[0], rounding, 0, work, sizes, values)
    controls, curved[0] = view(u, 0, (count, z - n)), True
    for i in range(n, z):
        largest = 0.0
        for k in range(count):
            largest = larger(largest, abs(controls[k, i - n]))
        sizes[0, i], values[0, i], ways[0, i - n] = largest, largest, np.inf
    (start, end), (within, swaps) = _fixed_ends(setting, rows, n), unit_work_of(room, rows)
    system = hessian, left, right, gradient, lacks_of(written, rows), start, end
    own = (sizes, values, ways), curved, within, swaps, rounding
    units_by(calls[AT_UNITS], (system, *own, (unknowns, nodes, unit)))
    cost[0] = unit[0]
    for a in range(n):
        wide_nodes[0, a], inverse[0, a] = nodes[0, a], 1 / nodes[0, a]
    for i in range(z):
        wide[0, i] = unknowns[0, i]


@pasted
def _promise(
    calls: tuple, setting: np.ndarray, given: np.ndarray, written: np.ndarray, rows: np.ndarray, rules: tuple
) -> None:
    """How far the step may go, and what it promises to first order; ``rules``: the unit of the cost, and the share of
    the way to the boundary."""
    steps, multipliers, change = steps_of(written, rows), multipliers_of(written, rows), change_of(written, rows)
    gradient, gap, standing = gradient_of(written, rows), gap_of(written, rows), standing_of(written, rows)
    part, dual = part_of(written, rows), dual_of(written, rows)
    change[0], change[1], part[0], dual[0] = 0.0, 0.0, 1.0, 1.0
    if calls[AT_COMPLETE] != 0:  # what was condensed follows, and changes the cost too
        complete(calls[AT_COMPLETE], (calls, written, setting, rows))
    for k in range(steps.shape[1]):
        for i in range(steps.shape[2]):
            change[0] += gradient[0, k, i] * steps[0, k, i, 0]
    for k in range(gap.shape[1]):
        for a in range(gap.shape[2]):
            change[1] += multipliers[0, k, a, 0] * gap[0, k, a]
    if price_of(given, rows).shape[3] > 0:
        turn(calls[AT_TURN], (calls, given, written, rows, rules[1]))
        way = way_of(written, rows)
        change[0] = part[0] * (change[0] + way[0, 2])
        change[1] = part[0] * change[1] + dual[0] * way[0, 3]
    standing[PROMISED], standing[TURNED] = change[0] / rules[0], change[1] / rules[0]


@pasted
def _stepped(
    calls: tuple,
    room: np.ndarray,
    setting: np.ndarray,
    given: np.ndarray,
    written: np.ndarray,
    rows: np.ndarray,
    least: float,
    rules: tuple,
) -> bool:
    """Whether Newton's step on the system is one that may be made as a whole, whose pivots exceed the least; then what
    it promises stands."""
    hessian, left, right, _, _ = blocks_of(written, rows)
    slopes, lacks, steps, multipliers, finite, largest, told, _, _ = found_of(written, rows)
    curvature, sizes, (_, _, support) = curvature_of(written, rows), sizes_of(written, rows), spread_of(written, rows)
    (_, count, n, _), units, raised = left.shape, wide_of(given, rows), raising_of(given, rows)
    limited, (start, end) = price_of(given, rows).shape[3] > 0, _fixed_ends(setting, rows, n)
    raised[0][0] = standing_of(written, rows)[SHIFT]
    if limited:  # with a barrier the curvature of the Hessian has no bound
        drive(calls[AT_DRIVE], (written, rows))
        for i in range(curvature.shape[1]):
            raised[1][0, i] = 1.0
    else:
        _scales(curvature, units, rules[1], raised[1])
    clear(view(largest, 0, (largest.size,)))
    system, found = (hessian, left, right, slopes, lacks, start, end), (steps, multipliers, finite, largest)
    own = units, raised, rules[4], work_of(room, rows), factors_of(room, rows)
    solve(calls[AT_SOLVE], (0, 1, system, *own, found, told))
    negative, smallest, curved, size = told
    if not (
        finite[0, 0] and smallest[0] > least and curved[0] >= rules[0] * size[0] and negative[0] == (count + 1) * n
    ):
        return False
    groups = columns_of(setting, rows)
    points = view(x_of(written, rows), 0, (count, groups[0].size))
    for a in range(n):
        followed = largest[0, a] <= rules[2] * sizes[0, a]
        if not (followed or _may_move(a, largest[0, a] / rules[2], support, points, groups, rules[3])):
            return False
    _promise(calls, setting, given, written, rows, (units[2][0], rules[5]))
    return True


@pasted
def _leads_on(setting: np.ndarray, given: np.ndarray, written: np.ndarray, rows: np.ndarray, rules: tuple) -> bool:
    """Whether a step neither leads far off nor leaves what the linearised constraints ask for."""
    lacks, steps, largest = lacks_of(written, rows), steps_of(written, rows), grown_of(written, rows)
    (_, left, right, _, _), (_, count, n, _), (far, unmet, met) = blocks_of(written, rows), lacks.shape, rules
    highest, lowest, support = spread_of(written, rows)
    spread, moved = 0.0, 0.0
    for e in range(support.shape[2]):
        spread = max(spread, highest[0, e] + lowest[0, e])
        for a in range(support.shape[1]):
            moved = max(moved, largest[0, a] * support[0, a, e])
    gap, fixed, nodes = (
        view(lacks, 0, (1, count, n)),
        view(fixed_of(setting, rows), 0, (1, count, n)),
        units_of(given, rows)[3],
    )
    over, asked = left_over(gap, left, right, steps, fixed, nodes, 0)
    return spread > 0 and moved <= far * spread and (asked <= met or over <= unmet * asked)


@inner
def _is_resting(numbers: np.ndarray, lacking: np.ndarray, along: np.ndarray, tolerance: float) -> bool:
    """Whether the equations hold and nothing is lacking at a node in any coordinate, but the ends do not meet."""
    holds = numbers[1, 0] <= tolerance and numbers[12, 0] <= np.sqrt(tolerance) and numbers[0, 0] > np.sqrt(tolerance)
    for a in range(along.shape[1]):
        holds &= lacking[0, a] <= tolerance * along[0, a]
    return holds


@pasted
def _settled(
    standing: np.ndarray, given: np.ndarray, written: np.ndarray, rows: np.ndarray, rules: tuple, share: float
) -> bool:
    """Whether the step that is still wanted where the residuals meet the tolerance is Newton's last but one."""
    (least, shrinks), grown, judging = rules, grown_of(written, rows), units_of(given, rows)[1]
    highest, lowest, support = spread_of(written, rows)
    (_, n, size), z, u, wanted = support.shape, grown.shape[1], u_of(written, rows), 0.0
    controls = view(u, 0, (u.size // (z - n) if z > n else 0, z - n))
    for i in range(z):
        own = share * judging[0, i]
        if i < n:
            for e in range(size):
                value, spread = max(highest[0, e], lowest[0, e]), highest[0, e] + lowest[0, e]
                own = max(own, support[0, i, e] * (spread + (value if spread > STILL * value else share * value)))
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
    """Copy as many numbers as both have."""
    for i in range(min(to.size, numbers.size)):
        to[i] = numbers[i]


@compiled
def pursue(
    calls: tuple,
    programs: np.ndarray,
    memory: np.ndarray,
    places: tuple,
    vectors: tuple,
    rows: np.ndarray,
    rules: tuple,
    standing: np.ndarray,
    most: int,
    fresh: bool,
) -> tuple[int, int]:
    """Iterations of Newton's method while whole steps are taken: how many were, and how the pass ends.

    It ends ``FAR`` where a step leads to ends of steps that are not near each other; ``TRIED`` where a trial is
    written, and is not one of those that are only followed here, or none is to be judged, ``most`` being 0;
    ``LOST`` where the first step of a search is not, and ``APART`` where ends of steps of a guess are not near
    each other; ``ARRIVED`` where a trial meets the conditions whose step was Newton's last, ``EXACT`` where one that
    was gone on from meets them to rounding, and so the step from it would be; ``CHANGED`` where a trial is one that
    lowers the barrier, and is not gone on from; else ``GOING``. ``standing``: what stands, and behind it the cost after
    each step.

    Trials are written in turn in the first two places, each with the step from there where it was gone on from; in the
    third stands what the pass sets out from, with its step. ``fresh``: a guess stands in the second, and the search
    sets out from it: its system is written in the third, and its units in what is given.

    ``calls``: addresses; ``programs``, ``memory``: of the tapes, and what they work in; ``vectors``: what stays the
    same, what is given to this pass, and room; ``rows``: where all stands in these (``trial_kernels``); ``rules``: the
    tolerance; those of ``judge``; the least curvature of a step, the softest one of a coordinate, by which share of a
    point's size a coordinate moves at most, by which share sizes differ, the weight of an elimination, the share of the
    way to the boundary that a step may go, and what pivots at a guess exceed; those of ``_leads_on``; those of
    ``_settled``; a residual that is rounding; from which share on ends are far apart, and what a multiplier is kept
    within; those of ``survey``; those of ``measure``; the last barrier relative to the tolerance, those of ``lowered``,
    a share of a step at which it jams, and a stiff shift.
    """
    (setting, given, room), done, tolerance, end = vectors, 0, rules[0], 0
    before, limited = places[1] if fresh else places[2], price_of(given, rows).shape[3] > 0
    stiff = rules[9][3] if limited else np.inf
    while True:
        written = places[2] if fresh else places[done % 2]
        barrier_of(written, rows)[0] = barrier_of(before, rows)[0]
        if not trial(calls[AT_TRIAL], (calls, programs, memory, before, written, setting, given, rows, rules[6])):
            return done, APART if fresh else FAR
        survey(calls, written, given, rows, rules[7])
        if fresh:
            _first_units(calls, room, setting, given, written, rows, rules[8][2])
        measure(calls, written, setting, given, rows, rules[8])
        numbers, kept, reach = numbers_of(written, rows), standing_of(written, rows), part_of(before, rows)[0]
        _copied(kept, standing)
        if fresh:
            set_out(kept, numbers)
        elif most == 0 or not _accepted(kept, numbers, cost_of(written, rows)[0], reach, stiff, rules):
            return done, TRIED
        if limited:
            of = tolerance, rules[9][0], rules[9][1], rules[7], rules[8]
            end = lower(calls[AT_LOWER], (calls, setting, given, written, rows, kept, of))
        resting = _is_resting(numbers, lacking_of(written, rows), along_of(written, rows), tolerance)
        arrived = numbers[7, 0] <= tolerance
        last = arrived and kept[ISOLATED] > 0 and end != CHEAP
        kept[SHIFT] = 0.0 if arrived and not last else kept[SHIFT]
        least = rules[2][6] if fresh else -1.0
        refused = end == CHEAP or not (last or _stepped(calls, room, setting, given, written, rows, least, rules[2]))
        if fresh and (refused or arrived or resting or not _leads_on(setting, given, written, rows, rules[3])):
            return done, LOST
        if refused:
            return done, CHANGED if end == LESS else TRIED
        _copied(standing, kept)
        if last:
            return done, ARRIVED
        done += not fresh
        standing[kept.size + done] = cost_of(written, rows)[0]
        jammed = limited and is_jammed(calls[AT_JAMMED], (written, given, rows, tolerance, rules[4][0], rules[9][2]))
        if not fresh and (done == most or resting or jammed):
            return done, GOING
        if arrived and not _settled(standing, given, written, rows, rules[4], rules[8][1]):
            return done, GOING
        if arrived and numbers[8, 0] <= rules[5]:
            return done, EXACT
        fresh, before = False, written
