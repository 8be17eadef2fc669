"""Jumps along a trajectory: whether it passes one, lies on one, or has controls beside one, of which no costate
tells."""

from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....manifolds import Euclidean
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.tolerances import tolerance
from ....retractions import Retraction
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.point_layout import PointLayout
from ...problem_checks.smoothness.discontinuity_search import (
    DEGREE,
    HIDDEN,
    NEAR_MARGIN,
    DiscontinuitySearch,
    FlatPoint,
    Jump,
    LineFunction,
    Lines,
    few_of_each,
    largest_jump,
    rate_names,
    rates,
)
from ...problem_checks.smoothness.in_controls import control_jump_words, control_lines, find_control_jump
from ...problem_checks.smoothness.kinks import SMALLEST_JUMP
from ...problem_checks.smoothness.step_primitives import find_step_primitives
from ..solution.record import Solution

POINTS_BETWEEN = 4  # for each stage: between which a step changes its sign once, or comes near to it once
STEP_EDGE = 1e-3  # of a step: not where it begins and ends, so that an end on a jump is none that is passed
TRAJECTORY_ENDS = 0.1  # of a trajectory, at its beginning and its end, where it may come to an end that is on a jump
JUMP_STAGES = 64  # from whose controls is looked
CONTROL_REACHES = 4.0 ** np.arange(-6, 2)  # times the largest control: how far, in pieces
REACH_RATIO = 4.0  # times what counts as near: how far a line is that has both sides of a jump


