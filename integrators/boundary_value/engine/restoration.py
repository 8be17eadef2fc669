"""The feasibility phase: from a guess to a trajectory near it on which the equations hold, whatever it costs.

Gauss-Newton steps, each the least that meets the linearised equations, shortened until the infeasibility decreases.
Multipliers are zero throughout: those of a poor guess bend the Lagrangian far more than the cost does. Inequalities
stay inside by their barrier; those that the guess violates are elastic [Nocedal, Wright 2006, 10.3; Waechter, Biegler
2006, 3.3].
"""

from collections.abc import Callable
from typing import Any, final

import numpy as np

from ..transcription.iteration import Iteration, stops
from .batches import merged
from .conditions import LEAST

DECREASE = 1e-2  # of the infeasibility, times the share of a step that is made: less is no progress
SHORTEST = 1e-3  # a share of a step
SHORTER, LONGER = 0.25, 4.0  # times the share of a step, after one that is refused and one that is accepted
GAINED = 0.1  # of the infeasibility: near to feasible a step that leaves more is held by rounding or by a limit
NARROW = 1e-2  # infeasibility, in units, that no iterate exceeds which sets out from a trajectory that has none


@final
class Restoration:
    """The members of a batch on their way to feasible trajectories."""

    def __init__(
        self, conditions: Any, guess: Any, tolerance: float, callback: Callable[[Iteration], Any] | None
    ) -> None:
        self.conditions, self.tolerance, self.callback = conditions, tolerance, callback
        self.iterate, self.assembled = conditions.begin(without_multipliers(guess.bare))
        self.infeasibility, count = conditions.merit(self.iterate, self.assembled)[0], len(self.assembled.cost)
        self.fraction, self.going = np.ones(count), np.ones(count, bool)
        self.crawls, self.trials, self.stopped = np.zeros(count, bool), 0, False

    def run(self, most: int) -> np.ndarray:
        """Whether members have become feasible after at most so many trials."""
        step = None
        while True:
            near = self.infeasibility <= np.sqrt(self.tolerance)
            self.going &= ~(near & (self.crawls | (self.infeasibility <= self.tolerance))) & (self.fraction >= SHORTEST)
            if not self.going.any() or self.trials >= most or self.stopped:
                return near
            if step is None:
                step = self.conditions.least_step(self.iterate, self.assembled)
            step = None if self._tried(step) else step

    @property
    def holds(self) -> np.ndarray:
        """Whether all equations and inequalities hold."""
        excess = self.conditions.residuals(self.iterate, self.assembled).excess
        return np.maximum(self.infeasibility, excess) <= self.tolerance

    def _tried(self, step: Any) -> bool:
        """Whether a trial is accepted by a member, which then needs another step."""
        self.trials += 1
        before, own = self.infeasibility, (self.iterate, self.assembled)
        moved = without_multipliers(self.conditions.move(*own, step, self.fraction))
        system = self.conditions.assemble(moved)
        other = self.conditions.met(moved, system)
        trial = (moved, system) if other is moved else (other, self.conditions.assemble(other))
        missing = self.conditions.merit(*trial)[0]
        good = self.going & (missing <= (1 - DECREASE * self.fraction * step.reach) * before)
        self.iterate, self.assembled = merged(good, trial, own)
        self.infeasibility = np.where(good, missing, before)
        self.crawls = ~good | (missing > GAINED * before)
        self._report(good)
        self.fraction = np.where(good, np.minimum(LONGER * self.fraction, 1.0), SHORTER * self.fraction)
        return bool(good.any())

    def _report(self, accepted: np.ndarray) -> None:
        """Show the iterates to the callback; where that returns something true, stop."""
        if self.callback is None:
            return
        found = self.conditions.residuals(self.iterate, self.assembled)
        shift, violation = np.full(len(accepted), LEAST), np.maximum(found.violation, found.excess)
        seen = found.gap, found.stationarity, shift, self.fraction, accepted, violation
        told = self.assembled.cost, *seen, self.conditions.barriers(self.iterate)
        self.stopped = stops(self.callback(Iteration(self.trials, np.arange(len(accepted)), *told)))


def without_multipliers(iterate: Any) -> Any:
    """The iterate with costates, and multipliers of equations between ends, that are zero."""
    if hasattr(iterate, "parts"):
        parts = tuple(map(without_multipliers, iterate.parts))
        return iterate._replace(parts=parts, multipliers=np.zeros_like(iterate.multipliers))
    return iterate._replace(costates=np.zeros_like(iterate.costates))
