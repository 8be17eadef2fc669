"""Derivatives of an extremal with respect to its ends, horizon and parameters.

Where ``F(y, theta) = 0`` are the first-order conditions, with the regular Jacobian ``K`` of a solution, the implicit
function theorem gives ``dy/dtheta = -K^-1 dF/dtheta`` [Fiacco 1976]. The cost has the derivative ``dL/dtheta`` of the
Lagrangian.
"""

from functools import partial
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.base import Evaluator
from ....compute.binding.condensing import condense_steps
from ....manifolds import InvalidInputError
from ....manifolds.numerics import ambient as vec
from ....retractions import default_retraction
from ..transcription.kkt_system import KKTSystem

CHANGED = 1e-9  # relative: more than rounding


class Columns(NamedTuple):
    """Derivatives of the equations of the steps by their lengths and by the parameters, ``K = 1 + P`` columns."""

    slope: np.ndarray  # (N, z + r, K), with rows of the inequalities
    begin: np.ndarray  # (N, n, K): of the beginnings, in the frames of the nodes
    end: np.ndarray
    lagrangian: np.ndarray  # (N, K)


class Derivatives(NamedTuple):
    """Derivatives in K columns: by the coordinates of the start, of the end, by the horizon, and by the parameters."""

    cost: np.ndarray  # (K,)
    states: np.ndarray  # (K, N + 1, E)
    costates: np.ndarray
    controls: np.ndarray  # (K, N s, U)
    smallest: float  # pivot of the elimination


class _EndCost(NamedTuple):
    """The curvature of the cost of an end, ``(n, n)``, and derivatives by horizon and parameters: of its slope, ``(n,
    K)``, and of its value, ``(K,)``."""

    curvature: np.ndarray
    mixed: np.ndarray
    value: np.ndarray


