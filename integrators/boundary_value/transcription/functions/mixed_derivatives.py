"""Mixed derivatives of the first-order conditions: of the equations of the steps by step lengths and parameters."""

from typing import NamedTuple, final

import numpy as np
from jaxtyping import Array

from .....compute.base import Evaluator
from .....compute.binding.condensing import condense_steps
from .....manifolds import InvalidInputError
from ..kkt_system import KKTSystem
from .collocation import CollocationFunctions
from .one_stage import OneStageFunctions

StepFunctions = OneStageFunctions | CollocationFunctions
CHANGED = 1e-9  # relative: more than rounding


class Columns(NamedTuple):
    """Derivatives of the equations of the steps by their lengths and by the parameters, in ``K = 1 + P`` columns."""

    slope: np.ndarray  # (N, z + r, K), with rows of the inequalities
    begin: np.ndarray  # (N, n, K): of the beginnings, in the frames of the nodes
    end: np.ndarray
    lagrangian: np.ndarray  # (N, K)


def require_unchanged(*pairs: tuple[np.ndarray, np.ndarray]) -> None:
    """Raise if functions that are traced for their derivatives compute other values than when the solver was made."""
    if not all(
        np.max(np.abs(now - then), initial=0.0) <= CHANGED * np.max(np.abs(then), initial=0.0) for now, then in pairs
    ):
        raise InvalidInputError(
            "the problem's functions compute other values than when the solver was made; make a new Solver after a "
            "change, or give what changes as parameters"
        )


@final
class OneStageDerivatives:
    """Mixed derivatives of the steps of a discretization map."""

    def __init__(self, steps: OneStageFunctions, evaluator: Evaluator) -> None:
        self.steps, problem = steps, steps.problem
        # The blocks of the first and of the last step have the costs of the ends too.
        self._free = slice(int(problem._starts_with_cost), -1 if problem.terminal_cost is not None else None)
        e, u, k = steps.state.size, steps.control.size, steps.parameter.size
        self._row = evaluator.derivatives(
            self._row_of, steps.dimension + 1 + k, e, u, e, e, e, e, 1, k, steps.inequalities, steps.node_costs
        )

    def __call__(self, system: KKTSystem) -> Columns:
        z, own, free = self.steps.dimension, system.sizes, self._free
        x, u = (system.array(name, own.steps, -1) for name in ("CENTRES", "CONTROLS"))
        around = (a for all_nodes in (system.nodes, system.costates) for a in (all_nodes[:-1], all_nodes[1:]))
        given = system.array("STEP_SIZE", -1, 1), system.array("PARAMETERS", 1, -1)
        pull = system.in_steps(system.iterate.array("LIMIT_MULTIPLIERS"))
        found = self._row.at(1, x, u, *around, *given, pull, system.array("NODE_INDICES", own.steps, -1))
        hessian, gradient, left, right, _, limits, _, _, cost, _ = found
        require_unchanged(
            (cost[:, 0], system.array("COSTS", -1)),
            (left[..., :z], system.left),
            (hessian[free, :z, :z], system.hessian[free]),
        )
        slope = np.concatenate([hessian[:, :z, z:], limits[..., z:]], axis=1)
        return Columns(slope, left[..., z:], right[..., z:], gradient[:, z:])

    def _row_of(self, d: Array, *given: Array) -> tuple[Array, tuple[Array, ...]]:
        z, (*at, h, parameters, pull, index) = self.steps.dimension, given
        return self.steps._row_of(d[:z], *at, h + d[z : z + 1], parameters + d[z + 1 :], pull, index)


class _MixedDerivatives(NamedTuple):
    """Mixed derivatives of the Lagrangian and the equations of collocation steps; parameters have an axis behind."""

    slope: np.ndarray  # (N, s, q): of the slopes of the points
    defect: np.ndarray  # (N, s, n)
    end_slope: np.ndarray  # (N, 2 n)
    limits: np.ndarray  # (N, s, c): of the inequalities of the points
    end_limits: np.ndarray  # (N, d)
    lagrangian: np.ndarray  # (N,): of the Lagrangian itself


def _by_length(system: KKTSystem) -> _MixedDerivatives:
    """Derivatives by the lengths of steps, which the points' displacements and weights are proportional to."""
    points, (limits, end_limits) = system.collocation, system.limit_jacobians
    n, h = system.sizes.state_size, points.step_size
    xi, nu, each = np.s_[..., n : 2 * n], np.s_[..., 2 * n : 3 * n], h[:, None, None]
    turned, far = system.array("XI", *points.defect.shape[:3]) / each, system.array("ETA", -1, n) / h[:, None]
    slope, end_slope = points.slope[..., 0], points.end_slope[..., 0]
    # The Lagrangian of a point is its weight h b_i times a function; and xi = h matrix nu, eta = h weights nu.
    by_h = np.einsum("kizy,kiy->kiz", points.hessian[xi], turned) + slope / each
    by_h[nu] += np.einsum("ij,kia->kja", points.matrix, slope[xi]) + points.weights[:, None] * end_slope[:, None, n:]
    missed = np.einsum("kiny,kiy->kin", points.jacobian[xi], turned) + points.defect[..., 0] / each
    outer = np.einsum("kzy,ky->kz", points.end_hessian[..., n:], far)
    moved = np.einsum("kicy,kiy->kic", limits[xi], turned), np.einsum("kcy,ky->kc", end_limits[xi], far)
    lagrangian = np.sum(slope[xi] * turned, axis=(1, 2)) + np.sum(end_slope[:, n:] * far, axis=1)
    costs = np.sum(system.array("POINT_COSTS", len(h), -1), axis=1)
    return _MixedDerivatives(by_h, missed, outer, *moved, lagrangian + costs / h)


