"""The functions of a problem with a discretization map: one point in each step."""

from typing import Any, ClassVar, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .....compute.base import Arrays, Evaluator, PointwiseFunction
from .....compute.binding.problem_functions import FunctionName
from .....manifolds.numerics import ambient as vec
from .....retractions import DiscretizationMap
from ....problem.optimal_control_problem import OptimalControlProblem
from ....problem.point_layout import PointLayout, parameter_layout
from ....stages import ControlStage
from ..iterate import Data, KnownExtremal, Slacks, Unknowns
from .steps import AtStages, Tableau, count_inequalities, kept_bounds


@final
class OneStageFunctions:
    """The functions of the steps of a discretization map: unknowns ``(x, u)``, tangent vector ``h X(x, u)``.

    ``functions``: the functions that the core takes, by their names. The inequalities of a step are the inequalities at
    its point, then the inequalities at nodes, at its end and at its beginning.
    """

    stages: ClassVar[int] = 1
    places: ClassVar[int] = 1  # where a step has inequalities
    tableau: ClassVar[Tableau] = Tableau(np.ones((1, 1)), np.ones(1))

    def __init__(
        self, problem: OptimalControlProblem, method: DiscretizationMap, parameters: Any, evaluator: Evaluator
    ) -> None:
        self.problem, self.method = problem, method
        self.manifold, self.controls = problem.manifold, problem.controls
        self.dimension = self.manifold.dimension + self.controls.dimension
        self.state, self.control = PointLayout.of(self.manifold), PointLayout.of(self.controls)
        self.parameter = parameter_layout(parameters)
        sizes, given = (self.state.size, self.control.size), (1, self.parameter.size)
        nodes = (self.state.size,) * 4
        bound = problem.with_parameters(parameters)
        self.own, at_nodes = count_inequalities(bound)
        self.inequalities, self.kept = self.own + at_nodes, kept_bounds(bound)
        self.node_costs = int(problem.node_cost is not None)
        row = self.dimension, *sizes, *nodes, *given, self.inequalities, self.node_costs
        self.functions: dict[FunctionName, PointwiseFunction] = {
            FunctionName.ENDS: evaluator.values(self._ends_of, *sizes, *given),
            FunctionName.POINTS: evaluator.derivatives(self._row_of, *row),
            FunctionName.MOVE: evaluator.values(self._moved, *sizes, self.dimension, *given),
        }
        self._covectors = evaluator.values(self._covector_of, *sizes, *nodes[:2], *given, at_nodes, self.node_costs)

    @property
    def limit_sizes(self) -> tuple[int, int]:
        """Numbers of inequalities of a point, and of the ends of a step beside them."""
        return self.inequalities, 0

    def stage(self, step: Array, parameters: Array) -> ControlStage:
        """The stage with a step length and parameters, in a function that is traced."""
        bound = self.problem.with_parameters(self.parameter.point(parameters))
        return ControlStage(problem=bound, discretization=self.method, step=step[0])

    def ends(self, unknowns: Unknowns, data: Data) -> Arrays:
        """Beginnings and ends of the steps, shape (B, N, E)."""
        ends = self.functions[FunctionName.ENDS]
        return ends.at(
            2, unknowns.centres, unknowns.controls[:, :, 0], data.steps[:, :, None], data.parameters[:, None]
        )

    def weights(self, data: Data) -> np.ndarray:
        """Weights of the inequalities, shape (B, N, 1, c)."""
        return data.steps[:, :, None, None] * data.held(self.inequalities, 1)

    def begin(
        self,
        states: np.ndarray,
        controls: np.ndarray,
        costates: np.ndarray,
        data: Data,
        known: KnownExtremal | None = None,
    ) -> Unknowns:
        """Unknowns from states and controls at the stages, shape (B, N, 1, ...), and costates at the nodes."""
        del costates, data, known
        return Unknowns(states[:, :, 0], controls)

    def at_stages(self, unknowns: Unknowns, costates: np.ndarray, data: Data, slacks: Slacks | None) -> AtStages:
        """States, controls and costates at the stages, (B, N, ...), from covectors at the nodes, (B, N + 1, E)."""
        x, u = unknowns.centres, unknowns.controls[:, :, 0]
        none = np.zeros((*data.steps.shape, self.inequalities - self.own))
        pull = none if slacks is None else slacks.multipliers[:, :, 0, self.own :]
        given = data.steps[:, :, None], data.parameters[:, None]
        indices = np.arange(1.0, data.steps.shape[1] + 1)[None, :, None][..., : self.node_costs]
        around = costates[:, :-1], costates[:, 1:]
        (covectors,) = self._covectors.at(2, x, u, *around, *given, pull, indices)
        return x, u, covectors

    def _ends_of(self, x: Array, u: Array, h: Array, parameters: Array) -> tuple[Array, ...]:
        ends = self.stage(h, parameters).ends((self.state.point(x), self.control.point(u)))
        return tuple(map(self.state.flat, ends))

    def _row_of(self, d: Array, x: Array, u: Array, *given: Array) -> tuple[Array, tuple[Array, ...]]:
        """The Lagrangian of a step as a function of the step ``d`` of its unknowns; ends, cost, inequalities."""
        q0, q1, p0, p1 = map(self.state.point, given[:4])
        stage, y = self.stage(*given[4:6]), (self.state.point(x), self.control.point(u))
        moved = stage.move(y, stage.frame(y), d)
        begin, finish = stage.ends(moved)
        cost, limits = stage.cost(moved), stage.problem.inequalities(*moved)
        if self.node_costs:
            cost = cost + stage.problem.cost_at_node(finish, given[7][0].astype(int))
        limits = jnp.concatenate([limits, *(stage.problem.node_inequalities(end) for end in (finish, begin))])
        e0, e1 = self.manifold.basis(q0), self.manifold.basis(q1)
        values = vec.components(e0, begin), vec.components(e1, finish), cost[None], limits
        lagrangian = cost + vec.pairing(p0, begin) - vec.pairing(p1, finish) + given[4][0] * given[6] @ limits
        return lagrangian, values

    def _moved(self, x: Array, u: Array, d: Array, h: Array, parameters: Array) -> tuple[Array, Array]:
        stage, y = self.stage(h, parameters), (self.state.point(x), self.control.point(u))
        centre, control = stage.move(y, stage.frame(y), d)
        return self.state.flat(centre), self.control.flat(control)

    def _covector_of(self, x: Array, u: Array, p0: Array, p1: Array, *given: Array) -> tuple[Array]:
        """The covector of the lift of the discretization map at a stage, between the jumps at its ends."""
        (h, parameters, pull, index), y = given, (self.state.point(x), self.control.point(u))
        stage, nodes, covectors = self.stage(h, parameters), pull.size // 2, [self.state.point(p) for p in (p0, p1)]
        if nodes:
            jumps = (h[0] * pull[nodes:], -h[0] * pull[:nodes]), stage.ends(y)
            slopes = [
                jax.vjp(stage.problem.node_inequalities, end)[1](jump)[0] for jump, end in zip(*jumps, strict=True)
            ]
            covectors = [vec.add(p, slope) for p, slope in zip(covectors, slopes, strict=True)]
        if self.node_costs:
            finish, k = stage.ends(y)[1], index[0].astype(int)
            covectors[1] = vec.subtract(covectors[1], vec.gradient(lambda q: stage.problem.cost_at_node(q, k), finish))
        return (self.state.flat(stage.covector(y, *covectors)),)
