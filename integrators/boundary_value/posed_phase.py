"""A phase of a trajectory as equations of its method."""

from typing import Any, NamedTuple, final

import jax.numpy as jnp
import numpy as np

from ...manifolds import DomainError, InvalidInputError, NotOnManifoldError
from ...manifolds.numerics import ambient as vec
from ..evaluated import Evaluator
from ..evaluator import Automatic
from ..free import all_guessed
from ..inspection import inspected
from ..problem import OptimalControlProblem
from .arguments import Given, Method, Options, fractions_of
from .engine.found import Found
from .examination import Examination
from .formulated import SINGULAR, Formulated
from .formulation import Formulation
from .interpolation import Interpolant
from .outcome import explained
from .posed import Posed, Posing
from .recording import Recording
from .request import Request, RequestReader
from .resampling import Mesh
from .solution import Solution
from .vanishing import Vanishing

NAMED = InvalidInputError, NotOnManifoldError, DomainError  # errors that are said to be of a phase


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
class _Inner:
    """The means to solve a phase, in the states of its formulation."""

    def __init__(
        self, problem: OptimalControlProblem, method: Method, fractions: np.ndarray, evaluator: Evaluator
    ) -> None:
        self.problem, self.posing = problem, Posing(problem, method, fractions, evaluator)
        self.interpolant = Interpolant(method.retraction, problem.controls)
        mesh = Mesh(fractions, self.posing.stages, self.interpolant)
        self._reader = RequestReader(problem, method, mesh, evaluator)
        self.recording = Recording(problem, self.posing.stages, self.interpolant)
        self.examination = Examination(problem)
        # Zero: durations come from afar, where one that is one at its guess would pass through zero.
        self.formulated = Formulated(self._reader, lambda own: self._of(own, fractions, evaluator), 0.0)

    @staticmethod
    def _of(formulation: Formulation, fractions: np.ndarray, evaluator: Evaluator) -> "_Inner":
        """The means to solve a formulation."""
        inner = _Inner(formulation.problem, formulation.method, fractions, evaluator)
        inner.recording.formulation = formulation
        return inner


@final
class PosedPhase(NamedTuple):
    """A phase as equations: the problem as given, its formulation if it has one, and the equations of that.

    ``request``: what is asked of the problem; ``own``: of its formulation.
    """

    problem: OptimalControlProblem
    formulation: Formulation | None
    outer: _Inner
    inner: _Inner
    request: Request
    own: Request
    posed: Posed

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

    def recorded(self, found: Found, seconds: tuple[float, float]) -> Solution:
        """The solution of the phase."""
        _, member = self.inner.recording.of(self.posed, self.own.parameters(), found, self.own.options, seconds)
        solution = member(0)
        if self.formulation is not None:
            solution = self.formulation.solution(solution, self.request.given.parameters, self.outer.interpolant)
        return solution

    def checked(self, solution: Solution, free: bool) -> Solution:
        """The solution after the checks that its conditions do not show; ``free`` if times of any phase are free."""
        solution = solution if self.formulation is not None else explained(self.own.problem, solution)
        return self.outer.examination(solution, free, self.request.ends.prescribed)


@final
class TracedPhases:
    """Makes the equations of phases, and traces phases with the same problem, method and steps once.

    The request of a phase is checked the first time, and not again for other guesses.
    """

    def __init__(self, options: Options) -> None:
        self.options, self.evaluator = options, Automatic()
        self._made: dict[Any, tuple[Any, _Inner]] = {}
        self._asked: dict[int, Request] = {}
        self._vanishing: dict[int, tuple[Any, Vanishing]] = {}

    def inner(self, phase: Any) -> _Inner:
        """The means to solve a phase."""
        fractions = fractions_of(phase.steps)
        key = id(phase.problem), id(phase.method), fractions.tobytes()
        if key not in self._made:  # with the phase, so that nothing else comes to have its number
            self._made[key] = phase, _Inner(phase.problem, phase.method, fractions, self.evaluator)
        return self._made[key][1]

    def vanishing(self, phase: Any) -> Vanishing:
        """The test whether the duration of a phase tends to zero."""
        key = id(phase.problem)
        if key not in self._vanishing:
            self._vanishing[key] = phase, Vanishing(phase.problem, all_guessed(phase.parameters))
        return self._vanishing[key][1]

    def request(self, number: int, phase: Any) -> Request:
        """The request of a phase."""
        reader, given = self.inner(phase)._reader, Given(phase.start, phase.end, phase.duration, phase.parameters)
        if number in self._asked:
            return self._asked[number].again(reader, given, phase.guess)
        return self._asked.setdefault(number, Request.of(reader, given, phase.guess, self.options))


def posed_phase(number: int, phase: Any, begins: float, phases: TracedPhases, repeated: bool) -> PosedPhase:
    """The equations of a phase that begins at a guessed time.

    ``repeated``: its first node is the last one of a phase with the same constraints.
    """
    problem, outer = phase.problem, phases.inner(phase)
    inner, formulation = outer, None
    try:
        own = request = phases.request(number, phase)
        if request.formulated:
            formulation, inner, own = outer.formulated.formulated(request, begins if number else None)
        equations = inner.posing.posed(own, repeated)
        bound, guess = own.problem, own.guess_of(0)
        ends = own.conditions_of(0)[0].point, None
        first, control = ends if guess is None else vec.taken((guess.states, guess.controls), 0)
        inspection = inspected(bound, first, control)
        inspection.require_sound()
        regular = inspection.is_regular or bound._limits.along
    except NAMED as error:
        raise type(error)(f"phase {number}: {error}") from error
    if not regular:
        raise InvalidInputError(f"phase {number}: {SINGULAR}")
    return PosedPhase(problem, formulation, outer, inner, request, own, equations)
