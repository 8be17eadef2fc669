"""A phase of a trajectory as equations of its method."""

from typing import Any, NamedTuple, final

import jax.numpy as jnp
import numpy as np

from ...manifolds import DomainError, InvalidInputError, NotOnManifoldError
from ...manifolds.numerics import ambient as vec
from ..controls import resting_control
from ..evaluator import Automatic, Evaluator
from ..inspection import Inspection
from ..problem import OptimalControlProblem
from .arguments import Method, Options, copied, fractions_of
from .engine.newton import Found
from .examination import Examination
from .formulated import SINGULAR, Formulated
from .formulation import Formulation, is_formulated
from .interpolation import Interpolant
from .members import Asked, MemberReader
from .outcome import explained
from .posed import Posed, Posing
from .recording import Recording
from .resampling import Mesh
from .solution import Solution

NAMED = InvalidInputError, NotOnManifoldError, DomainError  # errors that are said to be of a phase


class PhaseEnds(NamedTuple):
    """What a boundary constraint of phases sees of each: its first and its last state, and how long it takes."""

    start: Any
    end: Any
    duration: Any


@final
class _Inner:
    """What a phase is solved with, in the states that it is posed in."""

    def __init__(
        self, problem: OptimalControlProblem, method: Method, fractions: np.ndarray, evaluator: Evaluator
    ) -> None:
        self.problem, self.posing = problem, Posing(problem, method, fractions, evaluator)
        self.interpolant = Interpolant(method.retraction, problem.controls)
        self.reader = MemberReader(problem, Mesh(fractions, self.posing.stages, self.interpolant), evaluator)
        self.recording = Recording(problem, self.posing.stages, self.interpolant)
        self.examination = Examination(problem)
        self.formulated = Formulated(
            self.reader, method, lambda own: _Inner(own.problem, own.method, fractions, evaluator)
        )


@final
class PosedPhase(NamedTuple):
    """A phase as equations: the problem as given, its formulation if it has one, and the equations of that."""

    problem: OptimalControlProblem
    parameters: Any
    formulation: Formulation | None
    outer: _Inner
    inner: _Inner
    asked: Asked
    given: tuple[Any, Any]  # the start and the end, as they were asked for
    posed: Posed

    def state(self, y: Any) -> Any:
        """The state of the problem as given."""
        return y if self.formulation is None else y[0]

    def ends(self, first: Any, last: Any) -> PhaseEnds:
        """What a boundary constraint sees."""
        rate = 1.0 if self.formulation is None else self.formulation.rate(first)
        return PhaseEnds(self.state(first), self.state(last), rate * self.asked.horizon)

    def time(self, first: Any) -> Any:
        """The time at which the phase begins."""
        return jnp.zeros(()) if self.formulation is None else self.formulation.rate(first) * first[-1][0]

    def recorded(self, found: Found, options: Options, seconds: tuple[float, float]) -> Solution:
        """The solution of the phase."""
        given = vec.taken(copied(self.asked.parameters), None)
        _, member = self.inner.recording.of(self.posed, given, found, options, seconds)
        solution = member(0)
        if self.formulation is not None:
            solution = self.formulation.solution(solution, self.parameters, self.outer.interpolant)
        return solution

    def checked(self, solution: Solution, free: bool) -> Solution:
        """The solution with what its conditions do not tell; ``free``: whether times are, of any phase."""
        bound = self.inner.problem.with_parameters(self.asked.parameters)
        solution = solution if self.formulation is not None else explained(bound, solution)
        return self.outer.examination(solution, free, self.given)


@final
class TracedPhases:
    """Makes the equations of phases; those with the same problem, method and steps are traced once."""

    def __init__(self) -> None:
        self.evaluator: Evaluator = Automatic()
        self._made: dict[Any, tuple[Any, _Inner]] = {}

    def inner(self, phase: Any) -> _Inner:
        """What a phase is solved with."""
        fractions = fractions_of(phase.steps)
        key = id(phase.problem), id(phase.method), fractions.tobytes()
        if key not in self._made:  # with the phase, so that nothing else comes to have its number
            self._made[key] = phase, _Inner(phase.problem, phase.method, fractions, self.evaluator)
        return self._made[key][1]


def posed_phase(number: int, phase: Any, begins: float, phases: TracedPhases) -> PosedPhase:
    """The equations of a phase that is guessed to begin at a time."""
    problem, outer = phase.problem, phases.inner(phase)
    inner = outer
    asked, formulation = Asked(phase.start, phase.end, phase.duration, phase.guess, phase.parameters), None
    try:
        if is_formulated(problem, phase.duration, phase.parameters):
            formulation, inner, asked = outer.formulated.formulated(asked, begins if number else None)
        members = inner.reader.one(asked)
        equations = inner.posing.posed(members)
        bound, guess = members.problem_of(0), members.guess_of(0)
        first = members.conditions_of(0)[0].point if guess is None else vec.taken(guess.states, 0)
        inspection = Inspection(bound, first, resting_control(bound.controls))
        inspection.require_sound()
        regular = inspection.is_regular or bound.limits.along
    except NAMED as error:
        raise type(error)(f"phase {number}: {error}") from error
    if not regular:
        raise InvalidInputError(f"phase {number}: {SINGULAR}")
    return PosedPhase(problem, phase.parameters, formulation, outer, inner, asked, (phase.start, phase.end), equations)
