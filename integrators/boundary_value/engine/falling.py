"""Whether a cost falls as if it had no lower bound."""

from typing import final

import numpy as np

FALLEN = 1e2  # times the unit of the cost: a fall of less is none
FEWEST = 20  # trials: of fewer nothing is said


@final
class Fall:
    """The costs of the members of a batch, trial after trial."""

    def __init__(self) -> None:
        self._seen: list[tuple[int, np.ndarray, np.ndarray | float]] = []

    def note(self, trials: int, members: np.ndarray, costs: np.ndarray) -> None:
        """Keep the costs of the members that are on their way after so many trials."""
        self._seen.append((trials, members, np.array(costs)))  # of their own: others lie in the memory of a pass

    def note_all(self, first: int, members: np.ndarray, costs: list[float]) -> None:
        """The same of trials of a single member, the first of which is this one."""
        self._seen += [(first + k, members, cost) for k, cost in enumerate(costs)]

    def lasts(self, which: np.ndarray, unit: np.ndarray) -> np.ndarray:
        """Which members end with a cost that has fallen by far, and in the second half of their trials by no less than
        in the first; only those ``which`` are looked at. ``unit``: of the cost of each.

        One with a lower bound falls by less and less on the way to it.
        """
        found = np.zeros(len(which), bool)
        for member in np.flatnonzero(which):
            own = [(trials, np.atleast_1d(costs)[members == member]) for trials, members, costs in self._seen]
            trials, costs = np.array([(k, cost[0]) for k, cost in own if cost.size]).reshape(-1, 2).T
            if not trials.size:  # it was interrupted before
                continue
            middle = max(0, int(np.searchsorted(trials, trials[-1] / 2, "right")) - 1)
            early, late = costs[0] - costs[middle], costs[middle] - costs[-1]
            far = early + late > FALLEN * unit[member] and trials[-1] >= FEWEST
            found[member] = far and late >= early
        return found
