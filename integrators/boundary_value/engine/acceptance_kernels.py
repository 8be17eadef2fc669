"""Compiled judgement of the trials of a batch: a few numbers for each member, and many rules."""

import numpy as np

from .vectors import compiled, inner


@inner
def _next_shift(shift: float, made: float, good: bool, short: bool, rules: tuple) -> float:
    """Less after a whole step, more after one that was cut to a quarter or less, and where none was short enough."""
    raised, lowered, followed, first, smallest = rules
    if not good:
        return max(raised * shift, first) if short else shift
    if made >= followed:
        return 0.0 if shift < smallest else shift / lowered
    return max(shift, first) * min(0.5 / made, raised) if made <= 0.25 else shift


@inner
def _improves(
    now: tuple[float, float, float], before: tuple[float, float, float], promised: float, funnel: tuple, rules: tuple
) -> tuple[bool, float]:
    """Whether a trial is accepted inside the funnel, and how wide that is then.

    ``now``, ``before``: infeasibility, cost and the multipliers on what is lacking; ``promised``: how much less cost;
    ``funnel``: its width, and the share of this that is well inside.
    """
    (width, well), (armijo, switch, gently, half, rounded) = funnel, rules
    if promised >= switch * before[0] * before[0]:
        least = before[1] + before[2] - armijo * promised
        less = now[1] + now[2] <= least + rounded * (abs(before[1]) + abs(before[2]))
        return less and now[0] <= width, width + gently * (now[0] - width)
    return now[0] <= well * width, width + half * (now[0] - width)


@inner
def judged(
    made: tuple, before: tuple, now: tuple, standing: tuple, first: bool, tolerance: float, constants: tuple
) -> tuple:
    """The judgement of one trial, as by ``judge``."""
    (descends, promises, turns, reach, followed, part), (missing, cost, held) = made, before
    (funnel, best, shift, residual, shortfall, whole), (rules, shifts) = standing, constants
    narrower, record, fast, shortest = rules[:4]
    turned = held + part * turns
    promised, room = -part * (promises - reach * turned), (funnel, 1 - narrower * part * reach)
    improves, narrowed = _improves(now, (missing, cost, turned), promised, room, rules[4:])
    probe = first and not descends
    # All together may lack more than the funnel, as where what an end lacks is shared among the nodes. But
    # residuals are relative to the multipliers too: where these grow they get less, however much is lacking.
    inside = shortfall <= max(funnel, tolerance)
    accepted = improves or (inside and residual <= max(record * best, tolerance))
    if probe:
        accepted = residual <= fast * best
    good = accepted and np.isfinite(residual) and np.isfinite(whole)
    short = not good and part / 2 < shortest
    return (
        (narrowed if improves else max(funnel, now[0])) if good else funnel,
        _next_shift(shift, part * followed, good, short, shifts),
        1.0 if good or short or probe else part / 2,
        min(best, residual) if good else best,
        good,
        good or short or probe,
    )


@compiled
def judge(
    step: tuple,
    before: tuple,
    trial: tuple,
    standing: tuple,
    first: bool,
    tolerance: float,
    constants: tuple,
    out: tuple,
) -> None:
    """Whether the trials of the members are accepted, and with what they go on.

    ``step``: whether it descends, the changes of the cost and of the multipliers on what is lacking that it promises,
    how far it may go, what of it is followed, and the fraction that was tried; ``before``, ``trial``: as in
    ``_improves``; ``standing``: funnel, best residual, shift, and of the trial its residual, what lacks most alone,
    and the cost; ``first``: no trial was judged before; ``out``: funnel, shift, fraction and best residual to go on
    with, whether the trial is accepted, and whether its step is done with.
    """
    descends, promises, turns, reach, followed, fraction = step
    (missing, cost, held), (missing_now, cost_now, held_now) = before, trial
    funnel, best, shift, residual, shortfall, whole = standing
    for m in range(fraction.size):
        made = descends[m], promises[m], turns[m], reach[m], followed[m], fraction[m]
        old, now = (missing[m], cost[m], held[m]), (missing_now[m], cost_now[m], held_now[m])
        own = funnel[m], best[m], shift[m], residual[m], shortfall[m], whole[m]
        found = judged(made, old, now, own, first, tolerance, constants)
        out[0][m], out[1][m], out[2][m], out[3][m], out[4][m], out[5][m] = found
