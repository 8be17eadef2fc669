"""Searches of the compiled core for one member of a batch, each from one iterate."""

from collections.abc import Sequence
from functools import cached_property, partial
from typing import Any, final

import numpy as np

from ....compute.binding.multiphase import Multiphase
from ....compute.binding.search import Feasibility, Search, SearchResult, SearchStatus
from ..iteration_reports import Iteration, stops
from .core_transcription import arrays_of_member, coupled_ends, numbers_of, transcription_of
from .discrete_phase import DiscretePhase, LinkedPhases
from .iterate import Iterate, LinkedIterate
from .search_record import MemberIterate, PhaseRecord, SearchRecord


@final
class Watch:
    """The callback of searches, and whether that, or an interrupt, has asked for an end."""

    def __init__(self, callback: Any) -> None:
        self.callback, self.stopped = callback, False

    def stop(self) -> None:
        """All searches are to end with their iterates."""
        self.stopped = True

    def report(self, k: int, iteration: Any) -> bool:
        """Show an iteration of a member to the callback; whether the search is to end."""
        if self.stopped or self.callback is None:
            return self.stopped
        names = "cost", "defect", "stationarity", "regularisation", "fraction", "descends", "violation", "barrier"
        seen = (np.array([getattr(iteration, name)]) for name in names)
        return stops(self.callback(Iteration(iteration.number, np.array([k]), *seen)))


@final
class MemberSearch:
    """The searches of one member of a batch, in one thread.

    ``tolerance``, ``max_iterations`` of each of them; ``watch``: of the whole batch.
    """

    def __init__(
        self, problem: LinkedPhases, guess: LinkedIterate, k: int, options: tuple[float, int], watch: Watch
    ) -> None:
        self.problem, self.k, self.watch, self.parts = problem, k, watch, guess.parts
        self._multipliers, self._options = guess.multipliers[k], options
        transcriptions, coupling = list(map(transcription_of, problem.phases)), problem.coupling
        self._multiphase = Multiphase(transcriptions, None if coupling is None else coupled_ends(coupling))

    @cached_property
    def guess(self) -> MemberIterate:
        """The guess of the member."""
        return self.iterate_of(self.problem.phases, self.parts, self.k)

    def iterate_of(self, phases: Sequence[DiscretePhase], guess: Sequence[Iterate], k: int) -> MemberIterate:
        """The iterate of the member, at place k of phases and of guesses."""
        phase_iterates = tuple(numbers_of(phase, part, k) for phase, part in zip(phases, guess, strict=True))
        return MemberIterate(phase_iterates, self._multipliers)

    def from_guess(self) -> SearchRecord:
        """The result of a search from the guess, or from a perturbed one where the guess is degenerate."""
        search = self._search(detect_degenerate=True)
        for j, (phase, part) in enumerate(zip(self.problem.phases, self.parts, strict=True)):
            search.phase(j).take(arrays_of_member(phase, part, self.k))
        search.multipliers()[...] = self._multipliers
        return self._record(search, self._run(search) is SearchStatus.DEGENERATE)

    def from_iterate(self, start: MemberIterate, width: float = 1.0, penalty_scale: float = 1.0) -> SearchRecord:
        """The result of a search from an iterate.

        ``width``, ``penalty_scale``: see ``Search``.
        """
        search = self._search(start, width, penalty_scale)
        self._run(search)
        return self._record(search, False)

    def perturb(self, first: MemberIterate) -> tuple[MemberIterate, bool]:
        """The first iterate of a search, perturbed; and whether another search from there is worth it."""
        search = self._search(first)
        worth = search.perturb()
        return self._iterate(search).bare, worth

    def restore(self, start: MemberIterate) -> tuple[Feasibility, MemberIterate]:
        """The result of a feasibility phase from an iterate, and the trajectory that it ended with."""
        search = self._search(start)
        found = search.restore(self._options[1])
        if found.stopped:
            self.watch.stop()
        return found, self._iterate(search)

    def _search(
        self,
        start: MemberIterate | None = None,
        width: float = 1.0,
        penalty_scale: float = 1.0,
        detect_degenerate: bool = False,
    ) -> Search:
        """A search that begins at an iterate, if there is one."""
        search = Search(
            self._multiphase,
            *self._options,
            width,
            penalty_scale,
            detect_degenerate,
            partial(self.watch.report, self.k),
        )
        if start is not None:
            for j, phase_iterate in enumerate(start.phases):
                search.phase(j).set_iterate(phase_iterate)
            search.multipliers()[...] = start.multipliers
        return search

    def _run(self, search: Search) -> SearchStatus:
        """The first status of a search, which goes on from a perturbed guess where the guess is degenerate."""
        try:
            status = last = search.run()
            if status is SearchStatus.DEGENERATE:
                search.perturb()
                last = search.run()
        except KeyboardInterrupt:
            self.watch.stop()
            status = last = SearchStatus.STOPPED
            if not search.read().facts.iterations:  # the values of the guess are not complete
                search.run()  # ends behind the evaluation of the guess
        if last is SearchStatus.STOPPED:
            self.watch.stop()
        return status

    def _iterate(self, search: Search) -> MemberIterate:
        """A copy of the iterate of a search."""
        phase_iterates = tuple(search.phase(j).iterate for j in range(len(self.problem.phases)))
        return MemberIterate(phase_iterates, search.multipliers().copy())

    def _record(self, search: Search, perturbed: bool) -> SearchRecord:
        """The record of a search that has ended."""
        results = [search.read(j) for j in range(len(self.problem.phases))]
        first_result = results[0]
        if first_result.facts.stopped:
            self.watch.stop()
        missing = [result.trajectory["MAX_DEFECTS"] / result.judging.nodes for result in results]
        if self.problem.coupling is not None:
            missing.append(np.abs(first_result.values) / first_result.equations)
        first = None
        if not (first_result.facts.converged and first_result.facts.strict):
            first = MemberIterate(
                tuple(result.first.copy() for result in results), search.multipliers(first=True).copy()
            )
        return SearchRecord(
            tuple(map(_phase_record, results)),
            search.multipliers().copy(),
            first_result.residuals.copy(),
            missing[0] if len(missing) == 1 else np.concatenate(missing),
            first_result.jacobian.copy(),
            first,
            perturbed,
            first_result.facts,
        )


def _phase_record(found: SearchResult) -> PhaseRecord:
    """The record of a phase, whose arrays no other search overwrites."""
    at = found.trajectory
    arrays = at["NODES"].copy(), at["NODE_COSTATES"].copy(), at["TOTALS"].copy(), at["LIMITS"].copy()
    return PhaseRecord(*arrays, at.iterate, found.judging.copy, found.steps.copy, found.limits.copy(), found.rate)
