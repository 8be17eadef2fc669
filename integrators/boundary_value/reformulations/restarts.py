"""Restarts: more searches for a member of a batch, where the search from its guess finds no minimum.

Each restart is a search from another iterate, or with other options. Its result counts if it is an extremal with a
lower cost. The iterations of all searches add up.
"""

from collections.abc import Callable

import numpy as np

from ....compute.binding.structs import Residual
from ....manifolds.numerics.ambient import taken
from ..inputs.options import Options
from ..transcription.discrete_phase import LinkedPhases
from ..transcription.iterate import LinkedIterate
from ..transcription.member_search import MemberSearch, Watch
from ..transcription.rollout import rollout
from ..transcription.search_record import MemberIterate, SearchRecord

LARGER = 1e2  # times the usual first penalty of excesses
NEAR = 1e-2  # residuals from which a step of Newton's own leads to an extremal
NARROW = 1e-2  # width of the funnel of a search from a trajectory without infeasibility


def search_member(problem: LinkedPhases, guess: LinkedIterate, options: Options, watch: Watch, k: int) -> SearchRecord:
    """The result of the search from the guess of member ``k`` of a batch, or of the best restart."""
    member = MemberSearch(problem, guess, k, (options.tolerance, options.max_iterations), watch)
    found = first = member.from_guess()
    for restart in RESTARTS:
        if watch.stopped or (found.facts.converged and found.facts.strict) or not options.restarts():
            break
        try:
            found = restart(member, first, found)
        except KeyboardInterrupt:
            watch.stop()
    return found


def from_degenerate_guess(member: MemberSearch, first: SearchRecord, found: SearchRecord) -> SearchRecord:
    """Degenerate guess without a perturbation, where the perturbed guess led to nothing: its result may say why."""
    return _better(member, found, member.guess, True) if first.perturbed and _says_nothing(found) else found


def from_perturbed_guess(member: MemberSearch, first: SearchRecord, found: SearchRecord) -> SearchRecord:
    """Perturbed guess: the guess may run through the middle of an obstacle, or its controls may not move a state that
    has to move."""
    if first.perturbed or first.first is None or not _says_nothing(found):
        return found
    perturbed, worth = member.perturb(first.first)
    return _better(member, found, perturbed, True) if worth else found


def from_slow_convergence(member: MemberSearch, first: SearchRecord, found: SearchRecord) -> SearchRecord:
    """Newton's steps from an iterate near an extremal that is no minimum, where the iteration limit came.

    A new search begins without regularisation, with which steps converge only linearly.
    """
    return _better(member, found, found.iterate) if _is_near(found) and not found.facts.inertia_correct else found


def from_feasible_trajectory(member: MemberSearch, first: SearchRecord, found: SearchRecord) -> SearchRecord:
    """Feasibility restoration phase [Waechter, Biegler 2006, 3.3], then a search in a narrow funnel.

    The phase leads to a trajectory near the guess on which the equations hold, whatever the cost. If the inequalities
    hold there too, the problem is not infeasible. Without controls there is one feasible trajectory for each start
    and parameters, and only a minimum is the best fit.
    """
    controlled = any(phase.transcription.controls.dimension for phase in member.problem.phases)
    settled = found.facts.converged or _is_near(found) if controlled else found.facts.converged and found.facts.strict
    if settled or found.facts.diverging:
        return found
    restored, iterate = member.restore(member.guess.bare)
    found = found.with_facts(iterations=found.facts.iterations + restored.trials)
    if restored.feasible:
        found = _better(member, found, iterate.bare, width=NARROW)
    return found.with_facts(infeasible=found.facts.infeasible and not restored.holds)


def from_forward_simulation(member: MemberSearch, first: SearchRecord, found: SearchRecord) -> SearchRecord:
    """Forward simulation of the controls of the guess: all equations hold but for the end.

    Guessed states that do not fit the controls, such as a constant height, may lie where no control acts.
    """
    if not _is_open(found):
        return found
    place = np.array([member.k])
    phases = [phase.of(place) for phase in member.problem.phases]
    parts = [rollout(phase, taken(part, place)) for phase, part in zip(phases, member.parts, strict=True)]
    finite = [part for part in parts if part is not None]
    if len(finite) < len(parts):
        return found
    return _better(member, found, member.iterate_of(phases, finite, 0))


def with_larger_penalty(member: MemberSearch, first: SearchRecord, found: SearchRecord) -> SearchRecord:
    """Larger penalty and barrier: with small values the cost may drive free quantities to their bounds before the
    equations hold, and the excesses grow."""
    limited = any(phase.transcription.inequalities for phase in member.problem.phases)
    return _better(member, found, member.guess.bare, penalty_scale=LARGER) if limited and _is_open(found) else found


# In their order, with tests that need them.
RESTARTS: tuple[Callable[[MemberSearch, SearchRecord, SearchRecord], SearchRecord], ...] = (
    from_degenerate_guess,  # test_a_norm_at_rest_is_named_with_its_place
    from_perturbed_guess,  # test_a_guess_through_the_middle_of_an_obstacle_is_led_around
    from_slow_convergence,  # test_great_circles_beyond_half_a_turn_are_found_from_guesses_on_them
    from_feasible_trajectory,  # test_dynamic_soaring_is_not_contradictory
    from_forward_simulation,  # test_a_skip_through_the_atmosphere_is_found_from_a_constant_height
    with_larger_penalty,  # test_dynamic_soaring_is_not_contradictory
)


def _better(
    member: MemberSearch,
    found: SearchRecord,
    start: MemberIterate,
    anything: bool = False,
    width: float = 1.0,
    penalty_scale: float = 1.0,
) -> SearchRecord:
    """The result of a search from an iterate if it is an extremal that costs less, or ``anything``; else the result so
    far."""
    if member.watch.stopped:
        return found
    again = member.from_iterate(start, width, penalty_scale)
    anything = anything and not member.watch.stopped  # a search that was stopped may not have begun
    better = anything or (again.facts.converged and not (found.facts.converged and again.cost >= found.cost))
    return (again if better else found).with_facts(iterations=found.facts.iterations + again.facts.iterations)


def _says_nothing(found: SearchRecord) -> bool:
    """Whether a result is neither an extremal nor infeasible: then the result of any other search says as much."""
    return not (found.facts.converged or found.facts.infeasible)


def _is_near(found: SearchRecord) -> bool:
    """Whether the iteration limit came near to an extremal."""
    return (
        not found.facts.converged
        and found.facts.iteration_limit_reached
        and bool(found.residuals[Residual.BARRIER_ERROR] <= NEAR)
    )


def _is_open(found: SearchRecord) -> bool:
    """Whether no search came near to an extremal, and the cost has a lower bound."""
    return not (found.facts.converged or _is_near(found) or found.facts.diverging)
