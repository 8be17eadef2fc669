"""Jumps of the functions of a problem along its solutions, of which no costate tells.

Four kinds of lines are searched (``problem_checks.smoothness.jumps``):

- the polynomials of the steps, in pieces, which a trajectory passes,
- lines through their points at which a margin is nearly zero, along its gradient: the trajectory touches or lies on it,
- such lines through free ends, for the costs and conditions there,
- lines in the controls from some stages, as in the check before a solve, because later solves have other parameters.
"""

from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.tolerances import EPS, HALF
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.point_layout import PointLayout
from ...problem_checks.smoothness.jumps import Jump, JumpSearch, few_of_each, largest, largest_jump
from ...problem_checks.smoothness.problem_jumps import (
    Curves,
    control_jump_words,
    control_lines,
    control_steps,
    rate_names,
    rates,
    search_on_curves,
)
from ...problem_checks.smoothness.step_primitives import find_step_primitives
from ..solution.record import Solution

PIECES_OF_STAGES = 4  # for each stage: in which a margin changes its sign once, or comes near to zero once
STEP_EDGE = 1e-3  # of the first and the last step: an end on a jump is none that is passed
OVERLAP = 1e-5  # of a step: how far its polynomial is followed beyond its nodes, so that a jump at a node is passed
TRAJECTORY_ENDS = 0.1  # of a trajectory, at its beginning and its end, where it may come to an end that is on a jump
CONTROL_STAGES = 64  # from whose controls a jump in the controls is searched for
NEAR_MARGIN = EPS**HALF  # of the largest of what a step compares: nearer margins are at the jump
BESIDE = "beside the trajectory, at"
REACH_RATIO = 4.0  # times what counts as near: how far a line is that has both sides of a jump


