"""A phase of a trajectory as equations of its method."""

from typing import Any, NamedTuple, final

import jax.numpy as jnp

from ....compute.automatic import AutomaticEvaluator
from ....manifolds import DomainError, InvalidInputError, NotOnManifoldError
from ....manifolds.numerics import ambient as vec
from ...problem_checks.inspection import inspect_problem
from ..audit.status import explain_failure
from ..inputs.arguments import BoundaryData, step_fractions
from ..inputs.inputs import Inputs
from ..inputs.options import Options
from ..reformulations.free_quantities import FreeQuantities
from ..regularity import SINGULAR_WORDS
from ..solution.record import Solution
from ..solution_builder import ExtremalRecords
from ..solver import Solver
from ..transcription.discrete_extremals import DiscreteExtremals
from ..transcription.transcribed_problem import TranscribedProblem

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
class TranscribedPhase(NamedTuple):
    """A phase as equations: its solver, the reformulation with its solver if the phase has one, and the equations.

    ``inputs``: what is asked of the problem; ``own``: of its reformulation.
    """

    solver: Solver
    formulation: FreeQuantities | None
    inner: Solver
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

    def recover(self, found: DiscreteExtremals, seconds: tuple[float, float], free: bool) -> Solution:
        """The solution of the phase, after the checks that its conditions do not show; ``free`` if times of any phase
        are free."""
        records = ExtremalRecords(self.inner._builder, self.transcribed, self.own, found)
        records.seconds = seconds
        solution = records.member(0)
        if self.formulation is not None:
            solution = self.formulation.recover(self.own.given, solution)
        else:
            solution = explain_failure(self.own.problem, solution)
        return self.solver._audit(solution, free, self.inputs.ends.prescribed)


@final
class PhaseTranscription:
    """Makes the equations of phases, and traces phases with the same problem, method and steps once.

    The inputs of a phase are checked the first time, and not again for other guesses.
    """

    def __init__(self, options: Options) -> None:
        self.options, self.evaluator = options, AutomaticEvaluator()
        self._made: dict[Any, tuple[Any, Solver]] = {}
        self._asked: dict[int, Inputs] = {}

    def solver(self, phase: Any) -> Solver:
        """The solver of a phase."""
        key = id(phase.problem), id(phase.method), step_fractions(phase.steps).tobytes()
        if key not in self._made:  # with the phase, so that nothing else comes to have its number
            solver = Solver(phase.problem, phase.method, phase.steps, self.evaluator)
            # Durations come from afar, where one that is one at its guess would pass through zero.
            solver._reformulation.at_guess = 0.0
            self._made[key] = phase, solver
        return self._made[key][1]

    def vanishes(self, phase: Any, solution: Solution) -> bool:
        """Whether the free duration of a phase tends to zero."""
        own = self.solver(phase)._reformulation
        return own.vanishes(phase.duration, phase.parameters, solution, self.options.tolerance)

    def inputs(self, number: int, phase: Any) -> Inputs:
        """The inputs of a phase."""
        reader = self.solver(phase)._reader
        given = BoundaryData(phase.start, phase.end, phase.duration, phase.parameters)
        if number in self._asked:
            return self._asked[number].again(reader, given, phase.guess)
        return self._asked.setdefault(number, Inputs.of(reader, given, phase.guess, self.options))


def transcribe_phase(
    number: int, phase: Any, begins: float, phases: PhaseTranscription, repeated: bool
) -> TranscribedPhase:
    """The equations of a phase that begins at a guessed time.

    ``repeated``: its first node is the last one of a phase with the same constraints.
    """
    solver = phases.solver(phase)
    inner, formulation = solver, None
    try:
        own = inputs = phases.inputs(number, phase)
        if inputs.needs_reformulation:
            formulation, inner = solver._reformulation.of(phase.duration, phase.parameters)
            posed = formulation.apply(inputs, begins if number else None)
            own = inputs.again(inner._reader, posed, formulation.guess(inputs, posed))
        equations = inner._transcription.transcribe(own, repeated)
        bound, guess = own.problem, own.guess_of(0)
        ends = own.conditions_of(0)[0].point, None
        first, control = ends if guess is None else vec.taken((guess.states, guess.controls), 0)
        inspection = inspect_problem(bound, first, control)
        inspection.require_sound(phase.problem)
        regular = inspection.is_regular or bound._limits.along
    except PHASE_ERRORS as error:
        raise type(error)(f"phase {number}: {error}") from error
    if not regular:
        raise InvalidInputError(f"phase {number}: {SINGULAR_WORDS}")
    return TranscribedPhase(solver, formulation, inner, inputs, own, equations)
