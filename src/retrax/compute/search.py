"""Searches of the compiled core: Newton's method on the conditions of one trajectory."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from ctypes import byref
from enum import IntEnum
from functools import partial
from threading import current_thread, main_thread
from typing import Any, NamedTuple, final
from weakref import ref

import numpy as np

from ..errors import InvalidInputError
from .core import BYTES, FLOAT, REPORT, IterationStruct, OptionsStruct, address_of, library
from .transcription import PLACES, Scale, Trajectory, Transcription

MOST_ITERATIONS = 1 << 20  # as in search.c
WAVES = 3  # as in perturbed_guess.c


class SearchStatus(IntEnum):
    """How a search has ended; ``retrax_core.h`` explains these."""

    GOING_ON = 0
    CONVERGED = 1
    SINGULAR = 2
    INFEASIBLE = 3
    ELSEWHERE = 4
    DEGENERATE = 5
    ITERATION_LIMIT = 6
    STOPPED = 7


@final
class SearchResult(NamedTuple):
    """The result of a search; ``retrax_core.h`` explains the fields."""

    trajectory: "Trajectory"
    first: "Trajectory"
    judging: Scale
    steps: Scale
    limits: np.ndarray
    rate: float
    iterations: int
    limited: bool
    claimed: bool
    strict: bool
    convex: bool
    solvable: bool
    infeasible: bool
    falls: bool
    stopped: bool


@final
class Search:
    """Newton's method on the conditions of one trajectory.

    ``width``: the infeasibility that the funnel lets pass first; ``firm``: times the usual first penalty of excesses;
    ``looks``: whether a guess may be called degenerate; ``report``: called after each evaluation, asks to stop by True.
    The memory is the transcription's: one search at a time, and a result holds until the next one begins.
    """

    def __init__(
        self,
        transcription: Transcription,
        tolerance: float,
        max_iterations: int,
        width: float = 1.0,
        firm: float = 1.0,
        looks: bool = True,
        report: Callable[[IterationStruct], bool] | None = None,
    ) -> None:
        own = self._library = library()
        self._of, self._layout = transcription, byref(transcription.layout)
        size = own.retrax_search_memory(self._layout, max_iterations)
        if not size:
            raise InvalidInputError(f"a search has 1 to {MOST_ITERATIONS} iterations, got {max_iterations}")
        self._memory = transcription.search_room(-(-size // BYTES))
        self._place = address_of(self._memory, FLOAT, self._memory.shape, "memory of a search")
        self._report, self._interrupted = report, False
        self._callback = REPORT(partial(_told, ref(self)))  # C calls it
        options = OptionsStruct(tolerance, max_iterations, width, firm, looks, self._callback, None)
        self._search = own.retrax_search_make(self._layout, byref(options), transcription.instruction_set, self._place)

    @property
    def trajectory(self) -> Trajectory:
        """The iterate: the guess before a run, the solution behind it."""
        place = self._library.retrax_search_trajectory(self._search)
        return Trajectory(self._of, self._part(place, self._of.layout.numbers))

    def perturb(self) -> bool:
        """Move the guess aside, always in the same way; whether that hardly moves something that is spread along it."""
        sizes = self._of.sizes
        draws = np.random.default_rng(0).standard_normal((WAVES, sizes.points * sizes.control_size))
        place = address_of(draws, FLOAT, draws.shape, "amplitudes of waves")
        held = self._library.retrax_search_perturb(self._search, place)
        self._of.failure.check()
        return held

    def run(self) -> SearchStatus:
        """Search an extremal from the guess; an error of the report or of a function, or an interrupt, is raised when
        the search has ended."""
        self._interrupted = False
        with self._interrupts():
            status = SearchStatus(self._library.retrax_search_run(self._search))
        self._of.failure.check()
        if self._interrupted:
            raise KeyboardInterrupt
        return status

    @contextmanager
    def _interrupts(self) -> Iterator[None]:
        """A time in which an interrupt asks the search to stop: where C calls Python, nobody could catch it."""
        usual = signal.default_int_handler
        if current_thread() is not main_thread() or signal.getsignal(signal.SIGINT) is not usual:
            yield
            return

        def note(*_: Any) -> None:
            self._interrupted = True

        signal.signal(signal.SIGINT, note)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, usual)

    def _reports(self, iteration: IterationStruct) -> bool:
        """Whether the report, an error of that or of a function, or an interrupt asks to stop."""
        failure = self._of.failure
        try:
            ends = failure.error is not None or self._interrupted
            return ends or (self._report is not None and self._report(iteration))
        except BaseException as error:  # C knows no exceptions
            failure.error = error
            return True

    def read(self) -> SearchResult:
        """Return the result of the last run; the next run overwrites its arrays."""
        found, layout, of = self._library.retrax_search_read(self._search), self._of.layout, self._of
        sizes, z = of.sizes, layout.count[PLACES["PARTS"]]
        at, first = (Trajectory(of, self._part(place, layout.numbers)) for place in (found.trajectory, found.first))
        judging, steps = (
            Scale(self._part(own.unknowns, z), self._part(own.nodes, sizes.state_size), own.cost)
            for own in (found.judging, found.steps)
        )
        limits = self._part(found.limits, sizes.limits)
        told = (getattr(found, name) for name in SearchResult._fields[5:])
        return SearchResult(at, first, judging, steps, limits, *told)

    def _part(self, place: int, count: int) -> np.ndarray:
        """Numbers of the memory of the search from an address on."""
        first = (place - self._place) // BYTES
        return self._memory[first : first + count]


def _told(search: Any, _context: int | None, iteration: Any) -> bool:
    """The report that C calls after each evaluation."""
    own = search()
    return own is None or own._reports(iteration.contents)
