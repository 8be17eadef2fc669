"""Derivatives of an extremal by its ends, horizon and parameters: its KKT system with one right-hand side for each.

Where ``F(y, theta) = 0`` are the conditions, with the regular Jacobian ``K`` of a solution, ``dy/dtheta = -K^-1
dF/dtheta`` by the implicit function theorem [Fiacco 1976]; and the cost has the derivative ``dL/dtheta`` of the
Lagrangian.
"""

from functools import partial
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.base import Evaluator
from ....manifolds import InvalidInputError
from ....manifolds.numerics import ambient as vec
from ....retractions import default_retraction
from ..transcription.functions.one_stage import OneStageFunctions
from ..transcription.iterate import Data, Iterate
from .augmented import of_lagrangian, solved
from .collocation import Collocation
from .condensing import Condensed, condense
from .conditions import Conditions
from .kkt_system import Assembled
from .transcription import Nodes, OneStage

CHANGED = 1e-9  # relative: more than rounding


class Columns(NamedTuple):
    """Derivatives of the equations of the steps by their lengths and by the parameters, ``K = 1 + P`` columns."""

    slope: np.ndarray  # (B, N, z, K)
    begin: np.ndarray  # (B, N, n, K): of the beginnings, in the frames of the nodes
    end: np.ndarray
    lagrangian: np.ndarray  # (B, N, K)


class Derivatives(NamedTuple):
    """Derivatives in K columns: by the coordinates of the start, of the end, by the horizon, and by the parameters."""

    cost: np.ndarray  # (B, K)
    states: np.ndarray  # (B, K, N + 1, E)
    costates: np.ndarray
    controls: np.ndarray  # (B, K, N s, U)
    smallest: np.ndarray  # (B,), pivot of the elimination


class _EndCost(NamedTuple):
    """Of the cost of an end: its curvature, (B, n, n), and the derivatives by horizon and parameters of its slope, (B,
    n, K), and value, (B, K)."""

    held: np.ndarray
    mixed: np.ndarray
    slope: np.ndarray


