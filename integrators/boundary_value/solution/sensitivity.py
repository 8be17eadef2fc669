"""Derivatives of an extremal with respect to its ends, horizon and parameters.

Where ``F(y, theta) = 0`` are the first-order conditions, with the regular Jacobian ``K`` of a solution, the implicit
function theorem gives ``dy/dtheta = -K^-1 dF/dtheta`` [Fiacco 1976]. The cost has the derivative ``dL/dtheta`` of the
Lagrangian.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.base import Evaluator
from ....manifolds import ConvergenceError
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.tolerances import EPS
from ....retractions import default_retraction
from ...problem.point_layout import PointLayout
from ...reporting.records import shapes
from ..transcription.functions.mixed_derivatives import Columns, StepFunctions, mixed_derivatives, require_unchanged
from ..transcription.functions.nodes import NodeFunctions
from ..transcription.kkt_system import KKTSystem
from .record import Solution

CLEAR = 1e7 * EPS  # a smaller pivot, with rows scaled to size one, leaves less than six digits of a derivative


class Derivatives(NamedTuple):
    """Derivatives in K columns: by the coordinates of the start, of the end, by the horizon, and by the parameters."""

    cost: np.ndarray  # (K,)
    states: np.ndarray  # (K, N + 1, E)
    costates: np.ndarray
    controls: np.ndarray  # (K, N s, U)
    smallest: float  # pivot of the elimination


@final
@dataclass(frozen=True, eq=False)
class Derivative:
    """The derivative of an extremal with respect to a number, or to an array, whose axes lead.

    Attributes
    ----------
    cost : float or array
        The derivative of the cost.
    states, costates : array, or tuple of arrays
        Tangent vectors of the ambient space at the nodes, on the axis behind the leading axes.
    controls : array, or tuple of arrays
        The derivatives at the stages.
    """

    cost: Any
    states: Any
    costates: Any
    controls: Any

    def __repr__(self) -> str:
        return f"Derivative({', '.join(f'{name}={shapes(value)}' for name, value in vars(self).items())})"


@final
@dataclass(frozen=True, eq=False)
class Sensitivity:
    """The derivatives of an extremal with respect to its ends, horizon and parameters.

    Attributes
    ----------
    start, end : Derivative
        With respect to the coordinates of the ends in ``manifold.basis(start)`` and ``manifold.basis(end)``, leading
        axis ``n``; zero for free ends.
    horizon : Derivative or None
        With respect to the horizon, with proportional steps; None if it is free.
    parameters : pytree of Derivative, or None
        One ``Derivative`` for each array of the parameters; None if there are none, or one is free.

    Notes
    -----
    :math:`dy = -K^{-1} dF` with the KKT system :math:`F(y) = 0` of the extremal. The derivative of the cost is the
    derivative of the Lagrangian (envelope theorem): ``start.cost`` is :math:`-p_0` in coordinates.
    """

    start: Derivative
    end: Derivative
    horizon: Derivative | Any
    parameters: Any

    @classmethod
    def of(cls, found: Derivatives, layouts: tuple[PointLayout, PointLayout], n: int, parameters: Any) -> "Sensitivity":
        """The record from the columns of one extremal.

        Parameters
        ----------
        found, layouts, n, parameters : Derivatives, pair of PointLayout, int, pytree
            The columns, the free entries of both ends, the dimension, and the parameters.
        """
        state, control = layouts

        def part(begin: int, shape: tuple[int, ...]) -> Derivative:
            places = slice(begin, begin + int(np.prod(shape)))
            cost, *rows = (a[places].reshape((*shape, *a.shape[1:])) for a in found[:4])
            return Derivative(cost, state.points(rows[0]), state.points(rows[1]), control.points(rows[2]))

        leaves, structure = jax.tree.flatten(parameters)
        begins = 2 * n + 1 + np.cumsum([0, *(np.size(leaf) for leaf in leaves)])
        by_leaves = [part(int(k), np.shape(leaf)) for k, leaf in zip(begins, leaves, strict=False)]
        by_parameters = jax.tree.unflatten(structure, by_leaves) if leaves else None
        return cls(part(0, (n,)), part(n, (n,)), part(2 * n, ()), by_parameters)


class _EndCost(NamedTuple):
    """Derivatives of the cost of an end."""

    curvature: np.ndarray  # second derivatives by the state, (n, n)
    mixed: np.ndarray  # derivatives of the slope with respect to horizon and parameters, (n, K)
    value: np.ndarray  # derivatives of the cost with respect to horizon and parameters, (K,)


@final
class ParametricSensitivity:
    """The derivatives of extremals of one problem and method, traced once."""

    def __init__(self, steps: StepFunctions, nodes: NodeFunctions, evaluator: Evaluator) -> None:
        self.nodes, self.columns = nodes, mixed_derivatives(steps, evaluator)
        n, e, k = nodes.problem.manifold.dimension, nodes.layout.size, nodes.parameter.size
        m, u = nodes.problem.controls.dimension, nodes.control.size
        problem = nodes.problem
        costs = {"_start_cost": problem._starts_with_cost, "final_cost": problem.terminal_cost is not None}
        self._paid = [
            evaluator.derivatives(partial(self._cost_of, name), n + k, e, k) if costs_something else None
            for name, costs_something in costs.items()
        ]
        self._control_change = evaluator.values(self._control_change_of, u, m)
        self._costate_change = evaluator.values(self._costate_change_of, e, e, e, e)

    def __call__(self, system: KKTSystem) -> Derivatives:
        """The derivatives of the extremal with this KKT matrix."""
        n, z, columns = self.nodes.problem.manifold.dimension, system.dimension, self.columns(system)
        steps, k = system.array("STEP_SIZE", -1), columns.lagrangian.shape[1]
        share = np.ones((len(steps), k))
        share[:, 0] = steps / np.sum(steps)
        columns = Columns(*(a * (share if a.ndim == 2 else share[:, None]) for a in columns))
        first, last = (self._of_end(system, place) for place in (0, -1))
        columns.slope[-1, :z] += system.right[-1].T @ (last.curvature @ columns.end[-1] + last.mixed)
        columns.slope[0, :z] += system.left[0].T @ (first.curvature @ columns.begin[0] + first.mixed)
        defect = np.zeros((len(steps) + 1, n, 2 * n + k))
        defect[:-1, :, 2 * n :] += columns.begin
        defect[1:, :, 2 * n :] -= columns.end
        prescribed = np.zeros((2, n, 2 * n + k))
        prescribed[0, :, :n], prescribed[1, :, n : 2 * n] = map(np.diag, system.fixed)
        defect[0] -= prescribed[0]
        defect[-1] += prescribed[1]
        response = system.solve(
            np.concatenate([np.zeros((*columns.slope.shape[:2], 2 * n)), columns.slope], axis=2), defect
        )
        moves, turned = response.step[:, :z], response.multipliers
        moved = np.concatenate([system.left @ moves, (system.right[-1] @ moves[-1])[None]])
        moved[..., 2 * n :] += np.concatenate([columns.begin, columns.end[-1:]])
        moved[[0, -1]] = np.where(system.fixed[..., None] > 0, prescribed, moved[[0, -1]])
        turned[-1] -= last.curvature @ moved[-1]
        turned[-1, :, 2 * n :] -= last.mixed
        turned[0] += first.curvature @ moved[0]
        turned[0, :, 2 * n :] += first.mixed
        lagrangian = np.sum(columns.lagrangian, axis=0) + last.value + first.value
        cost = np.concatenate([-system.multipliers[0], system.multipliers[-1], lagrangian])
        return Derivatives(
            cost, *self._ambient(system, moved, turned), self._of_controls(system, moves), response.smallest
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
        require_unchanged((hessian[:n, :n], curvature), (gradient[:n], slope))
        mixed[:, 1:], value[1:] = hessian[:n, n:], gradient[n:]
        return _EndCost(curvature, mixed, value)

    def _ambient(self, system: KKTSystem, moved: np.ndarray, turned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of states and costates in the ambient space; a covector stays one as its node moves."""
        vectors, covectors = (np.einsum("knj,kne->kje", a, system.frames) for a in (moved, turned))
        (carried,) = self._costate_change.at(2, system.nodes[:, None], system.costates[:, None], vectors, covectors)
        return np.moveaxis(vectors, 1, 0), np.moveaxis(carried, 1, 0)

    def _of_controls(self, system: KKTSystem, moves: np.ndarray) -> np.ndarray:
        sizes, (count, _, columns) = system.sizes, moves.shape
        turns = moves[:, sizes.state_size :].reshape(count, sizes.points, sizes.control_size, columns)
        u = system.array("CONTROLS", count, sizes.points, 1, sizes.control_numbers)
        (found,) = self._control_change.at(3, u, np.moveaxis(turns, 3, 2))
        return np.moveaxis(found, 2, 0).reshape(columns, count * sizes.points, sizes.control_numbers)

    def _cost_of(self, name: str, d: Array, q: Array, parameters: Array) -> tuple[Array, Array]:
        n, point = self.nodes.problem.manifold.dimension, self.nodes.layout.point(q)
        bound = self.nodes.problem.with_parameters(self.nodes.parameter.point(parameters + d[n:]))
        return getattr(bound, name)(vec.add(point, vec.combine(bound.manifold.basis(point), d[:n]))), jnp.zeros(0)

    def _control_change_of(self, u: Array, du: Array) -> tuple[Array]:
        point, turn = self.nodes.control.point(u), default_retraction(self.nodes.problem.controls)
        frame = turn.frame(point)
        return (
            jax.jvp(lambda d: self.nodes.control.flat(turn.chart(point, frame, d)), (jnp.zeros_like(du),), (du,))[1],
        )

    def _costate_change_of(self, *given: Array) -> tuple[Array]:
        manifold, layout = self.nodes.problem.manifold, self.nodes.layout
        q, p, dq, dp = map(layout.point, given)
        return (layout.flat(jax.jvp(manifold.projection, (q, p), (dq, dp))[1]),)


def require_isolated(found: Derivatives, solution: Solution) -> None:
    """Raise if the KKT system is singular to rounding, or a derivative is not finite."""
    if not found.smallest > CLEAR:
        raise ConvergenceError(
            "the system of optimality conditions is singular to rounding, its smallest pivot is "
            f"{found.smallest:.3g}: the extremal is one of a family, or its end is conjugate to its start, and it has "
            "no derivatives; try another horizon",
            solution,
        )
    lost = {_name_of(k, found, solution) for part in found[:4] for k in np.argwhere(~np.isfinite(part))[:, 0]}
    if lost:
        raise ConvergenceError(
            f"the problem's functions have no finite derivative by {' and '.join(sorted(lost))} along this extremal; "
            "try functions that are smooth there, as sqrt(x @ x + 1e-6) instead of a norm",
            solution,
        )


def _name_of(column: int, found: Derivatives, solution: Solution) -> str:
    """The name of the variable of the derivatives in a column."""
    first = len(found.cost) - sum(np.size(leaf) for leaf in jax.tree.leaves(solution.parameters))
    if column >= first - 1:
        return "its parameters" if column >= first else "its horizon"
    return "its start" if column < (first - 1) // 2 else "its end"
