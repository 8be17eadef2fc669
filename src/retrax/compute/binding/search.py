"""Searches of the compiled core: Newton's method on the conditions of trajectories."""

import signal
from collections.abc import Callable
from ctypes import byref
from enum import IntEnum
from functools import partial
from operator import attrgetter
from threading import current_thread, main_thread
from typing import Any, NamedTuple, final
from weakref import ref

import numpy as np

from ...errors import InvalidInputError
from .library import BYTES, FLOAT, address_of, library
from .multiphase import Multiphase
from .structs import REPORT, IterationStruct, OptionsStruct, SearchResultStruct
from .transcription import IterateNumbers, Scale, Sizes, Trajectory, Transcription, array_places

MOST_ITERATIONS = 1 << 20  # as in search_memory.c
WAVES = 3  # as in perturbed_guess.c


class SearchStatus(IntEnum):
    """How a search has ended; ``retrax_core.h`` explains these."""

    GOING_ON = 0
    CONVERGED = 1
    SINGULAR = 2
    INFEASIBLE = 3
    DEGENERATE = 4
    ITERATION_LIMIT = 5
    STOPPED = 6


@final
class SearchFacts(NamedTuple):
    """Facts on the end of a search, of all phases together; ``retrax_core.h`` explains the fields."""

    iterations: int
    iteration_limit_reached: bool
    converged: bool
    strict: bool
    legendre_holds: bool
    solvable: bool
    infeasible: bool
    diverging: bool
    stopped: bool
    inertia_correct: bool


read_facts = attrgetter(*SearchFacts._fields)


@final
class SearchResult(NamedTuple):
    """The result of a search; ``retrax_core.h`` explains the fields."""

    trajectory: Trajectory
    first: IterateNumbers
    judging: Scale
    steps: Scale
    limits: np.ndarray
    rate: float
    residuals: np.ndarray
    equations: np.ndarray
    values: np.ndarray
    jacobian: np.ndarray  # (r, Z)
    facts: SearchFacts


@final
class Feasibility(NamedTuple):
    """The result of a feasibility phase; ``retrax_core.h`` explains the fields."""

    trials: int
    feasible: bool
    holds: bool
    stopped: bool


