"""The record of a trajectory in phases."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self, final

import numpy as np

from ....manifolds import ConvergenceError
from ...reporting.presentation import HistoryPlots
from ...reporting.text import table
from .diagnostics import Statistics
from .interpolation import Sample, checked_times
from .record import Solution, Status, status_of


@final
@dataclass(frozen=True, eq=False)
class PhasedSolution(HistoryPlots):
    r"""The extremal of P phases that follow one another: a ``Solution`` of each phase, with times that continue.

    Attributes
    ----------
    phases : tuple of Solution
        The solutions.
    cost : float
        The sum of their costs.
    success, result : bool, str
        Whether the first-order conditions hold, and a sentence on the end of the computation.
    multipliers : dict of str to array
        Multipliers of the boundary constraints by name, shape ``(k,)``, and of a given ``horizon``. The cost changes by
        :math:`\mu e` if ``b = 0`` becomes ``b = -e``.
    statistics : Statistics
        Iterations and seconds.
    """

    phases: tuple[Solution, ...]
    cost: float
    success: bool
    result: str
    multipliers: dict[str, np.ndarray]
    statistics: Statistics

    @classmethod
    def of(cls, phases: Sequence[Solution], multipliers: dict[str, np.ndarray], success: bool, result: str) -> Self:
        """The record of phases, each of which begins at time zero or at its own time.

        Parameters
        ----------
        phases : sequence of Solution
            The solutions.
        multipliers : dict of str to array
            The multipliers of the boundary constraints.
        success, result : bool, str
            The status of all phases together.
        """
        begins = np.cumsum([0.0, *(phase.horizon for phase in phases)])
        moved = tuple(_at(phase, float(begin)) for phase, begin in zip(phases, begins, strict=False))
        cost = sum(phase.cost for phase in phases)
        return cls(moved, cost, success, result, multipliers, phases[0].statistics)

    @property
    def times(self) -> np.ndarray:
        """The times at which phases begin, and the time at which the last phase ends, shape ``(P + 1,)``."""
        return np.array([*(phase.times[0] for phase in self.phases), self.phases[-1].times[-1]])

    @property
    def durations(self) -> np.ndarray:
        """The durations of the phases, shape ``(P,)``."""
        return np.diff(self.times)

    @property
    def horizon(self) -> float:
        """The sum of all durations."""
        return float(self.times[-1])

    @property
    def strict_minimum(self) -> bool:
        """Whether the extremal is shown to be a strict local minimum of the discrete problem of all phases together."""
        return self.success and all(phase.checks.strict_minimum for phase in self.phases)

    @property
    def status(self) -> Status:
        """The status of all phases together: ``"minimum"``, ``"stationary"`` or ``"failed"``."""
        return status_of(self.success, self.strict_minimum)

    def __call__(self, t: float) -> Sample:
        """States, controls and costates at a time, of the phase at that time; at the end of a phase, of the next
        phase.

        Parameters
        ----------
        t : float
            The time.
        """
        time = float(checked_times(t, self.times))
        k = int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.phases) - 1))
        return self.phases[k](time)

    def report(self) -> None:
        """A print of the figures of the solution."""
        print(self)

    def __repr__(self) -> str:
        """The essential numbers."""
        spans = ", ".join(f"{a:.6g}..{b:.6g}" for a, b in zip(self.times, self.times[1:], strict=False))
        return (
            f"PhasedSolution({len(self.phases)} phases, times {spans}; cost={self.cost:.12g}, status={self.status!r})"
        )

    def __str__(self) -> str:
        """The figures that a user checks, of all phases and of each phase."""
        kind = "strict local minimum" if self.strict_minimum else "not shown to be a strict local minimum"
        rows = [
            ("result", self.result),
            ("cost", f"{self.cost:.12g}"),
            ("times", ", ".join(f"{t:.9g}" for t in self.times)),
            ("second order", f"{kind} of the discrete problem of all phases (inertia of the KKT matrix)"),
            *(
                ("boundary", f"{name}: multipliers {np.array2string(row, precision=8)}")
                for name, row in self.multipliers.items()
            ),
        ]
        parts = (f"phase {k}\n{phase}" for k, phase in enumerate(self.phases))
        return "\n\n".join([table(rows), *parts])

    def require_success(self) -> "PhasedSolution":
        """This solution; raises ``ConvergenceError`` with its result if the conditions are not met."""
        if not self.success:
            row = "report", "print(error.solution), or solve_phases(..., throw=False), which returns this solution"
            raise ConvergenceError(f"{self.result}\n{table([('cost', f'{self.cost:.9g}'), row])}", self)
        return self


def _at(phase: Solution, begin: float) -> Solution:
    """The phase with times that begin there."""
    move = begin - phase.times[0]
    return replace(phase, times=phase.times + move, stage_times=phase.stage_times + move)
