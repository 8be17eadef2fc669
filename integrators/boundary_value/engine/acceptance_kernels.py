"""Compiled judgement of the trials of a batch: a few numbers for each member, and many rules."""

import numpy as np

from .factors import compiled, inner


@inner
def _next_shift(shift: float, made: float, good: bool, short: bool, rules: tuple) -> float:
    """Less after a whole step, more after one that was cut to a quarter or less, and where none was short enough."""
    raised, lowered, followed, first, smallest = rules
    if not good:
        return max(raised * shift, first) if short else shift
    if made >= followed:
        return 0.0 if shift < smallest else shift / lowered
    return max(shift, first) * min(0.5 / made, raised) if made <= 0.25 else shift


@compiled
def judge(
    step: tuple,
    before: tuple,
    trial: tuple,
    standing: tuple,
    first: bool,
    tolerance: float,
    rules: tuple,
    shifts: tuple,
    out: tuple,
    told: tuple,
) -> None:
    """Whether the trials of the members are accepted, and with what they go on.

    ``step``: whether it descends, the changes of the cost and of the multipliers on what is lacking that it promises,
    how far it may go, what of it is followed, and the fraction of it that was tried; ``before``, ``trial``:
    infeasibility, cost and multipliers on what is lacking; ``standing``: funnel, best residual, shift, and of the trial
    the residual, what is lacking most alone, and the cost; ``first``: no trial was judged before; ``rules``,
    ``shifts``: the constants, in their order; ``out``: funnel, shift, fraction and best residual to go on with;
    ``told``: whether the trial is accepted, and whether its step is done with.
    """
    descends, promises, turns, reach, followed, fraction = step
    (missing, cost, held), (missing_now, cost_now, held_now) = before, trial
    funnel, best, shift, residual, shortfall, whole = standing
    armijo, switch, narrower, gently, half, record, fast, shortest = rules
    for m in range(fraction.size):
        part, now = fraction[m], missing_now[m]
        turned = held[m] + part * turns[m]
        promised = -part * (promises[m] - reach[m] * turned)
        cheaper = promised >= switch * missing[m] * missing[m]
        improves = now <= (1 - narrower * part * reach[m]) * funnel[m]
        if cheaper:
            improves = cost_now[m] + held_now[m] <= cost[m] + turned - armijo * promised and now <= funnel[m]
        probe = first and not descends[m]
        # All together may lack more than the funnel, as where what an end lacks is shared among the nodes. But
        # residuals are relative to the multipliers too: where these grow they get less, however much is lacking.
        inside = shortfall[m] <= max(funnel[m], tolerance)
        accepted = improves or (inside and residual[m] <= max(record * best[m], tolerance))
        if probe:
            accepted = residual[m] <= fast * best[m]
        good = accepted and np.isfinite(residual[m]) and np.isfinite(whole[m])
        short = not good and part / 2 < shortest
        out[0][m] = funnel[m]
        if good:
            narrowed = funnel[m] + (gently if cheaper else half) * (now - funnel[m])
            out[0][m] = narrowed if improves else max(funnel[m], now)
        out[1][m] = _next_shift(shift[m], part * followed[m], good, short, shifts)
        out[2][m] = 1.0 if good or short or probe else part / 2
        out[3][m] = min(best[m], residual[m]) if good else best[m]
        told[0][m], told[1][m] = good, good or short or probe
