"""A problem as equations: its functions traced with a method, the conditions of the members of a batch, and their guesses."""

from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np

from ...manifolds.manifold import default_tolerance
from ...retractions import Gauss, Midpoint
from ..problem import OptimalControlProblem, resting_control
from .arguments import Method, structure_of
from .engine.collocation import Collocation
from .engine.conditions import Conditions, Ends, Iterate
from .engine.diagnosis import Diagnosis
from .engine.evaluator import Evaluator
from .engine.layout import Layout
from .engine.start import Start
from .engine.transcription import Data, Known, Nodes, OneStage
from .members import Members


class Traced(NamedTuple):
    """The functions of a problem with parameters of one structure."""

    steps: OneStage | Collocation
    nodes: Nodes
    diagnosis: Diagnosis
    example: OptimalControlProblem  # with some of these parameters
    asked: np.ndarray | None  # at which points of a trajectory the inequalities are to hold, if there are any


class Posed(NamedTuple):
    """The conditions of some trajectories, with the traced functions, and the guesses."""

    traced: Traced
    conditions: Conditions
    guess: Iterate


@final
class Posing:
    """Poses trajectories of a problem as equations of a method."""

    def __init__(self, problem: OptimalControlProblem, method: Method, fractions: np.ndarray, evaluator: Evaluator) -> None:
        self.problem, self.method, self.fractions, self.evaluator = problem, method, fractions, evaluator
        self.state, self.control = Layout.of(problem.manifold), Layout.of(problem.controls)
        self.stages = np.array(method.nodes) if isinstance(method, Gauss) else np.array([method.theta])
        self._start = Start(problem.manifold, method.retraction)
        starts = np.concatenate([[0.0], np.cumsum(fractions)[:-1]])
        self._places = (starts[:, None] + self.stages * fractions[:, None]).ravel()  # of all stages, fractions of the horizon
        self._found: dict[Any, Traced] = {}

    def traced(self, parameters: Any) -> Traced:
        """The functions with parameters of this structure."""
        key = structure_of(parameters)
        if key not in self._found:
            example = self.problem.with_parameters(parameters)
            example.require_values()
            given = self.problem, parameters, self.evaluator
            if isinstance(self.method, Gauss) and self.method.stages > 1:
                steps: Any = Collocation(self.problem, self.method, *given[1:])
            else:
                method = Midpoint(self.method.retraction) if isinstance(self.method, Gauss) else self.method
                steps = OneStage(self.problem, method, *given[1:])
            mask = example.inequality_mask(len(self.fractions), len(self.stages)) if example.limits.any else None
            asked = None if mask is None else mask.astype(float)
            self._found[key] = Traced(steps, Nodes(*given), Diagnosis(*given), example, asked)
        return self._found[key]

    def of(self, members: Members) -> Traced:
        """The functions with the parameters of members."""
        return self._found[members.structure] if members.structure in self._found else self.traced(members.parameters_of(0))

    def require_on_manifold(self, members: Members) -> None:
        """Raise if a prescribed part of an end, or a state of a guess, is off its manifold."""
        ends, guess = members.ends, members.guess
        states = [] if guess is None else [part.reshape(-1, self.state.size) for part in guess.on_manifold.values()]
        points = np.concatenate([ends.start, ends.end, *states])
        violations = np.max(self.of(members).nodes.violations(points), axis=1, initial=0.0)
        first, last, rest = np.split(violations, [len(ends.start), len(ends.start) + len(ends.end)])
        if guess is not None:
            members.reader.guesses.require_on_manifold(guess, rest)
        for k in np.flatnonzero(~((first <= default_tolerance()) & (last <= default_tolerance()))):
            members.require_on_manifold(k)

    def posed(self, members: Members) -> Posed:
        """The conditions and guesses of members."""
        traced, ends = self.of(members), members.ends
        shape = len(members), self.state.size
        rows = np.broadcast_to(ends.start, shape), np.broadcast_to(ends.end, shape)
        asked = None if traced.asked is None else np.broadcast_to(traced.asked, (len(members), *traced.asked.shape))
        data = Data(members.horizons[:, None] * self.fractions, members.rows, asked)
        first, last = ends.prescribed
        own = Ends(*rows, first.entries, last.entries, first.coordinates, last.coordinates)
        return Posed(traced, Conditions(traced.steps, traced.nodes, own, data), self._guess(traced, members, rows, data))

    @cached_property
    def _resting(self) -> np.ndarray:
        return self.control.rows(resting_control(self.problem.controls), 0)

    def _guess(self, traced: Traced, members: Members, rows: tuple[np.ndarray, np.ndarray], data: Data) -> Iterate:
        """The guesses that are given, or curves from start to end with controls at rest and costates zero."""
        count, size = len(members), self.state.size
        shape = count, len(self.fractions), len(self.stages)
        if members.guess is None:
            members.require_known_ends()
            states = self._start.states(*rows, self._places).reshape(*shape, size)
            controls = np.broadcast_to(self._resting, (*shape, self.control.size))
            costates, known = np.zeros((count, shape[1] + 1, size)), None
        else:
            own: Any = [None if part is None else np.broadcast_to(part, (count, *part.shape[1:])) for part in members.guess]
            states, controls, costates, nodes, covectors = own
            states, controls = states.reshape(*shape, size), controls.reshape(*shape, self.control.size)
            known = None if nodes is None else Known(nodes, covectors.reshape(*shape, size))
        return Iterate(traced.steps.begin(states, controls, costates, data, known), costates)
