"""Trajectories in phases, each with its own problem, method and duration, linked to one another and solved as one
problem."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, final

import jax.numpy as jnp
import numpy as np

from ....compute.compile_time import Stopwatch
from ....manifolds import InvalidInputError
from ....manifolds.numerics.ambient import is_finite_number
from ....tracing import reads_once
from ...problem.argument_errors import require_known_options
from ...problem.boundary_conditions import BoundaryConditions, boundary_values, boundary_words, linkage
from ...problem.free_quantities import guess_of, is_free, with_guess, with_scaled_guess
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.user_functions import require_concrete
from ...reporting.text import brief, plural
from ..audit import status
from ..audit.independence_of_boundary_conditions import equation_words
from ..inputs.arguments import Method, check_problem
from ..inputs.options import Options
from ..iteration_reports import Iteration
from ..reformulations.free_quantity_solver import MAGNITUDES
from ..reformulations.reformulation import Reformulation
from ..regular_extremals import find_phases
from ..solution.diagnostics import add_compile_time
from ..solution.multiphase_solution import PhasedSolution
from ..transcription.discrete_extremals import DiscreteExtremals
from ..transcription.discrete_phase import LinkedPhases
from ..transcription.functions.linked_ends import Link
from ..transcription.iterate import Iterate
from ..transcription.linkages import PhaseProblem, linkages_of
from .phase_guess import guess_phases
from .phase_transcription import PhaseEnds, PhaseTranscription, TranscribedPhase, transcribe_phase

HORIZON_NAME = "horizon"
TOO_FAR = 1e6  # from its guess, without success: a duration that tends to zero or grows without bound
FARTHEST = 1e10  # from the guess that was given, with success


@final
class Phase(NamedTuple):
    """A phase of a trajectory: a problem over a duration, with the method and the steps that discretize it.

    Parameters
    ----------
    problem : OptimalControlProblem
        The dynamics, the cost and the constraints.
    method : Gauss or DiscretizationMap
        The discretization.
    steps : int or array_like of shape (N,)
        The number of steps, or their relative lengths.
    duration : float or Free
        The duration.
    start, end : point, None or Free, optional
        Prescribed ends, as in ``solve``; None if only links and boundary constraints fix them.
    guess : Guess or Solution, optional
        By default the curve between the known ends.
    parameters : pytree, optional
        As in ``solve``.

    Examples
    --------
    >>> line = Euclidean(1)
    >>> moved = OptimalControlProblem(line, lambda q, u: u, lambda q, u: u @ u / 2, controls=1)
    >>> outward = Phase(moved, Midpoint(Addition(line)), steps=4, duration=1.0, start=0.0)
    >>> outward.duration, outward.end
    (1.0, None)
    """

    problem: OptimalControlProblem
    method: Method
    steps: Any
    duration: Any
    start: Any = None
    end: Any = None
    guess: Any = None
    parameters: Any = None


@require_known_options
@reads_once
def solve_phases(
    phases: Sequence[Phase],
    links: Sequence[Any] | None = None,
    horizon: float | None = None,
    boundary_constraints: Mapping[str, Callable[[list[PhaseEnds]], Any]] | None = None,
    guess: PhasedSolution | None = None,
    tolerance: float | None = None,
    max_iterations: int = 100,
    throw: bool = True,
    callback: Callable[[Iteration], Any] | None = None,
    verbose: bool = False,
) -> PhasedSolution:
    """Solve phases that follow one another as one optimal control problem with the sum of their costs.

    Parameters
    ----------
    phases : sequence of Phase
        The phases in order.
    links : sequence of bool or callable, optional
        For each phase and the next: True, the default, if the next begins where this one ends. A function ``g`` if it
        begins at ``g(q)``, such as at the staging of a rocket; False for no link. One more link, from the last phase to
        the first, makes the phases periodic.
    horizon : float, optional
        The sum of all durations.
    boundary_constraints : mapping of str to callable, optional
        Functions by name that are zero at a solution, numbers or vectors. Their argument is the list of the ends of all
        phases, each with ``start``, ``end`` and ``duration``.
    guess : PhasedSolution, optional
        A solution to begin from.
    tolerance, max_iterations, throw, callback, verbose
        As in ``solve``.

    Returns
    -------
    PhasedSolution
        The solutions of all phases.

    Raises
    ------
    InvalidInputError, NotOnManifoldError, DomainError, ConvergenceError
        As ``solve``.

    Notes
    -----
    The costate before a link is :math:`Dg^* p` of the costate after it. With free durations and no explicit time, the
    Hamiltonian is continuous. The time of functions with an explicit time continues from phase to phase.

    Examples
    --------
    >>> line = Euclidean(1)
    >>> moved = OptimalControlProblem(line, lambda q, u: u, lambda q, u: u @ u / 2, controls=1)
    >>> first, last = (Phase(moved, Midpoint(Addition(line)), steps=4, duration=1.0) for _ in range(2))
    >>> flown = solve_phases([first._replace(start=0.0), last._replace(end=2.0)])
    >>> round(flown.cost, 6), [len(phase.t) for phase in flown.phases]
    (1.0, [5, 5])
    """
    require_concrete("solve_phases", guess)
    options = Options.of(tolerance, max_iterations, callback, verbose)
    if horizon is not None and not (is_finite_number(horizon) and horizon > 0):
        raise InvalidInputError(
            f"horizon must be a positive finite time, the sum of all durations, or None, got {horizon!r}"
        )
    given = _check_phases(phases, guess)
    between = _check_links(links, given), _check_constraints(boundary_constraints, len(given))
    trajectory = LinkedTrajectory(*between, horizon, options)
    solution = trajectory.solve_at_any_magnitude(guess_phases(given, trajectory.links))
    return solution.require_success() if throw else solution


class _PosedPhases(NamedTuple):
    """Phases as equations, and the coupling of their ends."""

    parts: list[TranscribedPhase]
    problem: LinkedPhases
    owns: list[PhaseProblem]
    sizes: dict[str, int]  # of the equations between the ends of all phases, by their names
    seconds: float  # to trace


_Found = tuple[list[DiscreteExtremals], np.ndarray, tuple[float, float]]  # with multipliers of links, and seconds


@final
class LinkedTrajectory(Reformulation[Sequence[Phase], _PosedPhases, _Found, PhasedSolution]):
    """Phases as one trajectory: equations of all phases, and links and boundary constraints between their ends."""

    def __init__(self, links: list[Any], constraints: dict[str, Any], horizon: float | None, options: Options) -> None:
        self.links, self.constraints, self.horizon, self.options = links, constraints, horizon, options
        self.made = PhaseTranscription(options)

    def solve_at_any_magnitude(self, phases: Sequence[Phase]) -> PhasedSolution:
        """The extremal, from durations of another magnitude if there is none from the guessed durations."""
        first = self._solve(phases)
        free = any(is_free(phase.duration) for phase in phases) and self.horizon is None
        if not free or status.is_final(first):
            return first
        for factor in MAGNITUDES:
            durations = [with_scaled_guess(phase.duration, factor) for phase in phases]
            if all(duration is not None for duration in durations):
                pairs = zip(phases, durations, strict=True)
                scaled_phases = [phase._replace(duration=duration) for phase, duration in pairs]
                found = self._solve(scaled_phases)
                if status.is_final(found) and not (found.success and _find_far_durations(phases, found, FARTHEST)):
                    return found
        return first

    def _solve(self, phases: Sequence[Phase]) -> PhasedSolution:
        """The extremal from guesses of all phases, without success where durations vanish or grow without bound."""
        solution = self.solve(phases, self._search)
        lost = _find_far_durations(phases, solution, FARTHEST if solution.success else TOO_FAR)
        return self._reject_vanishing(phases, status.fail_of_durations(solution, _names(lost)) if lost else solution)

    def _reject_vanishing(self, phases: Sequence[Phase], solution: PhasedSolution) -> PhasedSolution:
        """The solution, without success where durations tend to zero that nothing but their costs determines."""
        if self.horizon is not None or self.constraints or solution.statistics.stopped:
            return solution
        free = (k for k, phase in enumerate(phases) if is_free(phase.duration))
        lost = [k for k in free if self.made.vanishes(phases[k], solution.phases[k])]
        if not lost:
            return solution
        return status.fail_at_zero(solution, f"The duration of {_names(lost)}", solution.phases[lost[0]].horizon)

    def apply(self, data: Sequence[Phase]) -> _PosedPhases:
        """The phases as equations, each from its guess."""
        began = time.perf_counter()
        begins = np.cumsum([0.0, *(float(guess_of(phase.duration)) for phase in data)])
        parts = [
            transcribe_phase(k, phase, float(begin), self.made, self._is_repeated(k, data))
            for k, (phase, begin) in enumerate(zip(data, begins, strict=False))
        ]
        owns = [PhaseProblem(part.inner.problem, part.own.known.parameters) for part in parts]
        sizes = dict[str, int]()
        coupling = linkages_of(
            owns, self.made.evaluator, self._links(parts), lambda *at: self._equations(parts, sizes, *at)
        )
        problem = LinkedPhases(tuple(part.transcribed.conditions for part in parts), coupling)
        return _PosedPhases(parts, problem, owns, sizes, time.perf_counter() - began)

    def guess(self, data: Sequence[Phase], posed: _PosedPhases) -> tuple[Iterate, ...]:
        """The guess of each phase."""
        return tuple(part.transcribed.guess for part in posed.parts)

    def _search(self, posed: _PosedPhases, guess: tuple[Iterate, ...]) -> _Found:
        """The extremals of all phases together."""
        boundary = [f"{name}[{i}]" for name, size in posed.sizes.items() for i in range(size)]
        names = [*equation_words(posed.owns), *boundary]
        with np.errstate(all="ignore"), Stopwatch() as watch:  # what is not finite is judged
            return *find_phases(posed.problem, guess, posed.owns, names, self.options), watch.seconds()

    def recover(self, posed: _PosedPhases, found: _Found) -> PhasedSolution:
        """The solutions of the phases, and the multipliers of the boundary constraints between them."""
        extremals, multipliers, (compiling, running) = found
        with np.errstate(all="ignore"), Stopwatch() as watch:
            pairs, seconds = zip(posed.parts, extremals, strict=True), (posed.seconds + compiling, running)
            free = any(is_free(part.inputs.given.horizon) for part in posed.parts)
            solutions = [part.recover(extremal, seconds, free) for part, extremal in pairs]
            solutions = [add_compile_time(solution, watch.seconds()[0]) for solution in solutions]
        first = sum(sum(phase_problem.sizes.values()) for phase_problem in posed.owns)
        cuts = first + np.cumsum([0, *posed.sizes.values()])
        named = {name: multipliers[0, a:b] for name, a, b in zip(posed.sizes, cuts[:-1], cuts[1:], strict=True)}
        return PhasedSolution.of(solutions, named, *status.phases_status(solutions))

    def _is_repeated(self, k: int, phases: Sequence[Phase]) -> bool:
        """Whether a phase begins at the last node of one with the same problem and parameters."""
        if not k and len(self.links) < len(phases):  # the last one is not linked with the first
            return False
        before, phase = phases[k - 1], phases[k]
        return self.links[k - 1] is True and before.problem is phase.problem and before.parameters is phase.parameters

    def _links(self, parts: list[TranscribedPhase]) -> list[Link]:
        """The links between phases."""
        between = []
        for k, link in enumerate(self.links):
            if link is not False:
                after = (k + 1) % len(parts)
                between.append(_link(k, after, link, parts))
        return between

    def _equations(
        self, parts: list[TranscribedPhase], sizes: dict[str, int], ends: list[Any], given: list[Any]
    ) -> Any:
        """The boundary constraints of all phases, the sum of the durations, and the times at which phases begin."""
        each = [part.ends(a, b) for part, a, b in zip(parts, ends[::2], ends[1::2], strict=True)]
        values = {name: boundary_values(name, function(each)) for name, function in self.constraints.items()}
        if self.horizon is not None:
            values[HORIZON_NAME] = jnp.reshape(sum(phase_ends.duration for phase_ends in each) - self.horizon, 1)
        passed: Any = 0.0
        for k, (part, own) in enumerate(zip(parts, each, strict=True)):
            if k and part.solver.problem.time_dependent:
                values[_start_words(k)] = jnp.reshape(part.time(ends[2 * k]) - passed, 1)
            passed = passed + own.duration
        sizes.update({name: value.shape[0] for name, value in values.items()})
        return jnp.concatenate([jnp.zeros(0), *values.values()])


def _names(phases: Sequence[int]) -> str:
    """The names of these phases."""
    return " and ".join(f"phase {k}" for k in phases)


def _start_words(k: int) -> str:
    """The name of the equation that says when a phase begins."""
    return f"start of phase {k}"


def _link(before: int, after: int, link: Any, parts: list[TranscribedPhase]) -> Link:
    """The link from the end of a phase to the start of another."""
    one, other = parts[before], parts[after]
    name, manifold = f"links[{before}]", other.solver.problem.manifold
    turn = (lambda q: q) if link is True else link
    return Link(
        manifold, 2 * before + 1, 2 * after, lambda y, _: linkage(name, turn, manifold, one.state(y)), other.state
    )


def _check_phases(phases: Any, guess: Any) -> list[Phase]:
    """The phases, with the guesses of a solution."""
    if not (isinstance(phases, Sequence) and len(phases) and all(isinstance(phase, Phase) for phase in phases)):
        raise InvalidInputError(
            f"solve_phases takes a list of at least one Phase, got {brief(phases)}; try [Phase(problem, ...)]"
        )
    for k, phase in enumerate(phases):
        check_problem(phase.problem, phase.method)
        duration = guess_of(phase.duration)
        if not (is_finite_number(duration) and duration > 0):
            raise InvalidInputError(
                f"phase {k}: duration must be a positive finite time, or Free, got {brief(phase.duration)}"
            )
    if guess is None:
        return list(phases)
    if not (isinstance(guess, PhasedSolution) and len(guess.phases) == len(phases)):
        raise InvalidInputError(
            f"guess must be a PhasedSolution of {plural(len(phases), 'phase')}, got {brief(guess)}; try what "
            "solve_phases returned for phases like these"
        )
    return [_with_near_guess(phase, solution) for phase, solution in zip(phases, guess.phases, strict=True)]


def _with_near_guess(phase: Phase, solution: Any) -> Phase:
    """The phase with guesses as they were found."""
    return phase._replace(duration=with_guess(phase.duration, solution.horizon), guess=solution)


def _find_far_durations(phases: Sequence[Phase], solution: PhasedSolution, far: float) -> list[int]:
    """The phases whose duration is further than so many times from its guess."""
    free = [k for k, phase in enumerate(phases) if is_free(phase.duration)]
    return [k for k in free if not 1 / far < solution.phases[k].horizon / phases[k].duration.guess < far]


def _check_links(links: Any, phases: list[Phase]) -> list[Any]:
    """The links, each True, False or a function."""
    count = len(phases)
    given = [True] * (count - 1) if links is None else links
    if not (isinstance(given, Sequence) and len(given) in (count - 1, count)):
        raise InvalidInputError(
            f"links must be a list of {count - 1}, one from each phase to the next, or one more from the last to the "
            f"first, got {brief(links)}"
        )
    for k, link in enumerate(given):
        if not (isinstance(link, bool) or callable(link)):
            raise InvalidInputError(
                f"links[{k}] must be True for a continuous state, a function of the state before it, or False, got "
                f"{brief(link)}"
            )
        one, other = (phases[at].problem.manifold for at in (k, (k + 1) % count))
        if link is True and one.ambient != other.ambient:
            raise InvalidInputError(
                f"links[{k}] is True for a continuous state, and leads from {one} to {other}; expected one manifold; "
                "try a function that makes of a point of the one a point of the other"
            )
    return list(given)


def _check_constraints(given: Any, count: int) -> dict[str, Any]:
    """The boundary constraints of so many phases."""
    functions = BoundaryConditions.of(given, False, (HORIZON_NAME, *map(_start_words, range(count))))
    for name, function in zip(functions.names, functions.functions, strict=True):
        if not callable(function):
            raise InvalidInputError(
                f"{boundary_words(name)} must be a function of the ends of all phases, got {brief(function)}"
            )
    return dict(zip(functions.names, functions.functions, strict=True))