@final
class Sensitivities:
    """The derivatives of extremals of one problem and method, traced once."""

    def __init__(self, steps: OneStage | Collocation, nodes: Nodes, evaluator: Evaluator) -> None:
        self.steps, self.nodes = steps, nodes
        self.columns = (
            _OneStageColumns(steps, evaluator)
            if isinstance(steps, OneStageFunctions)
            else _CollocationColumns(steps, evaluator)
        )
        n, e, k = nodes.problem.manifold.dimension, nodes.layout.size, nodes.parameter.size
        m, u = nodes.problem.controls.dimension, nodes.control.size
        costs = {"first_cost": nodes.problem.initial_cost, "final_cost": nodes.problem.terminal_cost}
        made = (
            None if cost is None else evaluator.derivatives(partial(self._cost_of, name), n + k, e, k)
            for name, cost in costs.items()
        )
        self._paid = tuple(made)
        self._turned = evaluator.values(self._turned_of, u, m)
        self._carried = evaluator.values(self._carried_of, e, e, e, e)

    def __call__(self, conditions: Conditions, iterate: Iterate, assembled: Assembled) -> Derivatives:
        """The derivatives of the extremals ``iterate`` whose KKT systems are ``assembled``."""
        data, n = conditions.data, self.nodes.problem.manifold.dimension
        blocks = of_lagrangian(conditions, iterate, assembled)
        own = self.columns(iterate, assembled._replace(blocks=blocks), conditions)
        fractions = data.steps / np.sum(data.steps, axis=1)[:, None]
        share = np.concatenate([fractions[:, :, None], np.ones((*data.steps.shape, data.parameters.shape[1]))], axis=2)
        own = Columns(*(a * (share if a.ndim == 3 else share[:, :, None]) for a in own))
        first, last = self._of_ends(assembled, data.parameters)
        z = blocks.hessian.shape[3]
        own.slope[:, -1, :z] += blocks.right[:, -1].mT @ (last.held @ own.end[:, -1] + last.mixed)
        own.slope[:, 0, :z] += blocks.left[:, 0].mT @ (first.held @ own.begin[:, 0] + first.mixed)
        gap = np.zeros((*assembled.gap.shape, 2 * n + share.shape[2]))
        gap[:, :-1, :, 2 * n :] += own.begin
        gap[:, 1:, :, 2 * n :] -= own.end
        gap[:, 0, :, :n] -= np.diag(conditions.ends.start_coordinates)
        gap[:, -1, :, n : 2 * n] += np.diag(conditions.ends.end_coordinates)
        before = np.zeros((*own.slope.shape[:3], 2 * n))
        found = solved(conditions, iterate, blocks, np.concatenate([before, own.slope], axis=3), gap)
        steps, multipliers = found.steps[:, :, :z], found.multipliers
        moved = self._moved(blocks, own, steps)
        turned = np.array(multipliers)
        turned[:, -1] -= last.held @ moved[:, -1]
        turned[:, -1, :, 2 * n :] -= last.mixed
        turned[:, 0] += first.held @ moved[:, 0]
        turned[:, 0, :, 2 * n :] += first.mixed
        lagrangian = np.sum(own.lagrangian, axis=1) + last.slope + first.slope
        ends = assembled.coordinates[:, 0], assembled.coordinates[:, -1]
        cost = np.concatenate([-ends[0], ends[1], lagrangian], axis=1)
        return Derivatives(
            cost, *self._ambient(assembled, moved, turned), self._of_controls(iterate, steps), found.smallest
        )

    def _moved(self, blocks: Any, own: Columns, steps: np.ndarray) -> np.ndarray:
        """Displacements of the nodes in their frames, shape (B, N + 1, n, K)."""
        begin, end = blocks.left @ steps, (blocks.right[:, -1] @ steps[:, -1])[:, None]
        begin[..., -own.begin.shape[3] :] += own.begin
        end[..., -own.end.shape[3] :] += own.end[:, -1:]
        return np.concatenate([begin, end], axis=1)

    def _of_ends(self, assembled: Assembled, parameters: np.ndarray) -> list["_EndCost"]:
        """The derivatives of the costs of the first and of the last node."""
        n, batch, found = self.nodes.problem.manifold.dimension, len(parameters), list[_EndCost]()
        columns = 1 + parameters.shape[1]
        for function, place, paid in zip(self._paid, (0, -1), assembled.paid, strict=True):
            if function is None or paid is None:
                shapes = (batch, n, n), (batch, n, columns), (batch, columns)
                found.append(_EndCost(*map(np.zeros, shapes)))
                continue
            hessian, gradient, *_ = function.at(1, assembled.nodes[:, place], parameters)
            _require_unchanged((hessian[:, :n, :n], paid.curvature), (gradient[:, :n], paid.slope))
            rows, none = hessian[:, :n, n:], np.zeros((batch, 1))
            mixed = np.concatenate([np.zeros((batch, n, 1)), rows], axis=2)
            found.append(_EndCost(paid.curvature, mixed, np.concatenate([none, gradient[:, n:]], axis=1)))
        return found

    def _ambient(self, assembled: Assembled, moved: np.ndarray, turned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of states and costates in the ambient space; a covector stays one as its node moves."""
        vectors, covectors = (np.einsum("bknj,bkne->bkje", a, assembled.frames) for a in (moved, turned))
        at = assembled.nodes[:, :, None], assembled.costates[:, :, None], vectors, covectors
        (carried,) = self._carried.at(3, *at)
        return np.moveaxis(vectors, 2, 1), np.moveaxis(carried, 2, 1)

    def _of_controls(self, iterate: Iterate, steps: np.ndarray) -> np.ndarray:
        u = iterate.unknowns.controls
        n, columns = self.nodes.problem.manifold.dimension, steps.shape[3]
        turns = steps[:, :, n:].reshape(*u.shape[:3], self.nodes.problem.controls.dimension, columns)
        (found,) = self._turned.at(4, u[:, :, :, None], np.moveaxis(turns, 4, 3))
        return np.moveaxis(found, 3, 1).reshape(len(u), columns, u.shape[1] * u.shape[2], u.shape[3])

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
    """Of the steps of a discretization map: mixed derivatives of what a step is."""

    def __init__(self, steps: OneStage, evaluator: Evaluator) -> None:
        self.steps = steps
        e, u, k = steps.state.size, steps.control.size, steps.parameter.size
        self._row = evaluator.derivatives(
            self._row_of, steps.dimension + 1 + k, e, u, e, e, e, e, 1, k, steps.inequalities
        )

    def __call__(self, iterate: Iterate, assembled: Assembled, conditions: Conditions) -> Columns:
        data, (x, u), z = conditions.data, iterate.unknowns, self.steps.dimension
        nodes, costates = assembled.nodes, assembled.costates
        around = nodes[:, :-1], nodes[:, 1:], costates[:, :-1], costates[:, 1:]
        blocks, slacks = assembled.blocks, iterate.slacks
        none = np.zeros((*data.steps.shape, self.steps.inequalities))
        pull = none if slacks is None else slacks.multipliers[:, :, 0]
        given = data.steps[:, :, None], data.parameters[:, None], pull
        found = self._row.at(2, x, u[:, :, 0], *around, *given)
        hessian, gradient, left, right, _, limits, _, _, cost, _ = found
        _require_unchanged((cost[:, :, 0], blocks.costs), (left[..., :z], blocks.left))
        own, mixed = hessian[:, :, :z, :z], hessian[:, :, :z, z:]
        first, last = (int(paid is not None) for paid in assembled.paid)
        free = slice(first, own.shape[1] - last)  # the steps at the ends have the costs of these too
        _require_unchanged((own[:, free], blocks.hessian[:, free]))
        return Columns(
            np.concatenate([mixed, limits[..., z:]], axis=2), left[..., z:], right[..., z:], gradient[:, :, z:]
        )

    def _row_of(self, d: Array, *given: Array) -> tuple[Array, tuple[Array, ...]]:
        z, (*at, h, parameters, pull) = self.steps.dimension, given
        return self.steps._row_of(d[:z], *at, h + d[z : z + 1], parameters + d[z + 1 :], pull)


class _AtEnds(NamedTuple):
    """Derivatives by the parameters, of the slope of the Lagrangian of the ends of steps, (B, N, 2 n, P), and of that
    itself, (B, N, P); and of the inequalities there by the lengths of the steps and the parameters, (B, N, c, 1 +
    P)."""

    mixed: np.ndarray
    slope: np.ndarray
    limits: np.ndarray


@final
class _CollocationColumns:
    """Of the steps of a Gauss method: its points' mixed derivatives by the parameters; the length of a step enters
    linearly."""

    def __init__(self, steps: Collocation, evaluator: Evaluator) -> None:
        self.steps = steps
        e, u, k, n = steps.state.size, steps.control.size, steps.parameter.size, steps.manifold.dimension
        self.dimension = 3 * n + steps.controls.dimension
        self._point = evaluator.derivatives(self._point_of, self.dimension + k, e, n, n, u, e, 1, k, steps.own)
        at_ends = e, n, e, e, e, e, 1, k, steps.at_nodes
        self._ends = evaluator.derivatives(self._ends_of, 2 * n + k, *at_ends) if steps.at_nodes else None

    def __call__(self, iterate: Iterate, assembled: Assembled, conditions: Conditions) -> Columns:
        data, unknowns, inner = conditions.data, iterate.unknowns, assembled.blocks.inner
        n, q, table = self.steps.manifold.dimension, self.dimension, self.steps.tableau
        h = data.steps
        turned = np.einsum("ij,bkja->bkia", table.matrix, unknowns.velocities)  # derivative of xi by h
        weights = (h[:, :, None] * table.weights)[..., None]
        at = unknowns.centres[:, :, None], h[:, :, None, None] * turned, unknowns.velocities, unknowns.controls
        slacks = iterate.slacks
        none = np.zeros((*weights.shape[:3], self.steps.own))
        pull = none if slacks is None else slacks.multipliers[:, :, : self.steps.stages, : self.steps.own]
        found = self._point.at(3, *at, unknowns.costates, weights, data.parameters[:, None, None], pull)
        hessian, gradient, constraints, _, limits, defect, cost, _ = found
        _require_unchanged(
            (hessian[..., :q, :q], inner.points.hessian), (constraints[..., :q], inner.points.constraints)
        )
        _require_unchanged((np.sum(cost[..., 0], axis=2), assembled.blocks.costs))
        far = np.einsum("j,bkja->bka", table.weights, unknowns.velocities)  # derivative of eta by h
        points, ends = inner.points, inner.ends
        slope, end_slope, each = gradient[..., :q], ends.slope[..., 0], h[:, :, None, None]
        # The Lagrangian of a point is its weight h b_i times a function; and xi = h matrix nu, eta = h weights nu.
        by_h = np.einsum("bkizy,bkiy->bkiz", hessian[..., :q, n : 2 * n], turned) + slope / each
        by_h[..., 2 * n : 3 * n] += np.einsum("ij,bkia->bkja", table.matrix, slope[..., n : 2 * n])
        by_h[..., 2 * n : 3 * n] += table.weights[:, None] * end_slope[:, :, None, n:]
        missed = np.einsum("bkiny,bkiy->bkin", constraints[..., n : 2 * n], turned) + defect / each
        lagrangian = np.sum(gradient[..., n : 2 * n] * turned, axis=3) + cost[..., 0] / h[:, :, None]
        lagrangian = np.sum(lagrangian, axis=2) + np.sum(end_slope[..., n:] * far, axis=2)
        wanted = points._replace(
            slope=np.concatenate([by_h[..., None], hessian[..., :q, q:]], axis=4),
            defect=np.concatenate([missed[..., None], constraints[..., q:]], axis=4),
        )
        at_ends = self._at_ends(iterate, assembled, data, far)
        outer = np.einsum("bkzy,bky->bkz", ends.hessian[..., n:], far)[..., None]
        outer = np.concatenate([outer, at_ends.mixed], axis=3)
        parts, condensed = condense(wanted, ends._replace(slope=outer), h, table)
        begin, finish = parts.before, parts.after
        begin[..., 0] += np.einsum("bkny,bky->bkn", ends.left[..., n:], far)
        finish[..., 0] += np.einsum("bkny,bky->bkn", ends.right[..., n:], far)
        by_parameters = np.sum(gradient[..., q:], axis=2) + at_ends.slope
        whole, rows = np.concatenate([lagrangian[..., None], by_parameters], axis=2), parts.slope
        if slacks is not None:
            direct = np.einsum("bkicy,bkiy->bkic", limits[..., n : 2 * n], turned)[..., None]
            direct = np.concatenate([direct, limits[..., q:]], axis=4)
            rows = np.concatenate([rows, self._limits(assembled, condensed, direct, at_ends.limits)], axis=2)
        return Columns(rows, begin, finish, whole)

    def _limits(self, assembled: Assembled, condensed: Condensed, own: np.ndarray, at_ends: np.ndarray) -> np.ndarray:
        """Derivatives of the inequalities of all points and ends, shape (B, N, r c, K), from those of each alone."""
        steps, (batch, count, stages, rows, columns) = self.steps, own.shape
        direct = np.zeros((batch, count, steps.places, steps.inequalities, columns))
        direct[:, :, :stages, :rows] = own
        if steps.at_nodes:
            direct[:, :, stages, rows:] = at_ends
        maps = condensed.kept[2].reshape(batch, count, *condensed.kept[2].shape[1:])
        mended = steps.limits(assembled.blocks, condensed.table[0].reshape(batch, count), maps)
        return direct.reshape(batch, count, -1, columns) + mended[..., steps.dimension : steps.dimension + columns]

    def _at_ends(self, iterate: Iterate, assembled: Assembled, data: Data, far: np.ndarray) -> "_AtEnds":
        """What the inequalities at nodes add; ``far``: the derivative of ``eta`` by the length of a step."""
        shape, n, k, c = data.steps.shape, self.steps.manifold.dimension, data.parameters.shape[1], self.steps.at_nodes
        if self._ends is None or iterate.slacks is None:
            return _AtEnds(*map(np.zeros, ((*shape, 2 * n, k), (*shape, k), (*shape, c, 1 + k))))
        nodes, costates, unknowns = assembled.nodes, assembled.costates, iterate.unknowns
        around = nodes[:, :-1], nodes[:, 1:], costates[:, :-1], costates[:, 1:]
        pull = iterate.slacks.multipliers[:, :, -1, self.steps.own :]
        eta = data.steps[:, :, None] * far
        given = data.steps[:, :, None], data.parameters[:, None], pull
        hessian, slope, _, _, limits, *_ = self._ends.at(2, unknowns.centres, eta, *around, *given)
        by_h = np.einsum("bkcy,bky->bkc", limits[..., n : 2 * n], far)[..., None]
        rows = np.concatenate([by_h, limits[..., 2 * n :]], axis=3)
        return _AtEnds(hessian[..., : 2 * n, 2 * n :], slope[..., 2 * n :], rows)

    def _ends_of(self, z: Array, *given: Array) -> tuple[Array, tuple[Array, ...]]:
        (*at, parameters, pull), both = given, 2 * self.steps.manifold.dimension
        return self.steps._both_of(z[:both], *at, parameters + z[both:], pull)

    def _point_of(self, z: Array, *given: Array) -> tuple[Array, ...]:
        *at, parameters, pull = given
        return self.steps._point_of(z[: self.dimension], *at, parameters + z[self.dimension :], pull)[:2]
