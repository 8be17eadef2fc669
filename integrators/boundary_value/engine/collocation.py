"""The steps of Gauss's method: several points in the chart of each step, condensed to its centre and its controls."""

from collections.abc import Sequence
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.base import Arrays, Evaluator
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....retractions import CollocationMethod, default_retraction
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.point_layout import PointLayout, parameter_layout
from ..transcription.chart import Chart
from ..transcription.iterate import CollocationUnknowns, Data, Known, Slacks
from .arrays import plain
from .condensing import Condensed, Ends, Points, Tableau, condense, expand, full_slope, slopes
from .extent import OF_POINTS
from .inequalities import Held, raised
from .scaling import Units
from .transcription import AtStages, Blocks, Moves, Nodes, inequalities_of, is_kept, kept_of


class Inner(NamedTuple):
    """What was condensed: what the points lack, their multipliers, and what gives the step of the velocities back."""

    before: np.ndarray  # (B, N, n): what the velocities that mend the defects move the beginning by
    after: np.ndarray
    defect: np.ndarray  # (B, N, s, n), times h b_i
    multipliers: np.ndarray  # (B, N, s, n)
    slope: np.ndarray  # (B, N, s, n): of the Lagrangian by the velocities
    extent: np.ndarray  # (B, 6, n): the survey of the points
    gradient: np.ndarray  # (B, N, s, n): of the cost
    frames: np.ndarray  # (B, N, s, n, E), at the points
    points: Points
    ends: Ends
    kept: tuple[np.ndarray, np.ndarray, np.ndarray]


