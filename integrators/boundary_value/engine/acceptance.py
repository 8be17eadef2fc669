"""Where the iterates of Newton's method stand, whether a trial is accepted inside the funnel, and with which shift to
go on."""

from typing import NamedTuple, Self

import numpy as np

from .conditions import Conditions
from .system import Assembled, Iterate, Residuals, Step

ARMIJO = 1e-4
RECORD = 0.9
SWITCH, NARROWER = 1e-3, 1e-2
GENTLY, HALF = 0.1, 0.5  # of its distance to the infeasibility the funnel narrows by, for less cost or for less of that
FOLLOWED = 0.75
RAISE, LOWER = 10.0, 4.0
FIRST_SHIFT, SMALLEST_SHIFT = 1e-4, 1e-8


class Merit(NamedTuple):
    """The infeasibility, the cost with its barrier, and the multipliers on what is lacking, in the unit of the cost."""

    infeasibility: np.ndarray
    cost: np.ndarray
    held: np.ndarray

    @classmethod
    def of(cls, conditions: Conditions, iterate: Iterate, assembled: Assembled) -> Self:
        """Those at an iterate."""
        return cls(conditions.infeasibility(iterate, assembled), *conditions.merit(iterate, assembled))


class State(NamedTuple):
    """One entry for each member that is on its way."""

    member: np.ndarray
    iterate: Iterate
    assembled: Assembled
    residuals: Residuals
    step: Step
    descends: np.ndarray  # the step has positive curvature
    promised: np.ndarray  # change of the cost to first order by the whole step
    turned: np.ndarray  # change of the multipliers on the gap by the whole step
    merit: Merit
    funnel: np.ndarray  # the infeasibility that no iterate exceeds any more
    fraction: np.ndarray
    shift: np.ndarray
    best: np.ndarray
    correction: np.ndarray  # what the linearised conditions still asked for where the residuals met the tolerance
    isolated: np.ndarray
    claimed: np.ndarray
    done: np.ndarray


def funnelled(state: State, trial: Merit) -> tuple[np.ndarray, np.ndarray]:
    """Whether the trial is accepted inside the funnel, and the funnel after it."""
    before = state.merit
    held = before.held + state.fraction * state.turned
    promised = -state.fraction * (state.promised - state.step.reach * held)
    cheaper = promised >= SWITCH * before.infeasibility**2
    decreases = trial.cost + trial.held <= before.cost + held - ARMIJO * promised
    well = 1 - NARROWER * state.fraction * state.step.reach
    infeasibility = trial.infeasibility
    inside = np.where(cheaper, decreases & (infeasibility <= state.funnel), infeasibility <= well * state.funnel)
    return inside, state.funnel + np.where(cheaper, GENTLY, HALF) * (infeasibility - state.funnel)


def is_record(state: State, residual: np.ndarray, shortfall: np.ndarray, tolerance: float) -> np.ndarray:
    """Whether a trial brings the residual well below the best so far while nothing alone lacks more than the funnel.

    All together may lack more, as where what an end lacks is shared among the nodes. But residuals are relative to the
    trajectory and its multipliers: where these grow without bound they get less, however much is lacking.
    """
    inside = shortfall <= np.maximum(state.funnel, tolerance)
    return inside & (residual <= np.maximum(RECORD * state.best, tolerance))


def next_shift(state: State, good: np.ndarray, short: np.ndarray) -> np.ndarray:
    """Less after a whole step, more after one that was cut to a quarter or less, and where none was short enough."""
    some = np.maximum(state.shift, FIRST_SHIFT)
    made = state.fraction * state.step.followed
    cut = np.where(made <= 0.25, some * np.minimum(0.5 / made, RAISE), state.shift)
    less = np.where(state.shift < SMALLEST_SHIFT, 0.0, state.shift / LOWER)
    taken_ = np.where(made >= FOLLOWED, less, cut)
    return np.where(good, taken_, np.where(short, np.maximum(RAISE * state.shift, FIRST_SHIFT), state.shift))