@final
class CollocationDerivatives:
    """Mixed derivatives of the steps of a collocation method."""

    def __init__(self, steps: CollocationFunctions, evaluator: Evaluator) -> None:
        self.steps = steps
        e, u, k, n = steps.state.size, steps.control.size, steps.parameter.size, steps.manifold.dimension
        self.dimension = 3 * n + steps.controls.dimension
        self._point = evaluator.derivatives(self._point_of, self.dimension + k, e, n, n, u, e, 1, k, steps.own)
        at_ends = e, n, e, e, e, e, 1, k, steps.at_nodes, steps.node_costs
        takes = steps.at_nodes or steps.node_costs
        self._ends = evaluator.derivatives(self._ends_of, 2 * n + k, *at_ends) if takes else None

    def __call__(self, system: KKTSystem) -> Columns:
        points, n, count = system.collocation, system.sizes.state_size, system.sizes.steps
        both = zip(_by_length(system), self._by_parameters(system), strict=True)
        own = _MixedDerivatives(*(np.concatenate([by_length[..., None], rest], axis=-1) for by_length, rest in both))
        parts, kept = condense_steps(points._replace(slope=own.slope, defect=own.defect, end_slope=own.end_slope))
        far = system.array("ETA", count, n) / points.step_size[:, None]  # the end moves with the length of its step
        for moved, ends in ((parts.before, points.end_left), (parts.after, points.end_right)):
            moved[..., 0] += np.einsum("kny,ky->kn", ends[..., n:], far)
        limits = [rows.reshape(count, -1, rows.shape[-1]) for rows in (own.limits, own.end_limits)]
        limits = np.concatenate(limits, axis=1) + system.limits[1] @ kept.velocities[..., system.dimension :]
        return Columns(np.concatenate([parts.slope, limits], axis=1), parts.before, parts.after, own.lagrangian)

    def _by_parameters(self, system: KKTSystem) -> _MixedDerivatives:
        """Derivatives by the parameters, with an axis for these."""
        own, q, points = system.sizes, self.dimension, system.collocation
        names = "XI", "VELOCITIES", "CONTROLS", "POINT_COSTATES", "POINT_WEIGHTS"
        at = (system.array(name, own.steps, own.points, -1) for name in names)
        pull, end_pull = system.limits_of(system.iterate.array("LIMIT_MULTIPLIERS"))
        given = system.array("PARAMETERS", 1, 1, -1), pull
        found = self._point.at(2, system.array("CENTRES", own.steps, 1, -1), *at, *given)
        hessian, slope, jacobian, _, limits, _, cost, _ = found
        require_unchanged((hessian[..., :q, :q], points.hessian), (jacobian[..., :q], points.jacobian))
        of_nodes = system.array("END_COSTS", own.steps, -1).sum(axis=1)
        require_unchanged((np.sum(cost[..., 0], axis=1) + of_nodes, system.array("COSTS", -1)))
        end_slope, end_limits, lagrangian = self._at_ends(system, end_pull)
        mixed = hessian[..., :q, q:], jacobian[..., q:], end_slope, limits[..., q:], end_limits
        return _MixedDerivatives(*mixed, np.sum(slope[..., q:], axis=1) + lagrangian)

    def _at_ends(self, system: KKTSystem, pull: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The derivatives of the slopes of the ends, of the inequalities there, and of the Lagrangian of these."""
        count, both, k = system.sizes.steps, 2 * self.steps.manifold.dimension, self.steps.parameter.size
        if self._ends is None:
            return np.zeros((count, both, k)), np.zeros((count, 0, k)), np.zeros((count, k))
        around = (a for all_nodes in (system.nodes, system.costates) for a in (all_nodes[:-1], all_nodes[1:]))
        at = system.array("CENTRES", count, -1), system.array("ETA", count, -1), *around
        given = system.array("STEP_SIZE", -1, 1), system.array("PARAMETERS", 1, -1), pull
        indices = system.array("NODE_INDICES", count, self.steps.node_costs)
        hessian, slope, *found = self._ends.at(1, *at, *given, indices)
        # Behind both ends, and the cost, which has a slope that the Lagrangian's contains.
        limits = found[2 + self.steps.node_costs] if self.steps.at_nodes else np.zeros((count, 0, both + k))
        return hessian[:, :both, both:], limits[..., both:], slope[:, both:]

    def _ends_of(self, z: Array, *given: Array) -> tuple[Array, tuple[Array, ...]]:
        (*at, parameters, pull, index), both = given, 2 * self.steps.manifold.dimension
        return self.steps._both_of(z[:both], *at, parameters + z[both:], pull, index)

    def _point_of(self, z: Array, *given: Array) -> tuple[Array, ...]:
        *at, parameters, pull = given
        return self.steps._point_of(z[: self.dimension], *at, parameters + z[self.dimension :], pull)[:2]


def mixed_derivatives(steps: StepFunctions, evaluator: Evaluator) -> OneStageDerivatives | CollocationDerivatives:
    """The mixed derivatives of the steps of a method, traced once."""
    if isinstance(steps, OneStageFunctions):
        return OneStageDerivatives(steps, evaluator)
    return CollocationDerivatives(steps, evaluator)
