"""A problem as equations: its functions traced with a method, the conditions of the members of a batch, and their
guesses."""

from typing import Any, NamedTuple, final

import jax
import numpy as np

from ....compute.base import Evaluator
from ....index_bounds import require_indices
from ....retractions import CollocationMethod
from ....tracing import trace_program
from ....undisturbed import undisturbed
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.point_layout import PointLayout
from ...problem_checks.requirements import require_values
from ..guess import WHOLE, DefaultGuess
from ..inputs.arguments import Method, structure_of
from ..inputs.guess_arrays import FlatGuess
from ..inputs.inputs import Inputs
from ..inputs.members import repeat_for_all
from .diagnosis import Diagnosis
from .discrete_phase import DiscretePhase
from .functions.collocation import CollocationFunctions
from .functions.linked_ends import LinkageFunctions
from .functions.nodes import NodeFunctions
from .functions.one_stage import OneStageFunctions
from .inequality_rows import InequalityRows
from .iterate import Data, Ends, Iterate, KnownExtremal, Slacks
from .linkages import PhaseProblem, linkages_of


class TracedFunctions(NamedTuple):
    """The functions of a problem with parameters of one structure."""

    steps: OneStageFunctions | CollocationFunctions
    nodes: NodeFunctions
    diagnosis: Diagnosis
    rows: InequalityRows
    own: PhaseProblem
    coupling: LinkageFunctions | None  # of the ends, if they are coupled
    evaluator: Evaluator


class TranscribedProblem(NamedTuple):
    """The conditions of some trajectories, with the traced functions, and the guesses."""

    traced: TracedFunctions
    conditions: DiscretePhase
    guess: Iterate


@final
class Transcription:
    """Poses trajectories of a problem as equations of a method."""

    def __init__(
        self, problem: OptimalControlProblem, method: Method, fractions: np.ndarray, evaluator: Evaluator
    ) -> None:
        self.problem, self.method, self.fractions, self.evaluator = problem, method, fractions, evaluator
        self.state, self.control = PointLayout.of(problem.manifold), PointLayout.of(problem.controls)
        self.stages = method.nodes
        self._default_guess = DefaultGuess(problem, method)
        self._found: dict[Any, TracedFunctions] = {}
        self._fits = set[Any]()  # structures of parameters with entries for all nodes

    def on(self, fractions: np.ndarray) -> "Transcription":
        """The transcription on another mesh; both share the traced functions."""
        other = Transcription(self.problem, self.method, fractions, self.evaluator)
        other._found, other._default_guess = self._found, self._default_guess
        return other

    def trace(self, parameters: Any) -> TracedFunctions:
        """The functions with parameters of this structure."""
        key = structure_of(parameters)
        if key not in self._found:
            self._found[key] = undisturbed(self._trace)(parameters)
        return self._found[key]

    def _trace(self, parameters: Any) -> TracedFunctions:
        """The functions with parameters of this structure, traced anew."""
        example = self.problem.with_parameters(parameters)
        require_values(example)
        given = self.problem, parameters, self.evaluator
        if isinstance(self.method, CollocationMethod) and self.method.stages > 1:
            steps: Any = CollocationFunctions(self.problem, self.method, *given[1:])
        else:
            steps = OneStageFunctions(self.problem, self.method.discretization_map, *given[1:])
        rows = InequalityRows(self.problem, parameters, len(self.stages))
        phase_problem = PhaseProblem(self.problem, parameters)
        coupling = linkages_of([phase_problem], self.evaluator) if self.problem._boundary.any else None
        functions = steps, NodeFunctions(*given), Diagnosis(*given)
        return TracedFunctions(*functions, rows, phase_problem, coupling, self.evaluator)

    def of(self, inputs: Inputs) -> TracedFunctions:
        """The functions with the parameters of the inputs."""
        return self._found[inputs.structure] if inputs.structure in self._found else self.trace(inputs.parameters_of(0))

    def _require_data(self, inputs: Inputs) -> None:
        """Raise if the node cost reads an entry for the last node that its data do not have."""
        if self.problem.node_cost is None or inputs.structure in self._fits:
            return
        bound = self.problem.with_parameters(inputs.parameters_of(0))
        q = jax.tree.map(lambda s: np.zeros(s.shape, s.dtype), self.problem.manifold.ambient)
        program = trace_program(lambda q: bound.cost_at_node(q, len(self.fractions)), q)
        require_indices(program, f"node_cost at node k = {len(self.fractions)}, the last one of as many steps,")
        self._fits.add(inputs.structure)

    def transcribe(self, inputs: Inputs, repeated: bool = False) -> TranscribedProblem:
        """The conditions and guesses of the inputs; ``repeated`` if the constraints of its first node belong to another
        phase."""
        traced, ends, count = self.of(inputs), inputs.ends, len(inputs)
        self._require_data(inputs)
        rows = repeat_for_all(ends.start, count), repeat_for_all(ends.end, count)
        first, last = ends.prescribed
        mask = traced.rows.mask(len(self.fractions), (first, last), repeated)
        asked = None if mask is None else repeat_for_all(mask.astype(float)[None], count)
        data = Data(inputs.horizons[:, None] * self.fractions, inputs.rows, asked)
        boundary = Ends(*rows, first.entries, last.entries, first.coordinates, last.coordinates)
        conditions = DiscretePhase(traced.steps, traced.nodes, boundary, data)
        return TranscribedProblem(traced, conditions, self._guess(traced, inputs, rows, data))

    def _guess(
        self, traced: TracedFunctions, inputs: Inputs, rows: tuple[np.ndarray, np.ndarray], data: Data
    ) -> Iterate:
        """The guesses that are given, or the default guesses."""
        count, size = len(data.steps), self.state.size
        shape, slacks, known = (count, len(self.fractions), len(self.stages)), None, None
        if inputs.guesses is None:
            inputs.ends.require_known(inputs.given.start)
            states, controls, costates = self._default_guess.arrays(np.stack(rows, axis=1), WHOLE, self.fractions)
        else:
            arrays = inputs.guesses.of(count)
            states, controls, costates = arrays.states, arrays.controls, arrays.costates
            slacks = self._pulling(traced, arrays, data)
            if arrays.nodes is not None and arrays.stage_costates is not None:
                known = KnownExtremal(arrays.nodes, arrays.stage_costates.reshape(*shape, size))
        states, controls = states.reshape(*shape, size), controls.reshape(*shape, self.control.size)
        return Iterate(traced.steps.begin(states, controls, costates, data, known), costates, slacks)

    @staticmethod
    def _pulling(traced: TracedFunctions, guess: FlatGuess, data: Data) -> Slacks | None:
        """The multipliers of guesses that know them of the inequalities."""
        known = list(zip(guess.multipliers, guess.node_multipliers, strict=True))
        if data.asked is None or not any(any(both) for both in known):
            return None
        known = known if len(known) > 1 else known * len(data.steps)
        rows = [traced.rows.flat(*both, steps) for both, steps in zip(known, data.steps, strict=True)]
        return Slacks.none(data.asked.shape)._replace(multipliers=np.stack(rows))
