"""The functions of a problem with a collocation method: several points in the chart of each step."""

from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .....compute.base import Arrays, Evaluator, PointwiseFunction
from .....compute.binding.problem_functions import FunctionName
from .....manifolds.numerics import ambient as vec
from .....manifolds.numerics.ambient import Ambient
from .....retractions import CollocationMethod, default_retraction
from ....problem.optimal_control_problem import OptimalControlProblem
from ....problem.point_layout import PointLayout, parameter_layout
from ..chart import Chart
from ..iterate import CollocationUnknowns, Data, KnownExtremal, Slacks
from .steps import AtStages, Tableau, count_inequalities, kept_bounds


@final
class CollocationFunctions:
    """The functions of the steps of a collocation method with at least two points.

    ``functions``: the functions that the core takes, by their names. Where there are inequalities at nodes, a step has
    the inequalities of its ends behind the inequalities of its points, as of one more point, whose unknowns are ``(dx,
    deta)``: ``eta = h sum_j b_j nu_j``.
    """

    def __init__(
        self, problem: OptimalControlProblem, method: CollocationMethod, parameters: Any, evaluator: Evaluator
    ) -> None:
        self.problem, self.method, self.stages = problem, method, method.stages
        self.manifold, self.controls = problem.manifold, problem.controls
        # Of a product they are sums that are taken again each time.
        n, m = self.manifold.dimension, self.controls.dimension
        self.directions, self.dimension = n, n + self.stages * m
        self.tableau = Tableau(np.array(method.centred), np.array(method.weights))
        self.state, self.control = PointLayout.of(self.manifold), PointLayout.of(self.controls)
        self.parameter = parameter_layout(parameters)
        e, u, k = self.state.size, self.control.size, self.parameter.size
        bound = problem.with_parameters(parameters)
        self.own, self.at_nodes = count_inequalities(bound)
        self.inequalities, self.kept = self.own + self.at_nodes, kept_bounds(bound)
        self.node_costs = int(problem.node_cost is not None)
        self.places = self.stages + (self.at_nodes > 0)
        pulled = (1, k, self.at_nodes, self.node_costs) if self.at_nodes or self.node_costs else ()
        point, both = (3 * n + m, e, n, n, u, e, 1, k, self.own), (2 * n, e, n, e, e, e, e, *pulled)
        self.functions: dict[FunctionName, PointwiseFunction] = {
            FunctionName.ENDS: evaluator.values(self._ends_of, e, n),
            FunctionName.POINTS: evaluator.derivatives(self._point_of, *point),
            FunctionName.BOTH_ENDS: evaluator.derivatives(self._both_of, *both),
            FunctionName.MOVE: evaluator.values(self._centre_move_of, e, n),
            FunctionName.MOVE_CONTROLS: evaluator.values(self._control_move_of, u, m),
        }
        self.state_at_point = evaluator.values(self._state_at, e, n, e)
        self._velocity = evaluator.values(self._velocity_at, e, e, u, k)
        self._middle = evaluator.values(self._middle_of, e, e)
        self._chart = Chart(method.retraction, evaluator)

    @property
    def limit_sizes(self) -> tuple[int, int]:
        """Numbers of inequalities of a point, and of the ends of a step beside them."""
        return self.own, self.at_nodes

    def begin(
        self,
        states: np.ndarray,
        controls: np.ndarray,
        costates: np.ndarray,
        data: Data,
        known: KnownExtremal | None = None,
    ) -> CollocationUnknowns:
        """Unknowns from states and controls at the points, shape (B, N, s, ...), and costates at the nodes.

        The velocities are the derivatives of the polynomials through the points and the nodes that are ``known``, else
        the dynamics.
        """
        if known is not None:
            nodes, places = known.nodes, np.array(self.method.nodes)
            through = self._chart.polynomials(places, nodes[:, :-1], states, nodes[:, 1:])
            velocities = through.slopes(places) / data.steps[:, :, None, None]
            if np.all(np.isfinite(velocities)):  # else a step does not fit into a chart
                return CollocationUnknowns(through.centres, velocities, controls, known.stage_costates)
        half = self.stages // 2
        centres = states[:, :, half]
        if self.stages % 2 == 0:
            (centres,) = self._middle.at(2, states[:, :, half - 1], states[:, :, half])
        (velocities,) = self._velocity.at(3, centres[:, :, None], states, controls, data.parameters[:, None, None])
        place = self.method.nodes[:, None]
        between = (1 - place) * costates[:, :-1, None] + place * costates[:, 1:, None]
        return CollocationUnknowns(centres, velocities, controls, between)

    def ends(self, unknowns: CollocationUnknowns, data: Data) -> Arrays:
        """Beginnings and ends of the steps, shape (B, N, E)."""
        eta = np.einsum("bk,j,bkja->bka", data.steps, self.tableau.weights, unknowns.velocities)
        return self.functions[FunctionName.ENDS].at(2, unknowns.centres, eta)

    def weights(self, data: Data) -> np.ndarray:
        """Weights of the inequalities, shape (B, N, r, c)."""
        weights = np.array([*self.tableau.weights, 1.0][: self.places])
        return data.steps[:, :, None, None] * weights[:, None] * data.activation(self.inequalities, self.places)

    def at_stages(
        self, unknowns: CollocationUnknowns, costates: np.ndarray, data: Data, slacks: Slacks | None
    ) -> AtStages:
        """States, controls and costates at the points, (B, N s, ...)."""
        del costates, slacks
        xi = np.einsum("bk,ij,bkja->bkia", data.steps, self.tableau.matrix, unknowns.velocities)
        states, covectors = self.state_at_point.at(3, unknowns.centres[:, :, None], xi, unknowns.costates)
        states, controls, covectors = (
            a.reshape(len(a), a.shape[1] * self.stages, a.shape[-1]) for a in (states, unknowns.controls, covectors)
        )
        return states, controls, covectors

    def _move_centre(self, x: Array, dx: Array) -> tuple[Ambient, Any]:
        """The centre moved in its chart, and its frame carried along."""
        centre = self.state.point(x)
        frame = self.manifold.basis(centre)
        moved = self.method.retraction(centre, vec.combine(frame, dx))
        return moved, lambda c: self.manifold.projection(moved, vec.combine(frame, c))

    def _ends_of(self, x: Array, eta: Array) -> tuple[Array, ...]:
        centre = self.state.point(x)
        ends = self.method.retraction.both_ways(centre, vec.combine(self.manifold.basis(centre), eta / 2))
        return tuple(map(self.state.flat, ends))

    def _point_of(self, z: Array, x: Array, *given: Array) -> tuple[Any, ...]:
        """The Lagrangian of a point as a function of the step ``z`` of its unknowns; defect, cost, inequalities."""
        xi, nu, control, costate, weight, parameters, pull = given
        n, u = self.directions, self.control.point(control)
        bound = self.problem.with_parameters(self.parameter.point(parameters))
        here = self.state.point(x)
        e = self.manifold.basis(self.method.retraction(here, vec.combine(self.manifold.basis(here), xi)))
        centre, carried = self._move_centre(x, z[:n])
        a, v = carried(xi + z[n : 2 * n]), carried(nu + z[2 * n : 3 * n])
        q, velocity = jax.jvp(lambda a: self.method.retraction(centre, a), (a,), (v,))
        turn = default_retraction(self.controls)
        moved = turn.chart(u, turn.frame(u), z[3 * n :])
        defect = weight[0] * vec.components(e, vec.subtract(velocity, bound.velocity(q, moved)))
        cost, limits = weight[0] * bound.cost_rate(q, moved), bound.inequalities(q, moved)
        multipliers = vec.components(e, self.state.point(costate))
        lagrangian = cost + multipliers @ defect + weight[0] * pull @ limits
        return lagrangian, (defect, cost[None], limits), self.state.flat_frame(e), multipliers

    def _both_of(self, z: Array, x: Array, eta: Array, *given: Array) -> tuple[Array, tuple[Array, ...]]:
        """The Lagrangian of the ends of a step as a function of the step ``z`` of ``(x, eta)``; ends, cost,
        inequalities."""
        q0, q1, p0, p1 = map(self.state.point, given[:4])
        n = self.directions
        centre, carried = self._move_centre(x, z[:n])
        begin, finish = self.method.retraction.both_ways(centre, carried((eta + z[n:]) / 2))
        values = vec.components(self.manifold.basis(q0), begin), vec.components(self.manifold.basis(q1), finish)
        lagrangian = vec.pairing(p0, begin) - vec.pairing(p1, finish)
        if not given[4:]:
            return lagrangian, values
        step, parameters, pull, index = given[4:]
        bound = self.problem.with_parameters(self.parameter.point(parameters))
        if self.node_costs:
            cost = bound.cost_at_node(finish, index[0].astype(int))
            lagrangian, values = lagrangian + cost, (*values, cost[None])
        if not self.at_nodes:
            return lagrangian, values
        limits = jnp.concatenate([bound.node_inequalities(end) for end in (finish, begin)])
        return lagrangian + step[0] * pull @ limits, (*values, limits)

    def _centre_move_of(self, x: Array, dx: Array) -> tuple[Array, Array]:
        moved, carried = self._move_centre(x, dx)
        frame = self.manifold.basis(moved)
        turns = jax.vmap(lambda c: vec.components(frame, carried(c)))(jnp.eye(self.directions))
        return self.state.flat(moved), turns.T

    def _control_move_of(self, u: Array, du: Array) -> tuple[Array]:
        turn, control = default_retraction(self.controls), self.control.point(u)
        return (self.control.flat(turn.chart(control, turn.frame(control), du)),)

    def _state_at(self, x: Array, xi: Array, costate: Array) -> tuple[Array, Array]:
        centre = self.state.point(x)
        q = self.method.retraction(centre, vec.combine(self.manifold.basis(centre), xi))
        return self.state.flat(q), self.state.flat(self.manifold.projection(q, self.state.point(costate)))

    def _velocity_at(self, x: Array, q: Array, u: Array, parameters: Array) -> tuple[Array]:
        bound = self.problem.with_parameters(self.parameter.point(parameters))
        velocity = bound.velocity(self.state.point(q), self.control.point(u))
        return (vec.components(self.manifold.basis(self.state.point(x)), velocity),)

    def _middle_of(self, a: Array, b: Array) -> tuple[Array]:
        x, y = self.state.point(a), self.state.point(b)
        half = self.manifold.projection(x, vec.scale(0.5, vec.subtract(y, x)))
        return (self.state.flat(self.method.retraction(x, half)),)
