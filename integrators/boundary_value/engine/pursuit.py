"""Newton's method on one trajectory while its whole steps are taken, in compiled passes, which decide nothing else."""

from typing import TYPE_CHECKING

import numpy as np

from .acceptance import RULES, SHIFTS, Merit, State
from .scaling import SOFTEST
from .share import DIAMETER
from .trial import Pursuit

if TYPE_CHECKING:
    from .conditions import Conditions

CURVATURE = 1e-9  # relative: a step of less does not descend


def pursued(
    conditions: "Conditions", state: State, first: bool, most: int, tolerance: float
) -> tuple[State, int] | None:
    """The state after whole steps, at most so many, and how many trials that took; None where there is none to take.

    It is the state to which ``next`` leads, but that it is not settled. ``first``: no trial was judged before.
    """
    if not _is_plain(conditions, state) or (setting := conditions.setting) is None:
        return None
    n, merit = state.assembled.gap.shape[2], state.merit
    rules = tolerance, (RULES, SHIFTS), CURVATURE, SOFTEST, DIAMETER / np.sqrt(max(n, 1))
    numbers = state.promised, state.turned, *merit, state.funnel, state.best
    standing = np.array([*(number.item() for number in numbers), float(first)])
    going = rules, standing, most, bool(state.isolated[0])
    before = state.iterate, state.assembled, state.step
    found = setting.trial.pursue(setting, conditions, before, going)
    return _reached(conditions, state, found)


def _is_plain(conditions: "Conditions", state: State) -> bool:
    """Whether this is one trajectory without inequalities whose next step is a whole one that descends."""
    if conditions.joint or state.iterate.slacks is not None or not state.descends[0]:
        return False
    whole = state.shift[0] == 0 and state.fraction[0] == 1 and np.all(state.step.reach == 1.0)
    return bool(whole and np.all(state.step.followed == 1.0) and conditions.at_nodes.flat_controls)


def _reached(conditions: "Conditions", state: State, found: Pursuit) -> tuple[State, int] | None:
    """The state that a pursuit has led to."""
    promised, turned, *merit, funnel, best, _ = found.standing[:, None]
    step = state.step if found.step is None else found.step
    tried = found.ahead if found.arrived else found.last
    if found.ahead is not None and not found.arrived:
        conditions.ahead = step, found.ahead
    if tried is None:
        return None
    appraisal = conditions.knows(tried)
    state = state._replace(
        iterate=tried.iterate,
        assembled=tried.assembled,
        residuals=appraisal.residuals,
        step=step,
        merit=Merit(*merit),
        promised=promised,
        turned=turned,
        funnel=funnel,
        best=best,
        done=np.array([found.arrived]),
    )
    return state, found.taken + found.arrived
