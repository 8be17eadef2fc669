"""Newton's method on the KKT systems of a batch of trajectories, from their guesses and, where that is worth it, from
others."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ....compute.binding.library import PARTS_ON_CORE
from ....manifolds.numerics.ambient import taken
from ..transcription.iterate import Iterate
from ..transcription.iteration import Iteration
from ..transcription.rollout import rolled_out
from .acceptance import WIDE
from .batches import put
from .conditions import Conditions
from .descent import Descent
from .found import Found
from .own_units import adopted
from .restoration import NARROW, Restoration

FIRM = 1e2  # times the usual price of an excess
NEAR = 1e-2  # residuals from which a step of Newton's own leads to an extremal
OF_MEMBERS = (
    "iterate", "assembled", "residuals", "strict_minimum", "iterations", "limited", "claimed", "solvable", "missing",
    "contradictory", "unit", "falling",
)  # fmt: skip


def newton(
    conditions: Conditions,
    guess: Iterate,
    tolerance: float,
    max_iterations: int,
    callback: Callable[[Iteration], Any] | None = None,
    first: Any = None,
) -> Found:
    """Solve the KKT systems of a batch of trajectories from guesses; ``first``: the search from these.

    Converged where both the gap and the stationarity are at most ``tolerance``, and Newton's next step at most its
    square root: where the system is singular to rounding, residuals say nothing about the distance to a solution, and
    one is claimed only if the trajectory has kept its size. A guess that was moved aside is tried as it is too, and the
    cheaper success counts; one that ends without success is moved aside where its controls hardly move what they have
    to, and where it violates inequalities: it may run through the middle of what it has to go around. Where
    inequalities contradict each other near the guess, or the ends, the trajectory that violates them least is a guess
    once more: its jam may be of the way there. Last comes a feasibility phase, from whose trajectory a search sets out
    in a narrow funnel: nothing is contradictory where it has met everything. Without controls it comes wherever no
    minimum was found. After it come the states to which the controls of the guess lead from its start, then the guess
    with dear excesses and a high barrier.
    """
    search = _search(conditions, tolerance, max_iterations, callback) if first is None else first
    found = search.ended(guess)
    if search.lost.any():
        found = _again(search, found, guess, np.flatnonzero(search.lost))
    if (failed := search.failed(found)).any():
        moved, worth = search.moved_aside()
        found = _again(search, found, moved, np.flatnonzero(failed & worth))
    if (jammed := found.contradictory & ~found.claimed).any():
        found = _again(search, found, found.iterate.bare, np.flatnonzero(jammed))
    found = _restored(search, _crawled(search, found), guess)
    return _firmly(search, _rolled_out(search, found, guess), guess)


def _search(conditions: Any, tolerance: float, most: int, callback: Any, **options: Any) -> Any:
    """The search of the engine, or of the core where that is asked for and has all that it needs."""
    if "search" in PARTS_ON_CORE:
        from ..transcription.core_search import is_on_core
        from . import core_phases
        from .core_restarts import CoreSearch

        if conditions.joint and core_phases.is_on_core(conditions):
            return core_phases.CorePhases(conditions, tolerance, most, callback, **options)
        if is_on_core(conditions):
            return CoreSearch(conditions, tolerance, most, callback, **options)
    return Descent(conditions, tolerance, most, callback, **options)


def _crawled(search: Descent, found: Found) -> Found:
    """What is found from where the iteration limit came near to an extremal, by a step of Newton's own.

    To an extremal that is no minimum, shifted steps come nearer by the same share each. Where the inertia is that of a
    minimum, the limit came on the way there.
    """
    near = np.flatnonzero(_is_near(found))
    if near.size:
        iterate, system = taken((found.iterate, found.assembled), near)
        near = near[~search.conditions.of(near).eliminate(iterate, system, np.zeros(len(near)))[0].convex]
    return _tried(search, found, taken(found.iterate, near), near)


def _is_near(found: Found) -> np.ndarray:
    """Where the iteration limit came near to an extremal."""
    return ~found.claimed & found.limited & (found.residuals.largest <= NEAR)


def _restored(search: Descent, found: Found, guess: Iterate) -> Found:
    """What is found from feasible trajectories near the guesses, where nothing else has found anything; inequalities
    that hold on such a trajectory do not contradict each other.

    Without controls there is a feasible trajectory for each start and parameters, and only a minimum fits best.
    """
    phases = getattr(search.conditions, "phases", (search.conditions,))
    fits = not any(phase.transcription.controls.dimension for phase in phases)
    settled = found.claimed & found.strict_minimum if fits else found.claimed | _is_near(found)
    members = np.flatnonzero(~(settled | found.falling))
    if found.stopped or not members.size:
        return found
    phase = Restoration(search.conditions.of(members), taken(guess, members), search.tolerance, _seen(search, members))
    try:
        feasible = np.flatnonzero(phase.run(search.max_iterations))
    except KeyboardInterrupt:
        return found._replace(stopped=True)
    counts, contradictory = found.iterations.copy(), found.contradictory.copy()
    counts[members] += phase.trials
    found = found._replace(iterations=counts, stopped=phase.stopped)
    found = _tried(search, found, taken(phase.iterate.bare, feasible), members[feasible], width=NARROW)
    contradictory[members] &= ~phase.holds
    return found._replace(contradictory=contradictory)


def _rolled_out(search: Descent, found: Found, guess: Iterate) -> Found:
    """The result of a search from the states to which the controls of the guesses lead, where other searches failed.

    On these the steps meet, and only the end is missed: states of a guess that do not fit its controls, as of a
    constant height, may lie where no control is felt.
    """
    members = np.flatnonzero(_unsettled(found))
    if found.stopped or not members.size:
        return found
    try:
        led, finite = rolled_out(search.conditions.of(members), taken(guess, members))
    except KeyboardInterrupt:
        return found._replace(stopped=True)
    return _tried(search, found, taken(led, np.flatnonzero(finite)), members[finite])


def _firmly(search: Descent, found: Found, guess: Iterate) -> Found:
    """The result of a search from the guesses with dear excesses and a high barrier, where other searches failed.

    With the usual ones the cost may drive what is free to its bounds before the steps meet, and the excesses grow.
    """
    if found.iterate.slacks is None:
        return found
    members = np.flatnonzero(_unsettled(found))
    return _tried(search, found, taken(guess.bare, members), members, firm=FIRM)


def _unsettled(found: Found) -> np.ndarray:
    """Members for which no search has found anything, whose cost has a lower bound."""
    return ~(found.claimed | _is_near(found) | found.falling)


def _seen(search: Descent, members: np.ndarray) -> Callable[[Iteration], Any] | None:
    """The callback of some members."""
    callback = search.callback
    return callback and (lambda iteration: callback(iteration._replace(members=members[iteration.members])))


def _again(search: Descent, found: Found, guess: Iterate, members: np.ndarray) -> Found:
    """What is found where some members begin once more, from guesses as they are, if that is better."""
    anything = ~(found.claimed | found.contradictory)[members]  # elsewhere nothing but a success says more
    return _tried(search, found, taken(guess, members), members, anything)


def _tried(
    search: Descent,
    found: Found,
    guess: Iterate,
    members: np.ndarray,
    anything: np.ndarray | bool = False,
    width: float = WIDE,
    firm: float = 1.0,
) -> Found:
    """What is found where some members begin once more from their guesses, if that is a success and costs less, or
    anything; ``width``: of the funnel."""
    if found.stopped or not members.size:
        return found
    options = search.tolerance, search.max_iterations, _seen(search, members)
    alone = _search(search.conditions.of(members), *options, as_it_is=True, width=width, firm=firm)
    again = alone.ended(guess)
    counts = found.iterations.copy()
    counts[members] += again.iterations
    found, again = found._replace(iterations=counts), again._replace(iterations=counts[members])
    claimed, cost = found.claimed[members], found.assembled.cost[members]
    better = np.flatnonzero(anything | (again.claimed & ~(claimed & (again.assembled.cost >= cost))))
    first, chosen = members[better], {}
    if better.size:
        adopted(search.conditions, alone.conditions.of(better), first, len(found.claimed))
        chosen = {name: put(getattr(found, name), first, taken(getattr(again, name), better)) for name in OF_MEMBERS}
    return found._replace(stopped=again.stopped, **chosen)
