"""Records of the searches of the compiled core for a member of a batch; ``retrax_core.h`` explains the arrays."""

from typing import Any, NamedTuple

import numpy as np

from ....compute.binding.search import SearchFacts
from ....compute.binding.transcription import IterateNumbers, Scale


class MemberIterate(NamedTuple):
    """An iterate of a member in the order of the core: of each phase, and the multipliers of what couples the ends."""

    phases: tuple[IterateNumbers, ...]
    multipliers: np.ndarray

    @property
    def bare(self) -> "MemberIterate":
        """The iterate without the multipliers of inequalities."""
        phases = tuple(phase.copy() for phase in self.phases)
        for phase in phases:
            phase.array("LIMIT_MULTIPLIERS")[...] = 0.0
        return self._replace(phases=phases)


class PhaseRecord(NamedTuple):
    """The result of a search for a phase, in arrays of its own."""

    nodes: np.ndarray
    costates: np.ndarray
    totals: np.ndarray
    limits: np.ndarray
    iterate: IterateNumbers
    judging: Scale  # scaling by which convergence was tested
    steps: Scale  # scaling of steps
    limit_sizes: np.ndarray  # scaling of inequalities
    rate: float  # unit of the barrier


class SearchRecord(NamedTuple):
    """The result of a search for all phases, in arrays of its own."""

    phases: tuple[PhaseRecord, ...]
    multipliers: np.ndarray  # of what couples the ends
    residuals: np.ndarray
    missing: np.ndarray  # largest defects of the nodes of all phases, and of the ends, in units of the scaling
    jacobian: np.ndarray  # of the equations between the ends, by coordinates of all ends
    first: MemberIterate | None  # the guess with first multipliers and slacks, where no minimum was found
    perturbed: bool  # whether the guess was degenerate and was moved aside
    facts: SearchFacts  # with the iterations of this search and of those before it

    @property
    def iterate(self) -> MemberIterate:
        """The last iterate."""
        return MemberIterate(tuple(phase.iterate for phase in self.phases), self.multipliers)

    @property
    def cost(self) -> float:
        """The cost of all phases."""
        return sum(float(phase.totals[0]) for phase in self.phases)

    def with_facts(self, **changes: Any) -> "SearchRecord":
        """The record with other facts."""
        return self._replace(facts=self.facts._replace(**changes))
