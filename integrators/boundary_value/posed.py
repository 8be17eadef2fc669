"""A problem as equations: its functions traced with a method, the conditions of the members of a batch, and their
guesses."""

from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np

from ...retractions import Gauss, Midpoint
from ...undisturbed import undisturbed
from ..controls import resting_control, within_bounds
from ..evaluated import Evaluator
from ..layout import Layout
from ..problem import OptimalControlProblem
from .arguments import Method, structure_of
from .coupled import Own, coupling_of
from .engine import first_use
from .engine.collocation import Collocation
from .engine.conditions import Conditions
from .engine.coupling import Coupling
from .engine.diagnosis import Diagnosis
from .engine.inequalities import Slacks
from .engine.kkt_system import Ends, Iterate
from .engine.start import Start
from .engine.transcription import Data, Known, Nodes, OneStage
from .given_guess import FlatGuess
from .inequality_rows import InequalityRows
from .request import Request, for_all


class Traced(NamedTuple):
    """The functions of a problem with parameters of one structure."""

    steps: OneStage | Collocation
    nodes: Nodes
    diagnosis: Diagnosis
    rows: InequalityRows
    own: Own
    coupling: Coupling | None  # of the ends, if they are coupled
    evaluator: Evaluator


class Posed(NamedTuple):
    """The conditions of some trajectories, with the traced functions, and the guesses."""

    traced: Traced
    conditions: Conditions
    guess: Iterate


@final
class Posing:
    """Poses trajectories of a problem as equations of a method."""

    def __init__(
        self, problem: OptimalControlProblem, method: Method, fractions: np.ndarray, evaluator: Evaluator
    ) -> None:
        self.problem, self.method, self.fractions, self.evaluator = problem, method, fractions, evaluator
        self.state, self.control = Layout.of(problem.manifold), Layout.of(problem.controls)
        self.stages = np.array(method.nodes) if isinstance(method, Gauss) else np.array([method.theta])
        self._start = Start(problem.manifold, method.retraction)
        starts = np.concatenate([[0.0], np.cumsum(fractions)[:-1]])
        # Of all stages, fractions of the horizon.
        self._places = (starts[:, None] + self.stages * fractions[:, None]).ravel()
        self._found: dict[Any, Traced] = {}

    def on(self, fractions: np.ndarray) -> "Posing":
        """The same on another mesh; what is traced serves both."""
        other = Posing(self.problem, self.method, fractions, self.evaluator)
        other._found, other._start = self._found, self._start
        return other

    def compile(self) -> bool:
        """Make machine code of what is traced; whether the functions of the problem are."""
        self.evaluator.compile()
        self._start.compile()
        return bool(self._found)

    def traced(self, parameters: Any) -> Traced:
        """The functions with parameters of this structure."""
        key = structure_of(parameters)
        if key not in self._found:
            self._found[key] = undisturbed(self._traced)(parameters)
        return self._found[key]

    def _traced(self, parameters: Any) -> Traced:
        """The same, traced anew."""
        example = self.problem.with_parameters(parameters)
        example._require_values()
        given = self.problem, parameters, self.evaluator
        if isinstance(self.method, Gauss) and self.method.stages > 1:
            steps: Any = Collocation(self.problem, self.method, *given[1:])
        else:
            method = Midpoint(self.method.retraction) if isinstance(self.method, Gauss) else self.method
            steps = OneStage(self.problem, method, *given[1:])
        if self.evaluator.name == "tape":
            first_use.begin()
        rows = InequalityRows(self.problem, parameters, len(self.stages))
        own = Own(self.problem, parameters)
        coupling = coupling_of([own], self.evaluator) if self.problem._boundary.any else None
        functions = steps, Nodes(*given), Diagnosis(*given)
        return Traced(*functions, rows, own, coupling, self.evaluator)

    def of(self, request: Request) -> Traced:
        """The functions with the parameters of a request."""
        return (
            self._found[request.structure]
            if request.structure in self._found
            else self.traced(request.parameters_of(0))
        )

    def posed(self, request: Request, repeated: bool = False) -> Posed:
        """The conditions and guesses of a request; ``repeated`` if the constraints of its first node belong to another
        phase."""
        traced, ends = self.of(request), request.ends
        rows = for_all(ends.start, len(request)), for_all(ends.end, len(request))
        first, last = ends.prescribed
        mask = traced.rows.mask(len(self.fractions), (first, last), repeated)
        asked = None if mask is None else for_all(mask.astype(float)[None], len(request))
        data = Data(request.horizons[:, None] * self.fractions, request.rows, asked)
        own = Ends(*rows, first.entries, last.entries, first.coordinates, last.coordinates)
        conditions = Conditions(traced.steps, traced.nodes, own, data)
        return Posed(traced, conditions, self._finite(conditions, self._guess(traced, request, rows, data)))

    @cached_property
    def _resting(self) -> np.ndarray:
        return self.control.rows(resting_control(self.problem.controls), 0)

    @cached_property
    def _inside(self) -> np.ndarray:
        """The control at rest, or inside the bounds if it is not."""
        return self.control.rows(within_bounds(self.problem._limits, resting_control(self.problem.controls)), 0)

    def _finite(self, conditions: Conditions, guess: Iterate) -> Iterate:
        """The guess, with controls inside the bounds where all are at rest and the functions are not finite there."""
        controls = guess.unknowns.controls
        resting = np.all(controls == self._resting, axis=(1, 2, 3))
        if not resting.any() or np.array_equal(self._inside, self._resting):
            return guess
        blocks = conditions.assemble(guess.bare).blocks
        resting &= ~np.all(np.isfinite(blocks.hessian), axis=(1, 2, 3))
        controls = np.where(resting[:, None, None, None], self._inside, controls)
        return guess._replace(unknowns=guess.unknowns._replace(controls=controls))

    def _guess(self, traced: Traced, request: Request, rows: tuple[np.ndarray, np.ndarray], data: Data) -> Iterate:
        """The guesses that are given, or curves from start to end with controls at rest and costates zero."""
        count, size = len(request), self.state.size
        shape = count, len(self.fractions), len(self.stages)
        if request.guesses is None:
            request.ends.require_known(request.given.start)
            slacks, states = None, self._start.states(*rows, self._places).reshape(*shape, size)
            controls = np.empty((*shape, self.control.size))
            controls[...] = self._resting
            costates, known = np.zeros((count, shape[1] + 1, size)), None
        else:
            own = request.guesses.of(count)
            states, controls = own.states.reshape(*shape, size), own.controls.reshape(*shape, self.control.size)
            costates, slacks = own.costates, self._pulling(traced, own, data)
            both = own.nodes, own.stage_costates
            known = (
                Known(both[0], both[1].reshape(*shape, size)) if both[0] is not None and both[1] is not None else None
            )
        return Iterate(traced.steps.begin(states, controls, costates, data, known), costates, slacks)

    @staticmethod
    def _pulling(traced: Traced, guess: FlatGuess, data: Data) -> Slacks | None:
        """The multipliers of guesses that know them of the inequalities."""
        known = list(zip(guess.multipliers, guess.node_multipliers, strict=True))
        if data.asked is None or not any(any(both) for both in known):
            return None
        known = known if len(known) > 1 else known * len(data.steps)
        rows = [traced.rows.flat(*both, steps) for both, steps in zip(known, data.steps, strict=True)]
        return Slacks.none(data.asked.shape)._replace(multipliers=np.stack(rows))
