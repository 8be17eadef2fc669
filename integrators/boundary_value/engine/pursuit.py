"""Newton's method on one trajectory while its whole steps are taken, in compiled passes, which decide nothing else."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ....manifolds.numerics.ambient import taken
from ....manifolds.numerics.tolerances import EPS
from ..transcription.iterate import Iterate
from .acceptance import RULES, SHIFTS, Merit, State
from .aside import FAR, MET, UNMET
from .extent import ends_meet
from .scaling import SOFTEST
from .share import DIAMETER, UNCHANGED
from .standing import Standing
from .trial import Arrivals, Pursuit, Share, Tried

if TYPE_CHECKING:
    from .conditions import Conditions

MOST = 10  # iterations of a pass, which an interrupt waits for
CURVATURE = 1e-9  # relative: a step of less does not descend
SHRINKS = 0.1
EXACT = 64.0  # times eps: a residual that is rounding
JAMMED = 1e-3  # a share of a step at which hard inequalities are made elastic
STIFF = 1e2  # a shift at which hard inequalities are made elastic: no more than what counts as one that makes convex


def set_out(
    conditions: "Conditions", guess: Iterate, most: int, tolerance: float
) -> tuple[State | None, int, list[float], Callable[[], Tried]] | None:
    """The state after whole steps from a guess, if the first is one, how many trials that took, the costs on the way,
    and the guess with its system, from which units are taken.

    None where there is no compiled pass for it, as with inequalities, whose slacks are to be found first, or where ends
    of its steps are far apart.
    """
    if not _may_set_out(conditions, guess) or (setting := conditions.setting) is None:
        return None
    begun = setting.trial.set_out(setting, guess, (_rules(conditions, tolerance), min(most, MOST)))
    if begun is None:
        return None
    first, conditions.units, found = begun
    conditions.wider = None
    if found is None:
        return None, 0, [], first
    state, trials = _reached(conditions, found) or (_state(first(), found), 0)
    return state, trials, found.costs, first


def arrivals(conditions: "Conditions", guess: Iterate, tolerance: float, most: int, share: Share) -> Arrivals | None:
    """The members of a batch that arrive with whole steps from their guesses, each in one pass; None where there is no
    pass for them; ``share``: see ``Trial.set_out_each``."""
    if not _may_set_out(conditions, guess) or conditions.at_nodes.pays:
        return None
    trial = conditions.transcription.trial(conditions.at_nodes, conditions.data.steps.shape[1])
    going = _rules(conditions, tolerance), min(most, MOST)
    if trial is None:
        return None
    found = trial.set_out_each(conditions, guess, going, share)
    _, assembled, appraisal, _ = found.tried
    met = ends_meet(assembled, conditions.at_nodes.layout.in_arrays, tolerance)
    met &= appraisal.residuals.final <= tolerance
    return found if met.all() else taken(found, met)


def _may_set_out(conditions: "Conditions", guess: Iterate) -> bool:
    """Whether nothing is to be found out before passes from a guess, as slacks of inequalities are."""
    plain = not (conditions.joint or conditions.transcription.inequalities) and guess.slacks is None
    return plain and conditions.at_nodes.flat_controls


def pursued(
    conditions: "Conditions", state: State, first: bool, most: int, tolerance: float
) -> tuple[State, int, list[float]] | None:
    """The state after whole steps, at most so many, how many trials that took, and the costs after each step; None
    where there is none to take.

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
        shift=state.shift.item(),
    )
    going = _rules(conditions, tolerance), standing, min(most, MOST)
    before = state.iterate, state.assembled, state.step
    found = setting.trial.pursue(setting, conditions, before, going)
    if (reached := _reached(conditions, found)) is None:
        return None
    after, trials = reached
    return after._replace(member=state.member, claimed=after.claimed | state.claimed), trials, found.costs[1:]


def _rules(conditions: "Conditions", tolerance: float) -> tuple[Any, ...]:
    """What decides about whole steps, as the kernel takes it."""
    share = DIAMETER / np.sqrt(max(conditions.at_nodes.dimension, 1))
    own = (CURVATURE, SOFTEST, share, UNCHANGED), (FAR, UNMET, MET), (np.sqrt(tolerance), SHRINKS)
    return tolerance, (RULES, SHIFTS), *own, EXACT * EPS, (JAMMED, STIFF)


def _is_plain(conditions: "Conditions", state: State) -> bool:
    """Whether this is a trajectory whose next step is a whole one that descends, as far as inequalities let it go."""
    if conditions.joint or not state.descends[0]:
        return False
    whole = state.step.reach == 1.0 if state.iterate.slacks is None else state.step.reach > JAMMED
    made = np.all(whole) and np.all(state.step.followed == 1.0) and state.fraction[0] == 1
    return bool(made and conditions.at_nodes.flat_controls)


def _reached(conditions: "Conditions", found: Pursuit) -> tuple[State, int] | None:
    """The state that a pursuit has led to, and how many trials that took; None where it took no step."""
    if found.far or (found.ahead is not None and not found.arrived):
        conditions.ahead = found.step, found.ahead
    tried = found.ahead if found.arrived else found.last
    if tried is None:
        return None
    conditions.knows(tried)
    return _state(tried, found), found.taken + found.arrived


def _state(tried: Tried, found: Pursuit) -> State:
    """The state at the end of a pursuit, of a single member: nothing is cut there."""
    promised, turned, *merit, funnel, best, _, correction, isolated, shift = np.array([found.standing], float).T
    one, settled = np.array([1.0]), isolated > 0
    at = np.arange(1), tried.iterate, tried.assembled, tried.appraisal.residuals, found.step, one > 0
    numbers = promised, turned, Merit(*merit), funnel, one, shift, best, correction
    return State(*at, *numbers, settled, settled, np.array([found.arrived or found.exact]))
