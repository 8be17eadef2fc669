"""Whether the constraints that hold a trajectory determine their multipliers: their derivatives there are
independent."""

from functools import cached_property
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.automatic import AutomaticEvaluator
from ....compute.base import PointwiseFunction
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.tolerances import ACTIVE, EPS, HALF
from ...problem.boundary_conditions import boundary_words
from ...problem.initial_controls import resting_control, within_bounds
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.path_constraints import entry_words
from ...problem.point_layout import PointLayout, parameter_layout
from ...problem_checks.inspection import probes
from ..inputs.inputs import Inputs
from ..solution.diagnostics import RegularChecks
from ..solution.record import Solution

FELT_CHANGE = (
    1e-6  # of the Hamiltonian: multipliers times what their entries may vary by, of less no multiplier matters
)
FLAT_ROW = EPS**0.25  # of the largest derivative along the trajectory
NEGLIGIBLE_VIOLATION = EPS**HALF  # of the largest value: an end that violates a constraint by less is on it
STATE_ROUNDING = 16 * EPS  # of what its states change it by from zero: rounding
FLAT_BEND = EPS**0.3  # of what the second derivative changes it by along the trajectory: a derivative that is smaller
FLAT_POWER = (
    0.25  # of the derivative squared, ``g g''``: ``max(x, 0)^p`` has ``1 - 1 / p``, and one with a slope nothing
)
MULTIPLIERS_TELL = 1e-3  # relative: of a trajectory that lacks more, they are those of no extremal
SLIGHT = 1e-2  # relative: far beyond a limit its slope may vanish, as in the middle of an obstacle
LEAVE_OUT = "leave out what follows from the others"
DEPENDENT_GRADIENTS = EPS**HALF  # smallest singular value of rows of length one


