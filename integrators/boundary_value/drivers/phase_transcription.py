"""A phase of a trajectory as equations of its method."""

from typing import Any, NamedTuple, final

import jax.numpy as jnp
import numpy as np

from ....compute.automatic import AutomaticEvaluator
from ....compute.base import Evaluator
from ....manifolds import DomainError, InvalidInputError, NotOnManifoldError
from ....manifolds.numerics import ambient as vec
from ...problem.free_quantities import guesses_of
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem_checks.inspection import inspect_problem
from ..audit.audit import Audit
from ..audit.status import explain_failure
from ..guess import Mesh
from ..inputs.arguments import BoundaryData, Method, Options, step_fractions
from ..inputs.inputs import InputReader, Inputs
from ..reformulations.free_quantities import Reformulation
from ..reformulations.free_quantity_solver import SINGULAR_WORDS, ReformulationSolver
from ..reformulations.vanishing_horizons import VanishingHorizon
from ..solution.interpolation import Interpolant
from ..solution.record import Solution
from ..solution_builder import ExtremalRecords, SolutionBuilder
from ..transcription.discrete_extremals import DiscreteExtremals
from ..transcription.transcribed_problem import TranscribedProblem, Transcription

PHASE_ERRORS = InvalidInputError, NotOnManifoldError, DomainError  # errors that are said to be of a phase


class PhaseEnds(NamedTuple):
    """The ends of a phase, the argument of the boundary constraints of ``solve_phases``.

    Attributes
    ----------
    start, end : point
        The first and the last state.
    duration : scalar Array
        The duration.
    """

    start: Any
    end: Any
    duration: Any


@final
class _InnerProblem:
    """The means to solve a phase, in the states of its reformulation."""

    def __init__(
        self, problem: OptimalControlProblem, method: Method, fractions: np.ndarray, evaluator: Evaluator
    ) -> None:
        self.problem, self.transcription = problem, Transcription(problem, method, fractions, evaluator)
        self.interpolant = Interpolant(method.retraction, problem.controls)
        mesh = Mesh(fractions, self.transcription.stages, self.interpolant)
        self._reader = InputReader(problem, method, mesh, evaluator)
        self.builder = SolutionBuilder(problem, self.transcription.stages, self.interpolant)
        self.audit = Audit(problem)
        # Zero: durations come from afar, where one that is one at its guess would pass through zero.
        self.reformulation = ReformulationSolver(self._reader, lambda own: self._of(own, fractions, evaluator), 0.0)

    @staticmethod
    def _of(formulation: Reformulation, fractions: np.ndarray, evaluator: Evaluator) -> "_InnerProblem":
        """The means to solve a reformulation."""
        inner = _InnerProblem(formulation.problem, formulation.method, fractions, evaluator)
        inner.builder.formulation = formulation
        return inner


@final
class TranscribedPhase(NamedTuple):
    """A phase as equations: the problem as given, its reformulation if it has one, and the equations of that.

    ``inputs``: what is asked of the problem; ``own``: of its reformulation.
    """

    problem: OptimalControlProblem
    formulation: Reformulation | None
    outer: _InnerProblem
    inner: _InnerProblem
    inputs: Inputs
    own: Inputs
    transcribed: TranscribedProblem

    def state(self, y: Any) -> Any:
        """The state of the problem as given."""
        return y if self.formulation is None else y[0]

    def ends(self, first: Any, last: Any) -> PhaseEnds:
        """The arguments of a boundary constraint."""
        rate = 1.0 if self.formulation is None else self.formulation.rate(first)
        return PhaseEnds(self.state(first), self.state(last), rate * self.own.known.horizon)

    def time(self, first: Any) -> Any:
        """The time at which the phase begins."""
        return jnp.zeros(()) if self.formulation is None else self.formulation.rate(first) * first[-1][0]

    def recorded(self, found: DiscreteExtremals, seconds: tuple[float, float]) -> Solution:
        """The solution of the phase."""
        records = ExtremalRecords(self.inner.builder, self.transcribed, self.own, found)
        records.seconds = seconds
        solution = records.member(0)
        if self.formulation is not None:
            solution = self.formulation.solution(solution, self.inputs.given.parameters, self.outer.interpolant)
        return solution

    def checked(self, solution: Solution, free: bool) -> Solution:
        """The solution after the checks that its conditions do not show; ``free`` if times of any phase are free."""
        solution = solution if self.formulation is not None else explain_failure(self.own.problem, solution)
        return self.outer.audit(solution, free, self.inputs.ends.prescribed)


@final
class PhaseTranscription:
    """Makes the equations of phases, and traces phases with the same problem, method and steps once.

    The inputs of a phase are checked the first time, and not again for other guesses.
    """

    def __init__(self, options: Options) -> None:
        self.options, self.evaluator = options, AutomaticEvaluator()
        self._made: dict[Any, tuple[Any, _InnerProblem]] = {}
        self._asked: dict[int, Inputs] = {}
        self._vanishing: dict[int, tuple[Any, VanishingHorizon]] = {}

    def inner(self, phase: Any) -> _InnerProblem:
        """The means to solve a phase."""
        fractions = step_fractions(phase.steps)
        key = id(phase.problem), id(phase.method), fractions.tobytes()
        if key not in self._made:  # with the phase, so that nothing else comes to have its number
            self._made[key] = phase, _InnerProblem(phase.problem, phase.method, fractions, self.evaluator)
        return self._made[key][1]

    def vanishing(self, phase: Any) -> VanishingHorizon:
        """The test whether the duration of a phase tends to zero."""
        key = id(phase.problem)
        if key not in self._vanishing:
            self._vanishing[key] = phase, VanishingHorizon(phase.problem, guesses_of(phase.parameters))
        return self._vanishing[key][1]

    def inputs(self, number: int, phase: Any) -> Inputs:
        """The inputs of a phase."""
        reader, given = (
            self.inner(phase)._reader,
            BoundaryData(phase.start, phase.end, phase.duration, phase.parameters),
        )
        if number in self._asked:
            return self._asked[number].again(reader, given, phase.guess)
        return self._asked.setdefault(number, Inputs.of(reader, given, phase.guess, self.options))


def transcribe_phase(
    number: int, phase: Any, begins: float, phases: PhaseTranscription, repeated: bool
) -> TranscribedPhase:
    """The equations of a phase that begins at a guessed time.

    ``repeated``: its first node is the last one of a phase with the same constraints.
    """
    problem, outer = phase.problem, phases.inner(phase)
    inner, formulation = outer, None
    try:
        own = inputs = phases.inputs(number, phase)
        if inputs.needs_reformulation:
            formulation, inner, own = outer.reformulation.reformulate(inputs, begins if number else None)
        equations = inner.transcription.transcribe(own, repeated)
        bound, guess = own.problem, own.guess_of(0)
        ends = own.conditions_of(0)[0].point, None
        first, control = ends if guess is None else vec.taken((guess.states, guess.controls), 0)
        inspection = inspect_problem(bound, first, control)
        inspection.require_sound()
        regular = inspection.is_regular or bound._limits.along
    except PHASE_ERRORS as error:
        raise type(error)(f"phase {number}: {error}") from error
    if not regular:
        raise InvalidInputError(f"phase {number}: {SINGULAR_WORDS}")
    return TranscribedPhase(problem, formulation, outer, inner, inputs, own, equations)