@final
class Search:
    """Newton's method on the conditions of one trajectory, or of phases whose ends are coupled.

    ``width``: the first width of the funnel; ``penalty_scale``: times the usual first penalty of excesses;
    ``detect_degenerate``: whether a guess may be called degenerate; ``report``: called after each trial point, asks to
    stop by True.
    The memory is that of the first transcription: one search at a time, and a result holds until the next one begins.
    """

    def __init__(
        self,
        problem: Transcription | Multiphase,
        tolerance: float,
        max_iterations: int,
        width: float = 1.0,
        penalty_scale: float = 1.0,
        detect_degenerate: bool = True,
        report: Callable[[IterationStruct], bool] | None = None,
    ) -> None:
        own = self._library = library()
        self._phases = problem if isinstance(problem, Multiphase) else Multiphase((problem,))
        self._of = self._phases.transcriptions
        address = self._phases.address
        size = own.retrax_search_memory(address, max_iterations)
        if not size:
            raise InvalidInputError(f"a search has 1 to {MOST_ITERATIONS} iterations, got {max_iterations}")
        self._memory = self._of[0].search_room(-(-size // BYTES))
        self._place = address_of(self._memory, FLOAT, self._memory.shape, "memory of a search")
        self._report, self._interrupted = report, False
        self._callback = REPORT(partial(_report, ref(self)))  # C calls it
        options = OptionsStruct(
            tolerance, max_iterations, width, penalty_scale, detect_degenerate, self._callback, None
        )
        best = self._of[0].instruction_set
        self._search = own.retrax_search_make(address, byref(options), best, self._place)

    @property
    def trajectory(self) -> Trajectory:
        """The iterate of the first phase: the guess before a run, the solution behind it."""
        return self.phase(0)

    def phase(self, k: int) -> Trajectory:
        """The iterate of a phase."""
        place = self._library.retrax_search_trajectory(self._search, k)
        return Trajectory(self._of[k], self._part(place, self._of[k].layout.numbers))

    def multipliers(self, first: bool = False) -> np.ndarray:
        """The multipliers of what couples the ends, of the iterate, or of the ``first`` one, a view."""
        if not self._phases.multipliers:
            return np.zeros(0)
        place = self._library.retrax_search_multipliers(self._search, first)
        return self._part(place, self._phases.multipliers)

    def perturb(self) -> bool:
        """Perturb the guess, the first iterate of a search, always in the same way.

        Returns whether a guess that is not degenerate is worth a search from there.
        """
        draws = wave_amplitudes(self._of[0].sizes)
        place = address_of(draws, FLOAT, draws.shape, "amplitudes of waves")
        worth = self._library.retrax_search_perturb(self._search, place)
        self._check()
        return worth

    def run(self) -> SearchStatus:
        """Search an extremal from the guess; an error of the report or of a function, or an interrupt, is raised when
        the search has ended."""
        return SearchStatus(self._call_with_reports(self._library.retrax_search_run))

    def restore(self, max_trials: int) -> Feasibility:
        """Search a feasible trajectory near the guess, whatever it costs, which is the iterate then.

        Errors and interrupts are raised as by ``run``.
        """
        found = self._call_with_reports(self._library.retrax_search_restore, max_trials)
        return Feasibility(*(getattr(found, name) for name in Feasibility._fields))

    def _call_with_reports(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """The result of a function of the core that reports its trials.

        An interrupt asks the search to stop: where C calls Python, nobody could catch it.
        """
        usual, self._interrupted = signal.default_int_handler, False
        noted = current_thread() is main_thread() and signal.getsignal(signal.SIGINT) is usual
        if noted:
            signal.signal(signal.SIGINT, self._note_interrupt)
        try:
            found = function(self._search, *arguments)
        finally:
            if noted:
                signal.signal(signal.SIGINT, usual)
        self._check()
        if self._interrupted:
            raise KeyboardInterrupt
        return found

    def _note_interrupt(self, *_: Any) -> None:
        self._interrupted = True

    def _check(self) -> None:
        """Raise the first error of the report or of a function of a phase."""
        for own in self._of:
            own.failure.check()

    def read(self, phase: int = 0) -> SearchResult:
        """Return the result of the last run, with the arrays of a phase; the next run overwrites these."""
        of = self._of[phase]
        found, layout = self._library.retrax_search_read(self._search, phase), of.layout
        sizes, places = of.sizes, array_places()
        z, residuals = layout.count[places["PARTS"]], layout.count[places["RESIDUALS"]]
        at = Trajectory(of, self._part(found.trajectory, layout.numbers))
        first = IterateNumbers(self._part(found.first, of.iterate_numbers), of.parts)
        judging, steps = [
            Scale(self._part(own.unknowns, z), self._part(own.nodes, sizes.state_size), own.cost)
            for own in (found.judging, found.steps)
        ]
        arrays = self._part(found.limits, sizes.limits), found.rate, self._part(found.residuals, residuals)
        facts = SearchFacts(*read_facts(found))
        return SearchResult(at, first, judging, steps, *arrays, *self._coupling_arrays(found), facts)

    def _coupling_arrays(self, found: SearchResultStruct) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Scaling factors, values and derivatives of the equations between the ends."""
        r, coordinates = self._phases.equations, 2 * sum([of.sizes.state_size for of in self._of])
        if not found.equations:
            return np.zeros(0), np.zeros(0), np.zeros((0, coordinates))
        jacobian = self._part(found.jacobian, r * coordinates).reshape(r, coordinates)
        return self._part(found.equations, r), self._part(found.values, r), jacobian

    def _part(self, place: int, count: int) -> np.ndarray:
        """Numbers of the memory of the search from an address on."""
        first = (place - self._place) // BYTES
        return self._memory[first : first + count]


def wave_amplitudes(sizes: Sizes) -> np.ndarray:
    """The amplitudes by which every degenerate guess is perturbed, shape ``(3, s m)``."""
    return np.random.default_rng(0).standard_normal((WAVES, sizes.points * sizes.control_size))


def search_memory(transcription: Transcription, max_iterations: int) -> int:
    """The bytes of memory of a search of one trajectory with so many iterations."""
    return library().retrax_search_memory(Multiphase((transcription,)).address, max_iterations)


def _report(search: Callable[[], Search | None], _context: int | None, iteration: Any) -> bool:
    """Whether the report, an error of the report or of a function, or an interrupt asks to stop.

    C calls this function after each evaluation.
    """
    owner = search()
    if owner is None:
        return True
    try:
        for phase in owner._of:
            if phase.failure.error is not None:
                return True
        return owner._interrupted or (owner._report is not None and owner._report(iteration.contents))
    except BaseException as error:  # C knows no exceptions
        owner._of[0].failure.error = error
        return True
