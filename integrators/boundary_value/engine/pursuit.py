"""Newton's method on one trajectory while its whole steps are taken, in compiled passes, which decide nothing else."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ....manifolds.numerics.tolerances import EPS
from .acceptance import RULES, SHIFTS, Merit, State
from .aside import FAR, MET, UNMET
from .kkt_system import Assembled, Iterate
from .scaling import SOFTEST
from .share import DIAMETER, UNCHANGED
from .trial import Pursuit, Standing

if TYPE_CHECKING:
    from .conditions import Conditions

MOST = 10  # iterations of a pass, which an interrupt waits for
CURVATURE = 1e-9  # relative: a step of less does not descend
SHRINKS = 0.1
EXACT = 64.0  # times eps: a residual that is rounding
JAMMED = 1e-3  # a share of a step at which hard inequalities are made elastic


def set_out(
    conditions: "Conditions", guess: Iterate, most: int, tolerance: float
) -> tuple[State | None, int, tuple[Iterate, Assembled]] | None:
    """The state after whole steps from a guess, if the first is one, how many trials that took, and the guess with its
    system, from which units are taken.

    None where there is no compiled pass for it, as with inequalities, whose slacks are to be found first, or where ends
    of its steps are far apart.
    """
    if conditions.joint or conditions.transcription.inequalities or guess.slacks is not None:
        return None
    if not conditions.at_nodes.flat_controls or (setting := conditions.setting) is None:
        return None
    begun = setting.trial.set_out(setting, guess, (_rules(conditions, tolerance), min(most, MOST)))
    if begun is None:
        return None
    (tried, conditions.units, found), conditions.wider, one, no = begun, None, np.ones(1), np.zeros(1, bool)
    first = tried.iterate, tried.assembled
    if found is None:
        return None, 0, first
    merit, infinite = Merit(one, one, one), np.full(1, np.inf)
    numbers = one, one, merit, one, one, np.zeros(1), one, infinite, no, no, no
    state = State(np.arange(1), *first, tried.appraisal.residuals, found.step, one > 0, *numbers)
    state, trials = _reached(conditions, state, found) or (_standing(state, found.standing), 0)
    return state, trials, first


def pursued(
    conditions: "Conditions", state: State, first: bool, most: int, tolerance: float
) -> tuple[State, int] | None:
    """The state after whole steps, at most so many, and how many trials that took; None where there is none to take.

    The state is that of ``next``, but that the last one is not settled yet. ``first``: no trial was judged before.
    """
    if not _is_plain(conditions, state) or (setting := conditions.setting) is None:
        return None
    if conditions.ahead is not None and conditions.ahead[0] is state.step:  # its trial is refused already
        return None
    merit = state.merit
    standing = Standing(
        promised=state.promised.item(),
        turned=state.turned.item(),
        missing=merit.infeasibility.item(),
        cost=merit.cost.item(),
        held=merit.held.item(),
        funnel=state.funnel.item(),
        best=state.best.item(),
        first=first and state.iterate.slacks is None,
        correction=state.correction.item(),
        isolated=bool(state.isolated[0]),
    )
    going = _rules(conditions, tolerance), standing, min(most, MOST)
    before = state.iterate, state.assembled, state.step
    found = setting.trial.pursue(setting, conditions, before, going)
    return _reached(conditions, state, found)


def _rules(conditions: "Conditions", tolerance: float) -> tuple[Any, ...]:
    """What decides about whole steps, as the kernel takes it."""
    share = DIAMETER / np.sqrt(max(conditions.at_nodes.dimension, 1))
    own = (CURVATURE, SOFTEST, share, UNCHANGED), (FAR, UNMET, MET), (np.sqrt(tolerance), SHRINKS)
    return tolerance, (RULES, SHIFTS), *own, EXACT * EPS, JAMMED


def _is_plain(conditions: "Conditions", state: State) -> bool:
    """Whether this is a trajectory whose next step is a whole one that descends, as far as inequalities let it go."""
    if conditions.joint or not state.descends[0]:
        return False
    free = np.all(state.step.reach == 1.0) if state.iterate.slacks is None else np.all(state.step.reach > JAMMED)
    whole = free and state.shift[0] == 0 and state.fraction[0] == 1
    return bool(whole and np.all(state.step.followed == 1.0) and conditions.at_nodes.flat_controls)


def _reached(conditions: "Conditions", state: State, found: Pursuit) -> tuple[State, int] | None:
    """The state that a pursuit has led to."""
    tried = found.ahead if found.arrived else found.last
    if found.far or (found.ahead is not None and not found.arrived):
        conditions.ahead = found.step, found.ahead
    if tried is None or not found.taken + found.arrived:
        return None
    appraisal = conditions.knows(tried)
    own = {"iterate": tried.iterate, "assembled": tried.assembled, "residuals": appraisal.residuals, "step": found.step}
    state = _standing(state, found.standing)._replace(**own, done=np.array([found.arrived]))
    return state, found.taken + found.arrived


def _standing(state: State, standing: Standing) -> State:
    """The state with what stands."""
    promised, turned, *merit, funnel, best, _, correction, isolated = (np.array([number]) for number in standing)
    settled = isolated > 0
    numbers = {"promised": promised, "turned": turned, "merit": Merit(*merit), "funnel": funnel, "best": best}
    return state._replace(**numbers, correction=correction, isolated=settled, claimed=state.claimed | settled)
