"""Where the iterates of Newton's method stand, whether a trial is accepted, and with which shift to go on."""

from typing import NamedTuple, final

import numpy as np

from ....manifolds.numerics.tolerances import EPS
from ..transcription.iterate import Iterate
from .conditions import Conditions
from .kkt_system import Assembled, Residuals, Step

ARMIJO = 1e-4
WIDE = 1.0  # infeasibility, in units, that the funnel of a guess lets pass
SWITCH, NARROWER = 1e-3, 1e-2
# Of its distance to the infeasibility the funnel narrows by so much, for less cost or for less of that.
GENTLY, FIRMLY = 0.1, 0.5
RECORD, FAST = 0.9, 1e-2  # times the best residual so far
SHORTEST = 2.0**-4  # a share of a step
FOLLOWED = 0.75
RAISE, LOWER = 10.0, 4.0
FIRST_SHIFT, SMALLEST_SHIFT = 1e-4, 1e-8
ROUNDED = 10 * EPS  # of the cost: a decrease by less is lost in what it is a sum of
RULES = NARROWER, RECORD, FAST, SHORTEST, ARMIJO, SWITCH, GENTLY, FIRMLY, ROUNDED
SHIFTS = RAISE, LOWER, FOLLOWED, FIRST_SHIFT, SMALLEST_SHIFT


class Merit(NamedTuple):
    """The infeasibility, the cost with its barrier, and the multipliers on what is lacking, in the unit of the cost."""

    infeasibility: np.ndarray
    cost: np.ndarray
    held: np.ndarray


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


@final
class Judgement(NamedTuple):
    """With what the members go on, whether trials are accepted, and whether their steps are done with."""

    funnel: np.ndarray
    shift: np.ndarray  # less after a whole step, more after one that was cut, and where none was short enough
    fraction: np.ndarray
    best: np.ndarray
    good: np.ndarray
    done_with: np.ndarray


@final
class Funnel:
    """Which trials are accepted: the ``value`` of an iterate, the ``slope`` of a step, and what it ``accepts``.

    ``Descent`` asks nothing else of it, and would ask the same of another merit function or filter. The compiled passes
    of whole steps judge by the kernel of this one.
    """

    def __init__(self, tolerance: float, least: float = WIDE) -> None:
        self.tolerance, self.least = tolerance, least

    def value(self, conditions: Conditions, iterate: Iterate, assembled: Assembled) -> Merit:
        """The merit of iterates."""
        return Merit(*conditions.merit(iterate, assembled))

    def width(self, value: Merit) -> np.ndarray:
        """The infeasibility that no iterate exceeds, where a search begins."""
        return np.maximum(value.infeasibility, self.least)

    def slope(
        self, conditions: Conditions, iterate: Iterate, assembled: Assembled, step: Step
    ) -> tuple[np.ndarray, np.ndarray]:
        """Changes of the cost and of the multipliers on what is lacking, to first order, by whole steps."""
        return conditions.promise(iterate, assembled, step)

    def accepts(
        self, state: State, trial: Merit, reached: tuple[np.ndarray, np.ndarray, np.ndarray], first: bool
    ) -> Judgement:
        """The judgement of trials; ``reached``: their residuals, what each lacks most alone, and their costs;
        ``first``: no trial was judged before."""
        from . import acceptance_kernels

        step, count = state.step, len(state.funnel)
        made = state.descends, state.promised, state.turned, step.reach, step.followed, state.fraction
        standing = state.funnel, state.best, state.shift, *reached
        found = Judgement(*np.empty((4, count)), *np.empty((2, count), bool))
        given = made, tuple(state.merit), tuple(trial), standing
        acceptance_kernels.judge(*given, first, self.tolerance, (RULES, SHIFTS), tuple(found))
        return found
