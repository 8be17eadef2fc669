"""The steps of Gauss's method: several points in the chart of each step, condensed to its centre and its controls."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ....compute.base import Arrays
from ....compute.binding.problem_functions import FunctionName
from ..transcription.functions.collocation import CollocationFunctions
from ..transcription.iterate import CollocationUnknowns, Data, Slacks
from .arrays import plain
from .condensing import Condensed, Ends, Points, condense, expand, full_slope, slopes
from .extent import OF_POINTS
from .inequalities import Held, raised
from .scaling import Units
from .transcription import Blocks, Moves, Nodes, _of_core, extend, is_kept

FUNCTIONS = (
    FunctionName.ENDS,
    FunctionName.POINTS,
    FunctionName.BOTH_ENDS,
    FunctionName.MOVE,
    FunctionName.MOVE_CONTROLS,
)


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


class Collocation(CollocationFunctions):  # pyright: ignore[reportGeneralTypeIssues]
    """The steps of a Gauss method with at least two points.

    Where there are inequalities at nodes, a step has those of its ends behind those of its points, as of one more
    point, whose unknowns are ``(dx, deta)``: ``eta = h sum_j b_j nu_j``.
    """

    _trial: tuple[int, Any] | None = None
    _ends, _point, _both, _centre, _control = map(_of_core, FUNCTIONS)

    def trial(self, nodes: Nodes, count: int) -> Any:
        """The compiled pass of a trial of one trajectory of so many steps, if there is one; the last one is kept."""
        if self.at_nodes:
            return None
        known = self._trial
        if known is None or not is_kept(known, count):
            from .collocation_trial import CollocationTrial

            known = self._trial = count, CollocationTrial.of(self, nodes, count)
        return known[1]

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

    def _eta(self, unknowns: CollocationUnknowns, data: Data) -> np.ndarray:
        return np.einsum("bk,j,bkja->bka", data.steps, self.tableau.weights, unknowns.velocities)


extend(CollocationFunctions, Collocation)
