"""A problem as equations: its functions traced with a method, the conditions of the members of a batch, and their guesses."""

from typing import Any, NamedTuple, final

import jax
import numpy as np

from ...manifolds.manifold import default_tolerance
from ...retractions import Gauss, Midpoint
from ..problem import OptimalControlProblem, resting_control
from .arguments import Method, structure_of
from .end_points import NodeCondition, require_ends_on, require_known_ends
from .engine.collocation import Collocation
from .engine.conditions import Conditions, Ends, Iterate
from .engine.diagnosis import Diagnosis
from .engine.evaluator import Evaluator
from .engine.layout import Layout, parameter_layout
from .engine.start import Start
from .engine.transcription import Data, Known, Nodes, OneStage
from .guess import Guess
from .members import Member


class Traced(NamedTuple):
    """The functions of a problem with parameters of one structure."""

    steps: OneStage | Collocation
    nodes: Nodes
    diagnosis: Diagnosis
    example: OptimalControlProblem  # with some of these parameters


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
            self._found[key] = Traced(steps, Nodes(*given), Diagnosis(*given), example)
        return self._found[key]

    def posed(self, members: list[Member], conditions: list[tuple[NodeCondition, NodeCondition]]) -> Posed:
        """The conditions and guesses of members, given their boundary conditions."""
        parameters = np.stack([parameter_layout(m.parameters).rows(m.parameters, 0) for m in members])
        traced = self.traced(members[0].parameters)
        first, last = conditions[0]
        begin, end = (np.stack([self.state.rows(pair[k].point, 0) for pair in conditions]) for k in (0, 1))
        rows = begin, end
        self._require_on_manifold(traced, members, rows)
        data = Data(np.array([m.horizon for m in members])[:, None] * self.fractions, parameters, self._asked(members))
        guess = self._guess(traced, members, rows, data)
        entries = self._entries(first), self._entries(last)
        coordinates = np.array(first.fixed_coordinates, float), np.array(last.fixed_coordinates, float)
        return Posed(traced, Conditions(traced.steps, traced.nodes, Ends(*rows, *entries, *coordinates), data), guess)

    def _asked(self, members: list[Member]) -> np.ndarray | None:
        """At which points the inequalities are to hold, if there are any."""
        problem = self.problem.with_parameters(members[0].parameters)
        if not problem.limits.any:
            return None
        mask = problem.inequality_mask(len(self.fractions), len(self.stages))
        return np.broadcast_to(mask.astype(float), (len(members), *mask.shape))

    def _entries(self, condition: NodeCondition) -> np.ndarray:
        """Which entries of a flat point are prescribed."""
        leaves, structure = jax.tree.flatten(self.problem.manifold.ambient)
        ones = [1 + 1j if np.issubdtype(leaf.dtype, np.complexfloating) else 1.0 for leaf in leaves]
        marks = [np.full(a.shape, one * fixed) for a, one, fixed in zip(leaves, ones, condition.fixed_leaves, strict=True)]
        return self.state.rows(jax.tree.unflatten(structure, marks), 0) > 0

    def _require_on_manifold(self, traced: Traced, members: list[Member], rows: tuple[np.ndarray, np.ndarray]) -> None:
        """Raise if a prescribed part of an end is off its manifold."""
        for flat in rows:
            off = ~(np.max(traced.nodes.violations(flat), axis=1, initial=0.0) <= default_tolerance())
            for k in np.flatnonzero(off):
                require_ends_on(self.problem.manifold, members[k].start, members[k].end)

    def _guess(self, traced: Traced, members: list[Member], rows: tuple[np.ndarray, np.ndarray], data: Data) -> Iterate:
        """The guesses that are given, or curves from start to end with controls at rest and costates zero."""
        count, places, size = len(members), self.stages, self.state.size
        shape = count, len(self.fractions), len(places)
        if members[0].guess is None:
            for member in members:
                require_known_ends(self.problem.manifold, member.start, member.end)
            starts = np.concatenate([[0.0], np.cumsum(self.fractions)[:-1]])
            fractions = (starts[:, None] + places * self.fractions[:, None]).ravel()
            states = self._start.states(*rows, fractions).reshape(*shape, size)
            rest = self.control.rows(jax.tree.map(np.asarray, resting_control(self.problem.controls)), 0)
            controls = np.broadcast_to(rest, (*shape, rest.size))
            costates, known = np.zeros((count, len(self.fractions) + 1, size)), None
        else:
            guesses: Any = [member.guess for member in members]
            states = np.stack([self.state.rows(guess.states, 1) for guess in guesses]).reshape(*shape, size)
            controls = np.stack([self.control.rows(guess.controls, 1) for guess in guesses]).reshape(*shape, -1)
            costates = np.stack([self.state.rows(guess.costates, 1) for guess in guesses])
            known = self._known(guesses, shape)
        return Iterate(traced.steps.begin(states, controls, costates, data, known), costates)

    def _known(self, guesses: list[Guess], shape: tuple[int, int, int]) -> Known | None:
        """What guesses say of the nodes and of the stages' costates; None if one does not."""
        if any(guess.nodes is None or guess.stage_costates is None for guess in guesses):
            return None
        nodes, covectors = (
            np.stack([self.state.rows(getattr(guess, name), 1) for guess in guesses]) for name in ("nodes", "stage_costates")
        )
        return Known(nodes, covectors.reshape(*shape, -1))