@final
class ParametricSensitivity:
    """The derivatives of extremals of one problem and method, traced once."""

    def __init__(self, steps: Any, nodes: Any, evaluator: Evaluator) -> None:
        self.steps, self.nodes = steps, nodes
        columns = _OneStageColumns if steps.stages == 1 else _CollocationColumns
        self.columns = columns(steps, nodes.problem, evaluator)
        n, e, k = nodes.problem.manifold.dimension, nodes.layout.size, nodes.parameter.size
        m, u = nodes.problem.controls.dimension, nodes.control.size
        costs = {"initial_cost": nodes.problem.initial_cost, "terminal_cost": nodes.problem.terminal_cost}
        self._paid = [
            None if cost is None else evaluator.derivatives(partial(self._cost_of, name), n + k, e, k)
            for name, cost in costs.items()
        ]
        self._turned = evaluator.values(self._turned_of, u, m)
        self._carried = evaluator.values(self._carried_of, e, e, e, e)

    def __call__(self, system: KKTSystem) -> Derivatives:
        """The derivatives of the extremal with this KKT matrix."""
        n, z, own = self.nodes.problem.manifold.dimension, system.dimension, self.columns(system)
        steps, k = system.array("STEP_SIZE", -1), own.lagrangian.shape[1]
        share = np.ones((len(steps), k))
        share[:, 0] = steps / np.sum(steps)
        own = Columns(*(a * (share if a.ndim == 2 else share[:, None]) for a in own))
        first, last = (self._of_end(system, place) for place in (0, -1))
        own.slope[-1, :z] += system.right[-1].T @ (last.curvature @ own.end[-1] + last.mixed)
        own.slope[0, :z] += system.left[0].T @ (first.curvature @ own.begin[0] + first.mixed)
        defect = np.zeros((len(steps) + 1, n, 2 * n + k))
        defect[:-1, :, 2 * n :] += own.begin
        defect[1:, :, 2 * n :] -= own.end
        prescribed = np.zeros((2, n, 2 * n + k))
        prescribed[0, :, :n], prescribed[1, :, n : 2 * n] = map(np.diag, system.fixed)
        defect[0] -= prescribed[0]
        defect[-1] += prescribed[1]
        found = system.solve(np.concatenate([np.zeros((*own.slope.shape[:2], 2 * n)), own.slope], axis=2), defect)
        moves, turned = found.step[:, :z], found.multipliers
        moved = np.concatenate([system.left @ moves, (system.right[-1] @ moves[-1])[None]])
        moved[..., 2 * n :] += np.concatenate([own.begin, own.end[-1:]])
        moved[[0, -1]] = np.where(system.fixed[..., None] > 0, prescribed, moved[[0, -1]])
        turned[-1] -= last.curvature @ moved[-1]
        turned[-1, :, 2 * n :] -= last.mixed
        turned[0] += first.curvature @ moved[0]
        turned[0, :, 2 * n :] += first.mixed
        lagrangian = np.sum(own.lagrangian, axis=0) + last.value + first.value
        cost = np.concatenate([-system.multipliers[0], system.multipliers[-1], lagrangian])
        return Derivatives(
            cost, *self._ambient(system, moved, turned), self._of_controls(system, moves), found.smallest
        )

    def _of_end(self, system: KKTSystem, place: int) -> _EndCost:
        """The derivatives of the cost of the first or of the last node, zero where there is none."""
        n, k = system.frames.shape[1], self.nodes.parameter.size
        function, mixed, value = self._paid[place], np.zeros((n, 1 + k)), np.zeros(1 + k)
        known = system.array("END_COST" if place else "START_COST", -1)[-n - n * n :]
        slope, curvature = known[:n], known[n:].reshape(n, n)
        if function is None:
            return _EndCost(np.zeros((n, n)), mixed, value)
        hessian, gradient, *_ = (a[0] for a in function.at(1, system.nodes[[place]], system.array("PARAMETERS", 1, -1)))
        _require_unchanged((hessian[:n, :n], curvature), (gradient[:n], slope))
        mixed[:, 1:], value[1:] = hessian[:n, n:], gradient[n:]
        return _EndCost(curvature, mixed, value)

    def _ambient(self, system: KKTSystem, moved: np.ndarray, turned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of states and costates in the ambient space; a covector stays one as its node moves."""
        vectors, covectors = (np.einsum("knj,kne->kje", a, system.frames) for a in (moved, turned))
        (carried,) = self._carried.at(2, system.nodes[:, None], system.costates[:, None], vectors, covectors)
        return np.moveaxis(vectors, 1, 0), np.moveaxis(carried, 1, 0)

    def _of_controls(self, system: KKTSystem, moves: np.ndarray) -> np.ndarray:
        own, (count, _, columns) = system.sizes, moves.shape
        turns = moves[:, own.state_size :].reshape(count, own.points, own.control_size, columns)
        u = system.array("CONTROLS", count, own.points, 1, own.control_numbers)
        (found,) = self._turned.at(3, u, np.moveaxis(turns, 3, 2))
        return np.moveaxis(found, 2, 0).reshape(columns, count * own.points, own.control_numbers)

    def _cost_of(self, name: str, d: Array, q: Array, parameters: Array) -> tuple[Array, Array]:
        n, point = self.nodes.problem.manifold.dimension, self.nodes.layout.point(q)
        bound = self.nodes.problem.with_parameters(self.nodes.parameter.point(parameters + d[n:]))
        return getattr(bound, name)(vec.add(point, vec.combine(bound.manifold.basis(point), d[:n]))), jnp.zeros(0)

    def _turned_of(self, u: Array, du: Array) -> tuple[Array]:
        point, turn = self.nodes.control.point(u), default_retraction(self.nodes.problem.controls)
        frame = turn.frame(point)
        return (
            jax.jvp(lambda d: self.nodes.control.flat(turn.chart(point, frame, d)), (jnp.zeros_like(du),), (du,))[1],
        )

    def _carried_of(self, *given: Array) -> tuple[Array]:
        manifold, layout = self.nodes.problem.manifold, self.nodes.layout
        q, p, dq, dp = map(layout.point, given)
        return (layout.flat(jax.jvp(manifold.projection, (q, p), (dq, dp))[1]),)


def _require_unchanged(*pairs: tuple[np.ndarray, np.ndarray]) -> None:
    """Raise if functions that are traced for their derivatives compute other values than when the solver was made."""
    if not all(
        np.max(np.abs(now - then), initial=0.0) <= CHANGED * np.max(np.abs(then), initial=0.0) for now, then in pairs
    ):
        raise InvalidInputError(
            "the problem's functions compute other values than when the solver was made; make a new Solver after a "
            "change, or give what changes as parameters"
        )


@final
class _OneStageColumns:
    """Mixed derivatives of the steps of a discretization map."""

    def __init__(self, steps: Any, problem: Any, evaluator: Evaluator) -> None:
        self.steps = steps
        # The blocks of the first and of the last step have the costs of the ends too.
        self._free = slice(int(problem.initial_cost is not None), -1 if problem.terminal_cost is not None else None)
        e, u, k = steps.state.size, steps.control.size, steps.parameter.size
        self._row = evaluator.derivatives(
            self._row_of, steps.dimension + 1 + k, e, u, e, e, e, e, 1, k, steps.inequalities
        )

    def __call__(self, system: KKTSystem) -> Columns:
        z, own, free = self.steps.dimension, system.sizes, self._free
        x, u = (system.array(name, own.steps, -1) for name in ("CENTRES", "CONTROLS"))
        around = (a for all_nodes in (system.nodes, system.costates) for a in (all_nodes[:-1], all_nodes[1:]))
        given = system.array("STEP_SIZE", -1, 1), system.array("PARAMETERS", 1, -1)
        pull = system.in_steps(system.iterate.array("LIMIT_MULTIPLIERS"))
        found = self._row.at(1, x, u, *around, *given, pull)
        hessian, gradient, left, right, _, limits, _, _, cost, _ = found
        _require_unchanged(
            (cost[:, 0], system.array("COSTS", -1)),
            (left[..., :z], system.left),
            (hessian[free, :z, :z], system.hessian[free]),
        )
        slope = np.concatenate([hessian[:, :z, z:], limits[..., z:]], axis=1)
        return Columns(slope, left[..., z:], right[..., z:], gradient[:, z:])

    def _row_of(self, d: Array, *given: Array) -> tuple[Array, tuple[Array, ...]]:
        z, (*at, h, parameters, pull) = self.steps.dimension, given
        return self.steps._row_of(d[:z], *at, h + d[z : z + 1], parameters + d[z + 1 :], pull)


class _AtEnds(NamedTuple):
    """Derivatives by the parameters of the slope of the Lagrangian of the ends of steps, ``(N, 2 n, P)``, and of the
    Lagrangian itself, ``(N, P)``; and of the inequalities there by step lengths and parameters, ``(N, d, 1 + P)``."""

    mixed: np.ndarray
    slope: np.ndarray
    limits: np.ndarray


@final
class _CollocationColumns:
    """Mixed derivatives of collocation steps: their points' by the parameters; the length of a step enters linearly."""

    def __init__(self, steps: Any, problem: Any, evaluator: Evaluator) -> None:
        del problem
        self.steps = steps
        e, u, k, n = steps.state.size, steps.control.size, steps.parameter.size, steps.manifold.dimension
        self.dimension = 3 * n + steps.controls.dimension
        self._point = evaluator.derivatives(self._point_of, self.dimension + k, e, n, n, u, e, 1, k, steps.own)
        at_ends = e, n, e, e, e, e, 1, k, steps.at_nodes
        self._ends = evaluator.derivatives(self._ends_of, 2 * n + k, *at_ends) if steps.at_nodes else None

    def __call__(self, system: KKTSystem) -> Columns:
        own, q, points = system.sizes, self.dimension, system.collocation
        n, h, shape = own.state_size, points.step_size, (own.steps, own.points)
        names = "XI", "VELOCITIES", "CONTROLS", "POINT_COSTATES", "POINT_WEIGHTS"
        xi, velocities, *rest = (system.array(name, *shape, -1) for name in names)
        turned, each = xi / h[:, None, None], h[:, None, None]  # derivative of xi by h
        pulls = system.limits_of(system.iterate.array("LIMIT_MULTIPLIERS"))
        at = system.array("CENTRES", own.steps, 1, -1), xi, velocities, *rest
        found = self._point.at(2, *at, system.array("PARAMETERS", 1, 1, -1), pulls[0])
        hessian, gradient, constraints, _, limits, defect, cost, _ = found
        _require_unchanged((hessian[..., :q, :q], points.hessian), (constraints[..., :q], points.jacobian))
        _require_unchanged((np.sum(cost[..., 0], axis=1), system.array("COSTS", -1)))
        far = system.array("ETA", own.steps, n) / h[:, None]  # derivative of eta by h
        slope, end_slope = gradient[..., :q], points.end_slope[..., 0]
        # The Lagrangian of a point is its weight h b_i times a function; and xi = h matrix nu, eta = h weights nu.
        by_h = np.einsum("kizy,kiy->kiz", hessian[..., :q, n : 2 * n], turned) + slope / each
        by_h[..., 2 * n : 3 * n] += np.einsum("ij,kia->kja", points.matrix, slope[..., n : 2 * n])
        by_h[..., 2 * n : 3 * n] += points.weights[:, None] * end_slope[:, None, n:]
        missed = np.einsum("kiny,kiy->kin", constraints[..., n : 2 * n], turned) + defect / each
        lagrangian = np.sum(gradient[..., n : 2 * n] * turned, axis=2) + cost[..., 0] / h[:, None]
        lagrangian = np.sum(lagrangian, axis=1) + np.sum(end_slope[..., n:] * far, axis=1)
        at_ends = self._at_ends(system, far, pulls[1])
        outer = np.einsum("kzy,ky->kz", points.end_hessian[..., n:], far)[..., None]
        wanted = points._replace(
            slope=np.concatenate([by_h[..., None], hessian[..., :q, q:]], axis=3),
            defect=np.concatenate([missed[..., None], constraints[..., q:]], axis=3),
            end_slope=np.concatenate([outer, at_ends.mixed], axis=2),
        )
        parts, kept = condense_steps(wanted)
        begin, finish = parts.before, parts.after
        begin[..., 0] += np.einsum("kny,ky->kn", points.end_left[..., n:], far)
        finish[..., 0] += np.einsum("kny,ky->kn", points.end_right[..., n:], far)
        by_parameters = np.sum(gradient[..., q:], axis=1) + at_ends.slope
        direct = np.einsum("kicy,kiy->kic", limits[..., n : 2 * n], turned)[..., None]
        direct = np.concatenate([direct, limits[..., q:]], axis=3).reshape(own.steps, -1, parts.slope.shape[2])
        rows = np.concatenate([direct, at_ends.limits], axis=1)
        rows += system.limits[1] @ kept.velocities[..., system.dimension :]
        whole = np.concatenate([lagrangian[..., None], by_parameters], axis=1)
        return Columns(np.concatenate([parts.slope, rows], axis=1), begin, finish, whole)

    def _at_ends(self, system: KKTSystem, far: np.ndarray, pull: np.ndarray) -> _AtEnds:
        """The inequalities at nodes; ``far``: the derivative of ``eta`` by the length of a step."""
        count, n, k = *far.shape, self.steps.parameter.size
        if self._ends is None:
            return _AtEnds(*map(np.zeros, ((count, 2 * n, k), (count, k), (count, 0, 1 + k))))
        around = (a for all_nodes in (system.nodes, system.costates) for a in (all_nodes[:-1], all_nodes[1:]))
        at = system.array("CENTRES", count, -1), system.array("ETA", count, n), *around
        given = system.array("STEP_SIZE", -1, 1), system.array("PARAMETERS", 1, -1), pull
        hessian, slope, _, _, limits, *_ = self._ends.at(1, *at, *given)
        by_h = np.einsum("kcy,ky->kc", limits[..., n : 2 * n], far)[..., None]
        rows = np.concatenate([by_h, limits[..., 2 * n :]], axis=2)
        return _AtEnds(hessian[:, : 2 * n, 2 * n :], slope[:, 2 * n :], rows)

    def _ends_of(self, z: Array, *given: Array) -> tuple[Array, tuple[Array, ...]]:
        (*at, parameters, pull), both = given, 2 * self.steps.manifold.dimension
        return self.steps._both_of(z[:both], *at, parameters + z[both:], pull)

    def _point_of(self, z: Array, *given: Array) -> tuple[Array, ...]:
        *at, parameters, pull = given
        return self.steps._point_of(z[: self.dimension], *at, parameters + z[self.dimension :], pull)[:2]