@final
class SmoothnessAlongSolution:
    """Looks for jumps of the functions of a problem along its solutions.

    ``timed``: whether jumps in an explicit time count, as they do where the horizon is free and shifts them.
    """

    def __init__(self, problem: OptimalControlProblem, parameters: Any, timed: bool) -> None:
        self.problem, self.timed = problem, timed
        self.state = PointLayout.of(problem.manifold)
        bound = problem.with_parameters(parameters)
        q, u = (jax.tree.map(lambda s: np.zeros(s.shape, s.dtype), m.ambient) for m in (bound.manifold, bound.controls))
        given = (q, 0.0) if timed else (q,)
        self.of_states = find_step_primitives(lambda q, t=0.0: rates(bound.at_time(t), q, u), *given)
        self.of_controls = find_step_primitives(lambda u: rates(bound.at_time(0.0), q, u), u)
        self._crossings: dict[Any, DiscontinuitySearch] = {}
        self.of_ends = [
            find_step_primitives(lambda q, f=f: f(bound.at_time(0.0), q, u, q), q) for f in (_at_start, _at_end)
        ]

    def __bool__(self) -> bool:
        """Whether there is a step that may jump."""
        return bool(self.of_states or self.of_controls or any(self.of_ends))

    def __call__(self, solution: Solution, fixed: np.ndarray) -> str:
        """Words on the largest jump; empty if there is none. ``fixed``: 1 for coordinates that an end prescribes, ``(2,
        n)``."""
        if solution.interpolant is None or not self:
            return ""
        retraction = solution.interpolant.retraction
        words = self._along(retraction, solution) if self.of_states else ""
        words = words or (self._beside(retraction, solution) if self.of_controls else "")
        return words or (self._at_ends(retraction, solution, fixed) if any(self.of_ends) else "")

    def _traced(self, function: LineFunction, retraction: Retraction, given: FlatPoint) -> DiscontinuitySearch:
        """The search for jumps of a function, the same object for solutions with one retraction."""
        known = self._crossings.get(function)
        if known is None or known.retraction is not retraction:
            known = self._crossings[function] = DiscontinuitySearch(function, self.problem, retraction, given)
        return known

    def _along(self, retraction: Retraction, solution: Solution) -> str:
        """Words on a jump that the trajectory passes, or on which it lies."""
        segments, given = self._segments(solution), (solution.parameters, None)
        if not len(segments.times):
            return ""
        crossings = self._traced(rates, retraction, given)
        seen = crossings.seen(given, segments)
        sizes = self._sizes(seen.values)
        located, step = crossings.located(given, segments, seen)
        jump = largest_jump(crossings.jumps(located, sizes))
        if jump:
            return self._words(jump, self._name(jump, solution), self.of_states, "where the trajectory passes")
        size = np.max(np.where(np.isfinite(seen.sizes), seen.sizes, 0.0), axis=(0, 1), initial=0.0)
        after = (segments.times - solution.times[0]) / np.ptp(solution.times)
        inner = (after > TRAJECTORY_ENDS) & (after < 1 - TRAJECTORY_ENDS)
        k, steps = few_of_each((np.abs(seen.margins[:, 0]) <= NEAR_MARGIN * size) & inner[:, None])
        near = segments[k]
        if located is not None:  # between two points it comes near to a jump, or passes a window that is narrower
            touches = (np.abs(located.margins) <= NEAR_MARGIN * size[step]) & ~located.compared
            steps = np.concatenate([steps, step[touches]])
            near = vec.joined([near, self._resting(*vec.taken(located[:3], touches))])
        jump = self._on(crossings, given, near, steps, (size, sizes))
        where = "beside the trajectory, at"
        return self._words(jump, self._name(jump, solution), self.of_states, where) if jump else ""

    def _name(self, jump: Jump, solution: Solution) -> str:
        """The name of the function that jumps."""
        return rate_names(self.problem.with_parameters(solution.parameters))[jump.entry]

    def _on(
        self,
        crossings: DiscontinuitySearch,
        given: FlatPoint,
        points: Lines,
        step: np.ndarray,
        sizes: tuple[np.ndarray, Any],
        free: Any = 1.0,
    ) -> Jump | None:
        """The largest jump at points that are near to one, looked for on lines that go through it; ``sizes`` of the
        steps."""
        if not len(step):
            return None
        slope = crossings.slopes(given, points)[np.arange(len(step)), step] * free
        with np.errstate(all="ignore"):
            length = REACH_RATIO * NEAR_MARGIN * np.where(sizes[0] > 0, sizes[0], 1.0)[step][:, None]
            ways = slope / np.sum(slope**2, axis=1, keepdims=True) * length
        known = np.flatnonzero(np.all(np.isfinite(ways), axis=1))
        if not len(known):
            return None
        at = points[known]
        lines = Lines.through(at.states, at.controls, at.times, ways[known], 0 * at.turns)
        located, _ = crossings.located(given, lines, crossings.seen(given, lines), step[known])
        return largest_jump(crossings.jumps(located, sizes[1]))

    def _beside(self, retraction: Retraction, solution: Solution) -> str:
        """Words on a jump in the controls, searched from the controls of some stages."""
        count, given = len(solution.stage_times), (solution.parameters, None)
        stages = np.unique(np.linspace(0, count - 1, min(count, JUMP_STAGES)).round().astype(int))
        crossings, reach = self._traced(rates, retraction, given), 1.0
        q = crossings.state.rows(vec.taken(solution.stage_states, stages), 1)
        u = crossings.control.rows(vec.taken(solution.controls, stages), 1)
        if isinstance(self.problem.controls, Euclidean):
            reach = float(np.max(np.abs(u), initial=0.0)) or 1.0
        lines = control_lines(self.problem, q, u, solution.stage_times[stages], reach * CONTROL_REACHES)
        sizes = self._sizes(crossings.seen(given, lines[lines.low == 0]).values[:, :1])
        jump = find_control_jump(crossings, given, lines, sizes)
        bound = self.problem.with_parameters(solution.parameters)
        return control_jump_words(bound, jump, self.of_controls, f" (q as at t = {jump.time:.6g})") if jump else ""

    def _at_ends(self, retraction: Retraction, solution: Solution, fixed: np.ndarray) -> str:
        """Words on a jump of what is asked of an end, where that is free and on it."""
        for end, (steps, name) in enumerate(zip(self.of_ends, ("initial_cost", "terminal_cost"), strict=True)):
            if not steps or np.all(fixed[end] > 0):
                continue
            one, other = (vec.taken(solution.states, [k]) for k in (-end, end - 1))
            u, t = vec.taken((solution.controls, solution.times), [-end])
            given = solution.parameters, vec.taken(other, 0)
            crossings = self._traced((_at_start, _at_end)[end], retraction, given)
            point = self._resting(crossings.state.rows(one, 1), crossings.control.rows(u, 1), t)
            seen = crossings.seen(given, point)
            size = seen.sizes[0, 0]
            near = np.flatnonzero(np.abs(seen.margins[0, 0]) <= NEAR_MARGIN * size)
            jump = self._on(crossings, given, point[np.zeros(len(near), int)], near, (size, None), fixed[end] == 0)
            if jump:
                where = f"where the trajectory {('begins', 'ends')[end]}, at"
                return self._words(jump, name if jump.entry == 0 else "boundary_constraints", steps, where)
        return ""

    def _words(self, jump: Jump, name: str, steps: list[str], where: str) -> str:
        q = jax.tree.map(lambda a: np.array2string(np.asarray(a), precision=6), jump.state)
        return (
            f"{name} jumps by {jump.change:.3g} {where} q = {_join(q)}"
            f"{f' near t = {jump.time:.6g}' if self.timed else ''}: it computes {' and '.join(steps)} from "
            f"{'states and times' if self.timed else 'states'}, and no derivative tells of the jump; expected "
            "functions without jumps along the trajectory, because the costates jump there too, and these do not; try "
            "jnp.tanh(x / a) with a small a in place of a step, or solve_phases, with one phase on each side that ends "
            "where the jump is"
        )

    def _segments(self, solution: Solution) -> Lines:
        """The segments between points of the trajectory where they are known."""
        interpolant: Any = solution.interpolant
        count = POINTS_BETWEEN * len(solution.stage_times) // solution.steps
        found = interpolant.within(solution, np.linspace(STEP_EDGE, 1 - STEP_EDGE, DEGREE * count + 1), costates=False)
        rows, of_controls = self.state.rows(found.states, 2), interpolant.control.rows(found.controls, 2)
        # Within the steps, polynomials through points; from each step to the next one, all points are the last one.
        inner = np.arange(count)[:, None] * DEGREE + np.arange(DEGREE + 1)
        last = np.concatenate([rows[:-1, -1:], *DEGREE * [rows[1:, :1]]], axis=1)
        through = np.concatenate([rows[:, inner].reshape(-1, DEGREE + 1, rows.shape[2]), last])
        places = np.arange(1, DEGREE + 1) / DEGREE
        coordinates = interpolant.chart.coordinates(through[:, :1], through[:, 1:])
        ways = np.einsum("jd,kdn->kjn", np.linalg.inv(places[:, None] ** np.arange(1, DEGREE + 1)), coordinates)
        ways[len(rows) * count :] = coordinates[len(rows) * count :, -1:] * np.eye(DEGREE)[0][:, None]
        begin, end = inner[:, 0], inner[:, -1]
        times = np.concatenate([found.times[:, begin].ravel(), found.times[:-1, -1]])
        ends = np.concatenate([found.times[:, end].ravel(), found.times[1:, 0]])
        u = np.concatenate([of_controls[:, begin].reshape(len(rows) * count, -1), of_controls[:-1, -1]])
        parts = through[:, 0], ways.reshape(len(ways), -1), u
        known = np.all([np.all(np.isfinite(part), axis=1) for part in parts], axis=0)
        spans = ends - times if self.timed else 0 * times
        lines = self._resting(through[:, 0], u, times)
        return lines._replace(ways=ways, spans=spans, low=0 * times)[known]

    def _resting(self, states: np.ndarray, controls: np.ndarray, times: np.ndarray) -> Lines:
        """Lines that stay at points."""
        n, m = self.problem.manifold.dimension, self.problem.controls.dimension
        return Lines.through(states, controls, times, np.zeros((len(times), n)), np.zeros((len(times), m)))

    def _sizes(self, values: np.ndarray) -> np.ndarray:
        """The size of each entry of the functions along the trajectory, at least the rounding in its array."""
        sizes = np.max(np.abs(np.where(np.isfinite(values), values, 0.0)), axis=(0, 1), initial=0.0)
        for place in self.state.places:
            least = HIDDEN / SMALLEST_JUMP * tolerance(values, 1.0) * np.max(sizes[place], initial=0.0)
            sizes[place] = np.maximum(sizes[place], least)
        return sizes


def _at_start(problem: OptimalControlProblem, q: Ambient, _: Ambient, last: Ambient) -> Array:
    """The conditions on the start, with the last state as it is."""
    return jnp.concatenate([jnp.reshape(problem.first_cost(q), (1,)), problem._boundary.values(q, last)])


def _at_end(problem: OptimalControlProblem, q: Ambient, _: Ambient, first: Ambient) -> Array:
    """The conditions on the end, with the first state as it is."""
    return jnp.concatenate([jnp.reshape(problem.final_cost(q), (1,)), problem._boundary.values(first, q)])


def _join(words: Any) -> str:
    leaves = jax.tree.leaves(words)
    return leaves[0] if len(leaves) == 1 else f"({', '.join(leaves)})"