@final
class Collocation:
    """The steps of a Gauss method with at least two points.

    Where there are inequalities at nodes, a step has those of its ends behind those of its points, as of one more
    point, whose unknowns are ``(dx, deta)``: ``eta = h sum_j b_j nu_j``.
    """

    def __init__(
        self, problem: OptimalControlProblem, method: CollocationMethod, parameters: Any, evaluator: Evaluator
    ) -> None:
        self.problem, self.method, self.stages = problem, method, method.stages
        self.manifold, self.controls = problem.manifold, problem.controls
        # Of a product they are sums that are taken again each time.
        n, m = self.manifold.dimension, self.controls.dimension
        self.directions = n
        self.dimension = n + self.stages * m
        self.tableau = Tableau(np.array(method.centred), np.array(method.weights))
        self.state, self.control, self.parameter = (
            PointLayout.of(self.manifold),
            PointLayout.of(self.controls),
            parameter_layout(parameters),
        )
        e, u, k = self.state.size, self.control.size, self.parameter.size
        self._ends = evaluator.values(self._ends_of, e, n)
        bound = problem.with_parameters(parameters)
        self.inequalities, self.own = inequalities_of(bound), len(bound._inequality_names)
        self.kept = kept_of(bound)
        self.at_nodes = self.inequalities - self.own
        self.places = self.stages + (self.at_nodes > 0)
        self._point = evaluator.derivatives(self._point_of, 3 * n + m, e, n, n, u, e, 1, k, self.own)
        pulled = (1, k, self.at_nodes) if self.at_nodes else ()
        self._both = evaluator.derivatives(self._both_of, 2 * n, e, n, e, e, e, e, *pulled)
        self._centre = evaluator.values(self._centre_moved, e, n)
        self._control = evaluator.values(self._control_moved, u, m)
        self._state = evaluator.values(self._state_at, e, n, e)
        self._velocity = evaluator.values(self._velocity_at, e, e, u, k)
        self._middle = evaluator.values(self._middle_of, e, e)
        self._chart = Chart(method.retraction, evaluator)
        self._trial: tuple[int, Any] | None = None

    def begin(
        self, states: np.ndarray, controls: np.ndarray, costates: np.ndarray, data: Data, known: Known | None = None
    ) -> CollocationUnknowns:
        """Unknowns from states and controls at the points, shape (B, N, s, ...), and costates at the nodes.

        The velocities are those of the polynomials through the points and the nodes that are ``known``, else of the
        dynamics.
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

    def trial(self, nodes: Nodes, count: int) -> Any:
        """The compiled pass of a trial of one trajectory of so many steps, if there is one; the last one is kept."""
        if self.at_nodes:
            return None
        known = self._trial
        if known is None or not is_kept(known, count):
            from .collocation_trial import CollocationTrial

            known = self._trial = count, CollocationTrial.of(self, nodes, count)
        return known[1]

    def ends(self, unknowns: CollocationUnknowns, data: Data) -> Arrays:
        """Beginnings and ends of the steps, shape (B, N, E)."""
        return self._ends.at(2, unknowns.centres, self._eta(unknowns, data))

    def blocks(
        self,
        unknowns: CollocationUnknowns,
        nodes: np.ndarray,
        costates: np.ndarray,
        data: Data,
        slacks: Slacks | None = None,
    ) -> Blocks:
        """The condensed blocks at an iterate with these states and covectors at the nodes, shape (B, N + 1, E)."""
        steps, shape = data.steps, data.steps.shape
        found = self._at_points(unknowns, data, slacks)
        hessian, slope, constraints, gradient, pushes, missed, cost, limits, frames, multipliers = found
        held, columns, defect = None, slope[..., None], missed[..., None]
        around = nodes[:, :-1], nodes[:, 1:], costates[:, :-1], costates[:, 1:]
        curvature, pull, left, right, *at_nodes = self._at_ends(unknowns, around, data, slacks)
        pulls = pull[..., None]
        if slacks is not None:  # the second column, times the barrier, has no defect
            held = self._held((limits, pushes), at_nodes, data)
            columns, pulls = self._raised((hessian, slope), (curvature, pull), held, slacks)
            defect = np.concatenate([defect, np.zeros_like(defect)], axis=-1)
        points, ends = Points(hessian, constraints, columns, defect), Ends(curvature, left, right, pulls)
        parts, condensed = condense(points, ends, steps, self.tableau)
        factors, swaps, maps = (a.reshape(*shape, *a.shape[1:]) for a in condensed.kept)
        (whole, paid), (pulled, inner) = slopes((slope, gradient[..., 0, :]), pull, condensed)
        lacking = missed, multipliers, pulled, self._surveyed(missed, multipliers, pulled, steps)
        kept = condensed.points, condensed.ends, (factors, swaps, maps)
        inner = Inner(parts.before[..., 0], parts.after[..., 0], *lacking, inner, frames, *kept)
        costs = np.sum(cost[..., 0], axis=2)
        blocks = Blocks(parts.hessian, parts.left, parts.right, parts.slope[..., 0], paid, costs, inner)
        if held is None:
            return blocks
        return blocks._replace(slope=whole, held=held, pushed=parts.slope)

    def weights(self, data: Data) -> np.ndarray:
        """Weights of the inequalities, shape (B, N, r, c)."""
        own = np.array([*self.tableau.weights, 1.0][: self.places])
        return data.steps[:, :, None, None] * own[:, None] * data.held(self.inequalities, self.places)

    def _held(self, of_points: tuple[np.ndarray, np.ndarray], of_ends: Sequence[np.ndarray], data: Data) -> Held:
        """The inequalities of the points, and of the ends if there are some, from their values and derivatives."""
        weights = self.weights(data)
        if not self.at_nodes:
            return Held(*of_points, weights)
        (slope, _, _, value), own, s = of_ends, self.own, self.stages
        values = np.zeros((*data.steps.shape, self.places, self.inequalities))
        jacobian = np.zeros((*values.shape, of_points[1].shape[4]))
        values[:, :, :s, :own], values[:, :, s, own:] = of_points[0], value
        jacobian[:, :, :s, :own], jacobian[:, :, s, own:, : slope.shape[3]] = of_points[1], slope
        return Held(values, jacobian, weights)

    def _raised(
        self, points: tuple[np.ndarray, np.ndarray], ends: tuple[np.ndarray, np.ndarray], held: Held, slacks: Slacks
    ) -> tuple[np.ndarray, np.ndarray]:
        """Slopes of points and ends in two columns, with the share of the inequalities; raises their Hessians in
        place."""
        if not self.at_nodes:
            return raised(*points, held, slacks), np.stack([ends[1], np.zeros_like(ends[1])], axis=-1)
        within, last = np.s_[:, :, : self.stages, : self.own], np.s_[:, :, self.stages :, self.own :]
        of_ends = Held(*(a[last] for a in held))
        of_ends = of_ends._replace(jacobian=of_ends.jacobian[..., : 2 * self.directions])
        columns = raised(*points, Held(*(a[within] for a in held)), slacks.at(within))
        return columns, raised(ends[0][:, :, None], ends[1][:, :, None], of_ends, slacks.at(last))[:, :, 0]

    def _at_ends(self, unknowns: CollocationUnknowns, around: Arrays, data: Data, slacks: Slacks | None) -> Arrays:
        """What belongs to the ends with its derivatives, and the inequalities there."""
        given = unknowns.centres, self._eta(unknowns, data), *around
        if not self.at_nodes:
            return self._both.at(2, *given)
        none = np.zeros((*data.steps.shape, self.at_nodes))
        pull = none if slacks is None else slacks.multipliers[:, :, -1, self.own :]
        return self._both.at(2, *given, data.steps[:, :, None], data.parameters[:, None], pull)

    def _surveyed(
        self, defect: np.ndarray, multipliers: np.ndarray, slope: np.ndarray, steps: np.ndarray
    ) -> np.ndarray:
        """What is largest in what the points lack, coordinate by coordinate, shape (B, 6, n)."""
        from . import extent_kernels

        found, weights = np.zeros((len(steps), OF_POINTS, defect.shape[3])), steps[:, :, None] * self.tableau.weights
        given = tuple(map(plain, (defect, multipliers, slope, weights)))
        extent_kernels.survey_points(0, len(steps), *given, found)
        return found

    def _at_points(self, unknowns: CollocationUnknowns, data: Data, slacks: Slacks | None) -> Arrays:
        """The functions of the points with their derivatives."""
        xi = np.einsum("bk,ij,bkja->bkia", data.steps, self.tableau.matrix, unknowns.velocities)
        weights = (data.steps[:, :, None] * self.tableau.weights)[..., None]
        at = unknowns.centres[:, :, None], xi, unknowns.velocities, unknowns.controls, unknowns.costates, weights
        none = np.zeros((*weights.shape[:3], self.own))
        pull = none if slacks is None else slacks.multipliers[:, :, : self.stages, : self.own]
        return self._point.at(3, *at, data.parameters[:, None, None], pull)

    def move(self, unknowns: CollocationUnknowns, blocks: Blocks, step: Moves, data: Data) -> CollocationUnknowns:
        """The unknowns moved by fractions of the steps of the condensed system."""
        steps, part, inner, whole = step.steps, step.fraction, blocks.inner, step.inner
        some = part[:, None, None]
        centres, turns = self._centre.at(2, unknowns.centres, some * steps[..., : self.directions])
        velocities = np.einsum("bkac,bkic->bkia", turns, unknowns.velocities + some[..., None] * whole[0])
        turned = some[..., None] * steps[..., self.directions :].reshape(*unknowns.controls.shape[:3], -1)
        (controls,) = self._control.at(3, unknowns.controls, turned)
        costates = np.einsum("bkine,bkin->bkie", inner.frames, inner.multipliers + some[..., None] * whole[1])
        return CollocationUnknowns(centres, velocities, controls, costates)

    def whole(self, blocks: Blocks, step: Moves, data: Data, slacks: Slacks | None) -> tuple[np.ndarray, np.ndarray]:
        """Steps of the velocities and multipliers of the points, shape (B, N, s, n), from those of the condensed
        system."""
        inner, points, ends = blocks.inner, blocks.inner.points, blocks.inner.ends
        if slacks is not None:
            push = slacks.barrier[:, None, None, None, None]
            points = points._replace(slope=points.slope[..., :1] + push * points.slope[..., 1:])
            ends = ends._replace(slope=ends.slope[..., :1] + push[..., 0] * ends.slope[..., 1:])
        table = np.ascontiguousarray(data.steps).ravel(), self.tableau.matrix, self.tableau.weights
        factors, swaps, maps = (a.reshape(-1, *a.shape[2:]) for a in inner.kept)
        condensed = Condensed(points, ends, table, (factors, swaps, maps))
        found = expand(condensed, step.steps[..., None], step.multipliers[..., None])
        return found.dnu[..., 0], found.dlambda[..., 0]

    def scaled(self, unknowns: CollocationUnknowns, factor: np.ndarray) -> CollocationUnknowns:
        """The unknowns with all costates among them times factors, shape (B,)."""
        return unknowns._replace(costates=factor[:, None, None, None] * unknowns.costates)

    def at_each(self, moves: Moves, data: Data) -> np.ndarray:
        """The steps of the unknowns ``(dx, dxi, dnu, du)`` of each point, and of those of the ends, shape (B, N, r, 3 n
        + m)."""
        n, velocities = self.directions, moves.inner[0]
        centres = np.broadcast_to(moves.steps[:, :, None, :n], velocities.shape)
        xi = np.einsum("bk,ij,bkja->bkia", data.steps, self.tableau.matrix, velocities)
        controls = moves.steps[:, :, n:].reshape(*velocities.shape[:3], -1)
        found = np.concatenate([centres, xi, velocities, controls], axis=3)
        if not self.at_nodes:
            return found
        ends = np.zeros((*found.shape[:2], 1, found.shape[3]))
        ends[:, :, 0, :n] = moves.steps[:, :, :n]
        ends[:, :, 0, n : 2 * n] = np.einsum("bk,j,bkja->bka", data.steps, self.tableau.weights, velocities)
        return np.concatenate([found, ends], axis=2)

    def sizes(self, units: Units) -> np.ndarray:
        """Units of the unknowns of each point, and of the ends, that an inequality depends on, shape (B, 1, r, 3 n +
        m)."""
        n, s = self.directions, self.stages
        controls = units.unknowns[:, n:].reshape(len(units.unknowns), s, -1)
        nodes = np.repeat(units.nodes[:, None], s, axis=1)
        found = np.concatenate([nodes, nodes, np.zeros_like(nodes), controls], axis=2)
        if self.at_nodes:
            found = np.concatenate([found, found[:, :1]], axis=1)  # a control of an end does not count
        return found[:, None]

    def limits(self, blocks: Blocks, steps: np.ndarray, maps: np.ndarray | None = None) -> np.ndarray:
        """Derivatives of the inequalities of all points in the unknowns of the condensed steps, shape (B, N, r c, z).

        With ``maps`` of steps that were condensed with other right-hand sides, columns follow by which their defects
        change them.
        """
        held, points, ends = blocks.inequalities, blocks.inner.points, blocks.inner.ends
        n, s, z = self.directions, self.stages, self.dimension
        maps = blocks.inner.kept[2][..., :z] if maps is None else maps
        slope = np.einsum("ij,bkicq->bkiqjc", np.eye(self.places), held.jacobian)
        slope = slope.reshape(*slope.shape[:4], -1)
        far = slope[:, :, s, : 2 * n] if self.at_nodes else np.zeros((*slope.shape[:2], 2 * n, slope.shape[4]))
        both = points._replace(slope=slope[:, :, :s]), ends._replace(slope=far)
        full = full_slope(*both, steps, self.tableau)
        found = full[:, :, n : n + s * n].mT @ maps
        found[..., :z] += np.concatenate([full[:, :, :n], full[:, :, n + s * n :]], axis=2).mT
        return found

    def at_stages(
        self, unknowns: CollocationUnknowns, costates: np.ndarray, data: Data, slacks: Slacks | None
    ) -> AtStages:
        """States, controls and costates at the points, (B, N s, ...)."""
        del costates, slacks
        xi = np.einsum("bk,ij,bkja->bkia", data.steps, self.tableau.matrix, unknowns.velocities)
        states, covectors = self._state.at(3, unknowns.centres[:, :, None], xi, unknowns.costates)
        states, controls, covectors = (
            a.reshape(len(a), a.shape[1] * self.stages, a.shape[-1]) for a in (states, unknowns.controls, covectors)
        )
        return states, controls, covectors

    def _eta(self, unknowns: CollocationUnknowns, data: Data) -> np.ndarray:
        return np.einsum("bk,j,bkja->bka", data.steps, self.tableau.weights, unknowns.velocities)

    def _moved(self, x: Array, dx: Array) -> tuple[Ambient, Any]:
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
        xi, nu, control, costate, weight, parameters, pull = given
        n, u = self.directions, self.control.point(control)
        bound = self.problem.with_parameters(self.parameter.point(parameters))
        here = self.state.point(x)
        e = self.manifold.basis(self.method.retraction(here, vec.combine(self.manifold.basis(here), xi)))
        centre, carried = self._moved(x, z[:n])
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
        q0, q1, p0, p1 = map(self.state.point, given[:4])
        n = self.directions
        centre, carried = self._moved(x, z[:n])
        begin, finish = self.method.retraction.both_ways(centre, carried((eta + z[n:]) / 2))
        values = vec.components(self.manifold.basis(q0), begin), vec.components(self.manifold.basis(q1), finish)
        lagrangian = vec.pairing(p0, begin) - vec.pairing(p1, finish)
        if not self.at_nodes:
            return lagrangian, values
        step, parameters, pull = given[4:]
        bound = self.problem.with_parameters(self.parameter.point(parameters))
        limits = jnp.concatenate([bound.node_inequalities(end) for end in (finish, begin)])
        return lagrangian + step[0] * pull @ limits, (*values, limits)

    def _centre_moved(self, x: Array, dx: Array) -> tuple[Array, Array]:
        moved, carried = self._moved(x, dx)
        frame = self.manifold.basis(moved)
        turns = jax.vmap(lambda c: vec.components(frame, carried(c)))(jnp.eye(self.directions))
        return self.state.flat(moved), turns.T

    def _control_moved(self, u: Array, du: Array) -> tuple[Array]:
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
