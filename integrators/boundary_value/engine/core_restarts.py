"""Searches of the compiled core behind the interface of ``Descent``, for searches anew from other guesses."""

from collections.abc import Callable, Sequence
from typing import Any, final

import numpy as np

from ....manifolds.numerics.ambient import joined
from ..transcription.core_search import Member, SearchOptions, Watch, iterate_of, perturbed, search_all
from ..transcription.discrete_extremals import DiscreteExtremals
from ..transcription.iterate import Iterate
from ..transcription.iteration import Iteration
from .acceptance import WIDE
from .adaptor import adapted
from .aside import violates
from .barrier import Barrier
from .conditions import Conditions
from .found import Found
from .scaling import Units


def restarted(
    conditions: Conditions, guess: Iterate, members: list[Member], places: np.ndarray, options: Any, watch: Watch
) -> DiscreteExtremals:
    """The extremals of members of a batch, by their places, whose first searches have ended like this."""
    from .newton import newton

    def told(iteration: Iteration) -> Any:
        return options.callback(iteration._replace(members=places[iteration.members]))

    seen = None if options.callback is None else told
    first = CoreSearch(conditions, options.tolerance, options.max_iterations, seen, known=members)
    first.stopped = watch.stopped
    return adapted(conditions, newton(conditions, guess, options.tolerance, options.max_iterations, seen, first))


def take_sizes(conditions: Conditions, members: Sequence[Member], firm: float) -> None:
    """Let conditions have the natural sizes of the iterates of their members."""
    steps = conditions.transcription
    conditions.units = joined([_units(member.result.judging) for member in members])
    conditions.wider = joined([_units(member.result.steps) for member in members])
    conditions.barrier = None
    if steps.inequalities:
        each = ((np.array([own.result.rate]), own.result.limits[None]) for own in members)
        conditions.barrier = joined([Barrier(*own, steps.kept[None].copy(), np.array([firm])) for own in each])


def _units(scale: Any) -> Units:
    return Units(scale.unknowns[None], scale.nodes[None], np.array([scale.cost]))


@final
class CoreSearch:
    """Searches of the members of a batch; see ``Descent``; ``known``: the results of the searches from the guesses."""

    def __init__(
        self,
        conditions: Conditions,
        tolerance: float,
        max_iterations: int,
        callback: Callable[[Iteration], Any] | None,
        as_it_is: bool = False,
        width: float = WIDE,
        firm: float = 1.0,
        known: Sequence[Member] = (),
    ) -> None:
        self.conditions, self.tolerance, self.max_iterations = conditions, tolerance, max_iterations
        self.callback, self.known = callback, known
        self._options = SearchOptions(tolerance, max_iterations, width, firm, not as_it_is)
        self._watch, self.lost = Watch(callback), np.zeros(0, bool)

    @property
    def stopped(self) -> bool:
        """Whether the callback, or an interrupt, has asked for an end."""
        return self._watch.stopped

    @stopped.setter
    def stopped(self, yes: bool) -> None:
        self._watch.stopped = yes

    def ended(self, guess: Iterate) -> Found:
        """The result of the searches from the guesses, which an interrupt ends."""
        conditions, options = self.conditions, self._options
        members = list(self.known) or search_all(conditions, guess, options, self._watch)
        self.lost = np.array([member.perturbed for member in members])
        take_sizes(conditions, members, options.firm)
        steps = conditions.transcription
        self._first, self._guess = [own.first or own.iterate for own in members], guess
        return self._found(joined([iterate_of(own.iterate, guess, steps) for own in members]), members)

    def moved_aside(self) -> tuple[Iterate, np.ndarray]:
        """The guesses moved aside; and which members are worth a search from there, shape (B,)."""
        conditions, guess = self.conditions, self._guess
        moved, held = perturbed(conditions, guess, self._first)
        slacks = joined([iterate_of(first, guess, conditions.transcription) for first in self._first]).slacks
        return moved, held | violates(slacks, held)

    def failed(self, found: Found) -> np.ndarray:
        """Which members have ended without success from guesses that nothing moved aside."""
        return ~(found.claimed | found.contradictory | self.lost | self.stopped)

    def _found(self, iterate: Iterate, members: list[Member]) -> Found:
        conditions = self.conditions
        assembled = conditions.assemble(iterate)
        residuals = conditions.residuals(iterate, assembled)
        names = "strict", "iterations", "limited", "claimed", "solvable", "infeasible", "falls"
        told = (np.array([getattr(member.result, name) for member in members]) for name in names)
        strict, count, limited, claimed, solvable, infeasible, falls = told
        missing, unit = np.stack([member.missing for member in members]), conditions.judging.cost
        ended = strict, count, limited, claimed, solvable, self.stopped, missing, infeasible, unit, falls
        return Found(iterate, assembled, residuals, *ended)