@final
class ConstraintQualification:
    """Looks at the derivatives of the inequalities of a problem along its solutions, at the stages or at the nodes;
    traced once."""

    def __init__(self, problem: OptimalControlProblem, parameters: Any, at_nodes: bool) -> None:
        self.problem, self.parameter, self.at_nodes = problem, parameter_layout(parameters), at_nodes
        self.state, self.control = PointLayout.of(problem.manifold), PointLayout.of(problem.controls)

    def __call__(self, solution: Solution) -> str:
        """A sentence on inequalities whose multipliers are not determined where they hold the trajectory; empty if all
        are."""
        *rows, times, given = self._along(solution)
        values, slopes = self._limits(*rows, times, given)
        nu, counted = self._multipliers(solution)
        if not (nu.size and np.all(np.isfinite(slopes)) and nu.shape == values.shape):
            return ""
        near = isinstance(solution.checks, RegularChecks) and solution.checks.violation <= SLIGHT
        extent, size = np.concatenate([np.ptp(part, axis=0) for part in rows]), solution.checks.hamiltonian_size
        lengths, bends = self._bends(*rows, times, extent[None], given)
        reach = np.max(lengths, axis=0)
        held = counted & (nu * reach**2 > size * np.abs(values))  # else the barrier leaves a multiplier all the same
        pulling = held & (nu > ACTIVE * np.max(nu, axis=0)) & self._nearer(values)
        flat = pulling & (np.max(nu * lengths, axis=0) > FELT_CHANGE * size) & _is_flat(near * values, lengths, bends)
        # What holds a trajectory everywhere does not vary along it.
        varies = np.maximum(np.ptp(values, axis=0), reach)
        active = pulling & (np.max(nu, axis=0) * varies > FELT_CHANGE * size)
        # Coordinates in units of what they change the inequalities by most, so that none has a unit.
        units = np.maximum(np.max(np.abs(slopes), axis=(0, 1)), np.finfo(float).tiny)
        slopes = slopes / units
        lengths = np.linalg.norm(slopes, axis=2)
        flat |= active & (lengths < FLAT_ROW * np.max(lengths, axis=0))
        names = self._names(solution.parameters)
        if np.any(flat) and (solution.success or _is_nearly_met(solution)):
            k, i = np.argwhere(flat)[0]
            place = f"near t = {times[k, 0]:.6g}"
            return (
                f"The derivative of {names[i]} vanishes where it holds the trajectory, {place}, and no multiplier can "
                "hold it there: it may be passed by far more than the tolerance, and no strict minimum is shown; try a "
                "function that passes through zero with a slope, as q[0] - a instead of its square or cube."
            )
        rows = slopes / np.where(lengths > 0, lengths, 1.0)[:, :, None]
        return self._dependent(solution, times[:, 0], (active, rows, names), units)

    def _along(self, solution: Solution) -> tuple[np.ndarray, ...]:
        """States, controls and times where the inequalities hold, and the parameters."""
        states, times = (
            (solution.states, solution.times) if self.at_nodes else (solution.stage_states, solution.stage_times)
        )
        controls = np.asarray(self.control.rows(solution.controls, 1))
        if self.at_nodes:  # nothing depends on these
            controls = controls[np.clip(np.arange(len(times)), 0, len(controls) - 1)]
        return np.asarray(self.state.rows(states, 1)), controls, times[:, None], self._flat_parameters(solution)

    def _flat_parameters(self, solution: Solution) -> np.ndarray:
        """The parameters in a row."""
        return self.parameter.rows(solution.parameters, 0)[None]

    def _names(self, parameters: Any) -> tuple[str, ...]:
        bound = self.problem.with_parameters(parameters).at_time(0.0)
        return entry_words(bound._node_sizes) if self.at_nodes else bound._inequality_names

    def at_ends(self, solution: Solution, fixed: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
        """Names of the inequalities, and by how much both ends violate inequalities that depend on nothing free, ``(2,
        k)``.

        ``fixed``: which coordinates of both ends are prescribed, shape ``(2, n)``; the controls are free.
        """
        places, (*rows, times, given) = [0, -1], self._along(solution)
        ends = self.state.rows(solution.states, 1)[places], rows[1][places], solution.times[places][:, None]
        return self._names(solution.parameters), self._excess(ends, (*rows, times), given, fixed)

    def is_violated(self, inputs: Inputs, fixed: np.ndarray) -> bool:
        """Whether an end violates an inequality that depends on nothing free, at a few random controls."""
        controls, start, problem = self.problem.controls, inputs.given.start_time, self.problem
        resting = within_bounds(problem._limits, resting_control(controls))
        random = [problem._steer(resting, move) for move in probes(problem, resting)[0]]
        u = np.stack([self.control.rows(control, 0) for control in random])
        q = np.concatenate([inputs.ends.start, inputs.ends.end])
        times = np.array([[start], [start + inputs.horizons[0]]])
        along = np.repeat(q, len(u), axis=0), np.tile(u, (2, 1)), np.repeat(times, len(u), axis=0)
        return bool(np.any(self._excess((q, u[:2], times), along, inputs.rows, fixed)))

    def _excess(
        self, ends: tuple[np.ndarray, ...], along: tuple[np.ndarray, ...], given: np.ndarray, fixed: np.ndarray
    ) -> np.ndarray:
        """By how much both ends violate inequalities that depend on nothing free, compared with points along a
        trajectory; states, controls and times."""
        values, slopes = self._limits(*along, given)
        at_ends, end_slopes = self._limits(*ends, given)
        depends = np.any(np.concatenate([slopes, end_slopes]) != 0, axis=0)
        free = np.concatenate([~fixed, np.ones((2, self.problem.controls.dimension), bool)], axis=1)
        held = ~np.any(depends & free[:, None], axis=2)
        reach = np.concatenate([np.max(np.abs(part), axis=0) for part in along[:2]])
        changes, _ = self._bends(*ends, reach[None], given)
        size, changed = np.max(np.abs(np.concatenate([values, at_ends])), axis=0), np.max(changes, axis=0)
        rounding = np.maximum(NEGLIGIBLE_VIOLATION * size, STATE_ROUNDING * changed)
        return np.where(held & (at_ends > rounding), at_ends, 0.0)

    def _nearer(self, values: np.ndarray) -> np.ndarray:
        """Whether each inequality may hold the trajectory: of two bounds of a control, which are apart, only the nearer
        bound.

        Where the iteration has ended without success both may have large multipliers.
        """
        nearer = np.ones(values.shape, bool)
        if self.at_nodes:
            return nearer
        lower, upper = (list(side) for side in self.problem._limits.bounded.values())
        for i, control in enumerate(lower):
            if control in upper:
                j = len(lower) + upper.index(control)
                nearer[:, i] = values[:, i] >= values[:, j]
                nearer[:, j] = ~nearer[:, i]
        return nearer

    def _dependent(
        self,
        solution: Solution,
        times: np.ndarray,
        held_by: tuple[np.ndarray, np.ndarray, tuple[str, ...]],
        units: np.ndarray,
    ) -> str:
        """A sentence on active inequalities whose derivatives depend on each other, or on the equations of that end."""
        active, rows, names = held_by
        ends = self._of_ends(solution, units) if self.at_nodes and self.problem._boundary.functions else {}
        for k in np.flatnonzero(np.any(active, axis=1)):
            held = np.flatnonzero(active[k])
            equations, more = ends.get(int(k), ((), rows[k, :0]))
            if len(held) + len(equations) < 2:
                continue
            gradients, words = np.concatenate([rows[k, held], more]), [*(names[i] for i in held), *equations]
            left, sizes, _ = np.linalg.svd(gradients, full_matrices=True)
            if len(gradients) > len(sizes) or sizes[-1] < DEPENDENT_GRADIENTS:
                shares = left[:, -1]
                involved = np.abs(shares) > ACTIVE * np.max(np.abs(shares))
                # Forces of positive multipliers cancel: they hold from all sides.
                enclosed = np.ptp(np.sign(shares[involved])) == 0 and not np.any(involved[len(held) :])
                named = " and ".join(words[i] for i in np.flatnonzero(involved))
                tried = "leave room between them, or to write an equation into the dynamics" if enclosed else LEAVE_OUT
                return (
                    f"{named} hold the trajectory near t = {times[k]:.6g} with derivatives that depend "
                    "on each other: their multipliers are not determined one by one, and no strict minimum is shown; "
                    f"try to {tried}."
                )
        return ""

    def _of_ends(self, solution: Solution, units: np.ndarray) -> dict[int, tuple[list[str], np.ndarray]]:
        """The equations of the first and the last node that only its state enters, by names and derivatives.

        The derivatives are by its coordinates in units, of length one, shape ``(k, n + m)``.
        """
        nodes, times, given = (
            self.state.rows(solution.states, 1),
            solution.times[-1:, None],
            self._flat_parameters(solution),
        )
        sizes, *both = (a[0] for a in self._between(nodes[:1], nodes[-1:], times, given))
        names = [
            boundary_words(n) for n, k in zip(self.problem._boundary.names, sizes, strict=True) for _ in range(int(k))
        ]
        equations = dict[int, tuple[list[str], np.ndarray]]()
        none = np.zeros((len(names), self.problem.controls.dimension))
        for place, own, other in ((0, *both), (len(solution.times) - 1, *both[::-1])):
            rows = np.concatenate([own, none], axis=1) / np.where(units > np.finfo(float).tiny, units, 1.0)
            lengths = np.linalg.norm(rows, axis=1)
            alone = np.flatnonzero(np.all(other == 0, axis=1) & (lengths > 0))
            equations[place] = [names[i] for i in alone], rows[alone] / lengths[alone, None]
        return equations

    def _multipliers(self, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
        """The multipliers of the inequalities in order, shape ``(N s, k)``, and whether each is among the largest.

        As many are among the largest as there are places at which the inequality is active: the remainder of a barrier
        elsewhere holds nothing.
        """
        limits, own, checks = self.problem._limits, solution.stage_multipliers, solution.checks
        active = checks.active if isinstance(checks, RegularChecks) else {}
        none = np.zeros((len(solution.times if self.at_nodes else solution.stage_times), 0))  # of one without entries
        if self.at_nodes:
            named = [(name, solution.node_multipliers.get(name, none)) for name in limits.node_names]
        else:
            named = [(name, own[name][:, side]) for name, side in limits.bounded.items() if side]
            named += [(name, own.get(name, none)) for name in limits.names]
        rows = np.concatenate([none, *(part for _, part in named)], axis=1)
        counts = [np.full(part.shape[1], active.get(name, 0)) for name, part in named]
        ranks = np.argsort(np.argsort(-rows, axis=0), axis=0)
        return rows, ranks < np.concatenate([np.zeros(0), *counts])

    @cached_property
    def _limits(self) -> PointwiseFunction:
        return AutomaticEvaluator().values(self._limits_of, self.state.size, self.control.size, 1, self.parameter.size)

    def _limits_of(self, x: Array, control: Array, time: Array, parameters: Array) -> tuple[Array, Array]:
        """The inequalities, and their derivatives by coordinates of state and control."""
        values, rest, _ = self._near(x, control, time, parameters)
        return values(rest), jax.jacfwd(values)(rest)

    def _near(self, x: Array, control: Array, time: Array, parameters: Array) -> tuple[Any, Array, Any]:
        """The inequalities as a function of coordinates of state and control, the coordinates of the point, and the
        flat ambient step."""
        problem = self.problem.with_parameters(self.parameter.point(parameters)).at_time(time[0])
        q, u, n = self.state.point(x), self.control.point(control), problem.manifold.dimension
        frame, directions = problem.manifold.basis(q), problem.controls.basis(u)

        def values(d: Array) -> Array:
            near = vec.add(q, vec.combine(frame, d[:n])), vec.add(u, vec.combine(directions, d[n:]))
            return problem.node_inequalities(near[0]) if self.at_nodes else problem.inequalities(*near)

        def step(d: Array) -> Array:
            parts = vec.combine(frame, d[:n]), vec.combine(directions, d[n:])
            return jnp.concatenate([self.state.flat(parts[0]), self.control.flat(parts[1])])

        return values, jnp.zeros(n + problem.controls.dimension), step

    @cached_property
    def _between(self) -> PointwiseFunction:
        return AutomaticEvaluator().values(self._between_of, self.state.size, self.state.size, 1, self.parameter.size)

    def _between_of(self, first: Array, last: Array, time: Array, parameters: Array) -> tuple[Array, ...]:
        """How many equations each boundary constraint is, and their derivatives by coordinates of both ends."""
        problem = self.problem.with_parameters(self.parameter.point(parameters)).at_time(time[0])
        ends, n = [self.state.point(q) for q in (first, last)], problem.manifold.dimension
        frames = [problem.manifold.basis(q) for q in ends]

        def values(*moves: Array) -> Array:
            near = (vec.add(q, vec.combine(frame, d)) for q, frame, d in zip(ends, frames, moves, strict=True))
            return problem._boundary.values(*near)

        rest = jnp.zeros(n), jnp.zeros(n)
        sizes = jnp.array([value.size for value in problem._boundary.each(*ends)], float)
        return sizes, *jax.jacfwd(values, (0, 1))(*rest)

    @cached_property
    def _bends(self) -> PointwiseFunction:
        state, control = self.state.size, self.control.size
        return AutomaticEvaluator().values(self._bends_of, state, control, 1, state + control, self.parameter.size)

    def _bends_of(self, x: Array, control: Array, time: Array, extent: Array, parameters: Array) -> tuple[Array, Array]:
        """Lengths of the derivatives of the inequalities, in coordinates of the extent of the trajectory, and second
        derivatives along them."""
        values, rest, step = self._near(x, control, time, parameters)
        units = jnp.abs(jax.jacfwd(step)(rest)).T @ extent
        slopes = jax.jacfwd(values)(rest) * units
        lengths = jnp.sqrt(jnp.sum(slopes**2, axis=1))

        def bend(i: int) -> Array:
            along = units * slopes[i] / jnp.where(lengths[i] > 0, lengths[i], 1.0)

            def rate(d: Array) -> Array:
                return jax.jvp(lambda d: values(d)[i], (d,), (along,))[1]

            return jax.jvp(rate, (rest,), (along,))[1]

        return lengths, jnp.array([bend(i) for i in range(len(slopes))])


def _is_nearly_met(solution: Solution) -> bool:
    """Whether what a trajectory without success lacks is so little that an inequality of it may hold it."""
    checks: Any = solution.checks
    return max(checks.defect, checks.stationarity, checks.violation) <= MULTIPLIERS_TELL


def _is_flat(values: np.ndarray, lengths: np.ndarray, bends: np.ndarray) -> np.ndarray:
    """Whether the derivatives of inequalities nearly vanish beside their changes, shape ``(N s, k)``.

    The changes are over the extent of the trajectory, as for a square that is flat on one side, or on the way back to a
    violated inequality.
    """
    bends = np.abs(bends)
    return (lengths < FLAT_BEND * bends) | (values * bends > FLAT_POWER * lengths**2)