@final
class SmoothnessAlongSolution:
    """Searches for jumps of the functions of a problem along its solutions.

    ``timed``: whether jumps in an explicit time count, as they do where the horizon is free and shifts them.
    """

    def __init__(self, problem: OptimalControlProblem, parameters: Any, timed: bool) -> None:
        self.problem, self.timed = problem, timed
        self.state = PointLayout.of(problem.manifold)
        self._coordinates = problem.manifold.dimension + problem.controls.dimension + 1
        bound = problem.with_parameters(parameters)
        q, u = (jax.tree.map(lambda s: np.zeros(s.shape, s.dtype), m.ambient) for m in (bound.manifold, bound.controls))
        given = (q, 0.0) if timed else (q,)
        self.of_states = find_step_primitives(lambda q, t=0.0: rates(bound.at_time(t), q, u), *given)
        self.of_controls = control_steps(bound.at_time(0.0), q, u)
        self.of_ends = [
            find_step_primitives(lambda q, f=f: f(bound.at_time(0.0), q, u, q), q) for f in (_at_start, _at_end)
        ]
        self._searches: dict[Any, JumpSearch] = {}

    def __bool__(self) -> bool:
        """Whether there is a step that may jump."""
        return bool(self.of_states or self.of_controls or any(self.of_ends))

    def __call__(self, solution: Solution, fixed: np.ndarray) -> str:
        """Words on the largest jump; empty if there is none. ``fixed``: 1 for coordinates that an end prescribes, ``(2,
        n)``."""
        if solution.interpolant is None or not self:
            return ""
        words = self._along(solution) if self.of_states else ""
        words = words or (self._in_controls(solution) if self.of_controls else "")
        return words or self._at_ends(solution, fixed)

    def _search(self, function: Any, solution: Solution, given: Any, curves: Curves) -> JumpSearch:
        """The search on such curves, the same object for solutions with one retraction."""
        interpolant: Any = solution.interpolant  # a solution without one is not searched
        retraction = interpolant.retraction
        key = function, curves.ways.shape[1], id(retraction)  # which the search holds
        if key not in self._searches:
            self._searches[key] = search_on_curves(function, self.problem, retraction, given, vec.taken(curves, 0))
        return self._searches[key]

    def _along(self, solution: Solution) -> str:
        """Words on a jump that the trajectory passes, or on which it lies."""
        (curves, ends), given = self._pieces(solution), (solution.parameters, None)
        search = self._search(rates, solution, given, curves)
        found = search.crossings(given, curves, ends)
        seen, sizes = found.ends, largest(found.ends.values)
        passed = largest_jump(search.jumps(found, sizes))
        if passed:
            return self._words_of_rates(passed, given[0], "where the trajectory passes")
        size = largest(seen.sizes)
        points = search.points(seen.points[:, 0])
        after = (points[2] - solution.times[0]) / np.ptp(solution.times)
        inner = (after > TRAJECTORY_ENDS) & (after < 1 - TRAJECTORY_ENDS)
        k, step = few_of_each((np.abs(seen.margins[:, 0]) <= NEAR_MARGIN * size) & inner[:, None])
        # Between two points it comes near to a jump, or passes a window that is narrower.
        touches = (np.abs(found.margins) <= NEAR_MARGIN * size[found.step]) & ~found.compared
        near = vec.joined([vec.taken(points, k), search.points(found.points[touches])])
        step = np.concatenate([step, found.step[touches]])
        beside = self._through(rates, solution, given, near, step, (size, sizes))
        return self._words_of_rates(beside, given[0], BESIDE) if beside else ""

    def _through(
        self, function: Any, solution: Solution, given: Any, points: Any, step: np.ndarray, sizes: Any, free: Any = 1.0
    ) -> Jump | None:
        """The largest jump on lines through points at which the margin of a step is nearly zero, along its gradient.

        ``sizes`` of the steps and of the entries; ``free``: which coordinates move.
        """
        count, n = len(step), self.problem.manifold.dimension
        if not count:
            return None
        moves = np.eye(n, self._coordinates)  # of the state alone
        axes = Curves.straight(vec.taken(points, np.repeat(np.arange(count), n)), np.tile(moves, (count, 1)))
        search = self._search(function, solution, given, axes)
        slopes = search.at(given, axes, np.zeros((count * n, 1))).slopes.reshape(count, n, -1)
        slope = slopes[np.arange(count), :, step] * free
        length = REACH_RATIO * NEAR_MARGIN * np.where(sizes[0] > 0, sizes[0], 1.0)[step][:, None]
        lines = Curves.straight(points, slope / np.sum(slope**2, axis=1, keepdims=True) * length @ moves)
        ends, own = np.tile([-1.0, 1.0], (count, 1)), np.equal(step[:, None], np.arange(slopes.shape[2]))
        return largest_jump(search.jumps(search.crossings(given, lines, ends, own), sizes[1]))

    def _in_controls(self, solution: Solution) -> str:
        """Words on a jump in the controls, searched from the controls of some stages."""
        stages = np.unique(np.linspace(0, len(solution.stage_times) - 1, CONTROL_STAGES).round().astype(int))
        points = vec.taken((solution.stage_states, solution.controls, solution.stage_times), stages)
        lines = control_lines(self.problem, points)
        given, bound = (solution.parameters, None), self.problem.with_parameters(solution.parameters)
        search = self._search(rates, solution, given, lines[0])
        return control_jump_words(bound, search, lines, self.of_controls, given, timed=True)

    def _at_ends(self, solution: Solution, fixed: np.ndarray) -> str:
        """Words on a jump of what is asked of an end, where that is free and on it."""
        for end, (steps, name) in enumerate(zip(self.of_ends, ("initial_cost", "terminal_cost"), strict=True)):
            if not steps or np.all(fixed[end] > 0):
                continue
            function, given = (_at_start, _at_end)[end], (solution.parameters, vec.taken(solution.states, end - 1))
            points = vec.taken((solution.states, solution.controls, solution.times), [-end])
            rest = Curves.straight(points, np.zeros((1, self._coordinates)))
            seen = self._search(function, solution, given, rest).at(given, rest, np.zeros((1, 1)))
            size = seen.sizes[0, 0]
            near = np.flatnonzero(np.abs(seen.margins[0, 0]) <= NEAR_MARGIN * size)
            at = vec.taken(points, np.zeros(len(near), int))
            jump = self._through(function, solution, given, at, near, (size, None), fixed[end] == 0)
            if jump:
                where = f"where the trajectory {('begins', 'ends')[end]}, at"
                return self._words(jump, name if jump.entry == 0 else "boundary_constraints", steps, where)
        return ""

    def _words_of_rates(self, jump: Jump, parameters: Any, where: str) -> str:
        name = rate_names(self.problem.with_parameters(parameters))[jump.entry]
        return self._words(jump, name, self.of_states, where)

    def _words(self, jump: Jump, name: str, steps: list[str], where: str) -> str:
        state, _, time = jump.point
        q = jax.tree.map(lambda a: np.array2string(np.asarray(a), precision=6), state)
        return (
            f"{name} jumps by {jump.change:.3g} {where} q = {_join(q)}"
            f"{f' near t = {float(time):.6g}' if self.timed else ''}: it computes {' and '.join(steps)} from "
            f"{'states and times' if self.timed else 'states'}, and no derivative tells of the jump; expected "
            "functions without jumps along the trajectory, because the costates jump there too, and these do not; try "
            "jnp.tanh(x / a) with a small a instead of a step, or solve_phases, with one phase on each side that ends "
            "where the jump is"
        )

    def _pieces(self, solution: Solution) -> tuple[Curves, np.ndarray]:
        """The polynomials of the steps, one for each piece of a step with the control of its stage, and its ends."""
        steps, count = solution.steps, len(solution.stage_times) // solution.steps
        through, centres, coordinates = solution._between_nodes.states
        ways = np.zeros((steps, len(through), self._coordinates))
        powers = np.linalg.inv(np.vander(through, increasing=True))
        ways[:, :, : coordinates.shape[2]] = np.einsum("jk,ikn->ijn", powers, coordinates)
        ways[:, 1, -1] = np.diff(solution.times)
        places = np.tile(np.linspace(-OVERLAP, 1 + OVERLAP, PIECES_OF_STAGES * count + 1), (steps, 1))
        places[0, 0], places[-1, -1] = STEP_EDGE, 1 - STEP_EDGE
        ends = np.stack([places[:, :-1], places[:, 1:]], axis=2).reshape(-1, 2)
        of_steps = self.state.points(centres), solution.times[:-1], ways
        states, times, ways = vec.taken(of_steps, np.repeat(np.arange(steps), PIECES_OF_STAGES * count))
        controls = vec.taken(solution.controls, np.repeat(np.arange(steps * count), PIECES_OF_STAGES))
        if not self.timed:  # no jump in time is passed
            times, ways[:, 1, -1] = times + ends[:, 0] * ways[:, 1, -1], 0.0
        return Curves(states, controls, times, ways), ends


def _at_start(problem: OptimalControlProblem, q: Ambient, _: Ambient, last: Ambient) -> Array:
    """The conditions on the start, with the last state as it is."""
    return jnp.concatenate([jnp.reshape(problem._start_cost(q), (1,)), problem._boundary.values(q, last)])


def _at_end(problem: OptimalControlProblem, q: Ambient, _: Ambient, first: Ambient) -> Array:
    """The conditions on the end, with the first state as it is."""
    return jnp.concatenate([jnp.reshape(problem.final_cost(q), (1,)), problem._boundary.values(first, q)])


def _join(words: Any) -> str:
    leaves = jax.tree.leaves(words)
    return leaves[0] if len(leaves) == 1 else f"({', '.join(leaves)})"
