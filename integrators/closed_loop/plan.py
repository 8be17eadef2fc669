"""Plans of a controller, and budgets of its solves."""

import time
from typing import Any, NamedTuple

import jax
import numpy as np

from ...manifolds import DomainError
from ..boundary_value.guess import Guess
from ..boundary_value.iteration_reports import Iteration
from ..boundary_value.solution.record import Solution


class Plan(NamedTuple):
    """A solution or an iterate, and the time at which it begins."""

    solution: Solution
    begin: float

    @property
    def is_usable(self) -> bool:
        """Whether a solve may start from here: from a solution, or an iterate that a budget stopped."""
        found = self.solution
        return self.is_finite and (found.success or found.statistics.stopped)

    @property
    def is_finite(self) -> bool:
        """Whether all states and controls are finite."""
        leaves = jax.tree.leaves((self.solution.states, self.solution.controls))
        return all(np.all(np.isfinite(leaf)) for leaf in leaves)

    @property
    def infeasibility(self) -> float:
        """The largest of the relative defects and violations; infinite where numbers are not finite."""
        if not self.is_finite:
            return np.inf
        checks = self.solution.checks
        return max(checks.defect, getattr(checks, "violation", 0.0))

    def time_of(self, time: Any) -> Any:
        """The time of the solution at a time of the loop; before its beginning and after its end too."""
        return time - self.begin + self.solution.times[0]

    def after(self, time: Any) -> Any:
        """The time of the solution at a time of the loop, between its beginning and its end."""
        return np.clip(self.time_of(time), self.solution.times[0], self.solution.times[-1])

    def guess(self, begin: float, horizon: float) -> Guess | None:
        """The plan from a time on over a horizon, a warm start; its last state and control continue after its end.

        None if nothing of the plan is left, or if it has no polynomials between its nodes.
        """
        if not begin - self.begin < self.solution.horizon:
            return None
        try:
            return self.solution.guess(max(begin - self.begin, 0.0), horizon)
        except DomainError:
            return None


class Budget:
    """A callback that stops a solve before its iterations or its time exceed a budget."""

    def __init__(self, iterations: int | None, milliseconds: float | None) -> None:
        self.iterations, self.seconds = iterations, None if milliseconds is None else milliseconds / 1000
        self.began = self.last = time.perf_counter()
        self.count, self.longest = -1, 0.0  # the first call is the evaluation of the guess

    def __call__(self, _: Iteration) -> bool:
        now = time.perf_counter()
        self.count, self.longest, self.last = self.count + 1, max(self.longest, now - self.last), now
        if self.iterations is not None and self.count >= self.iterations:
            return True
        return self.seconds is not None and now - self.began + self.longest > self.seconds

    @property
    def is_limited(self) -> bool:
        """Whether there is a budget at all."""
        return self.iterations is not None or self.seconds is not None
