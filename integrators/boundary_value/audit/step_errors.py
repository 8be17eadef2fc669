"""The error of each step of a discrete solution by itself: of states, controls, and of inequalities between the
points."""

from functools import cached_property
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.automatic import AutomaticEvaluator
from ....compute.base import PointwiseFunction
from ....manifolds import DomainError, Euclidean, InvalidInputError, Product
from ....tracing import one_tracing, reads_once
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem_checks.requirements import require_treated
from ...reporting.text import brief
from ..inputs.arguments import ALONG, BETWEEN, check_parameters
from ..solution.record import Solution
from .discretization_error import RESOLUTION, Propagator
from .linear_controls import ControlCurvature

ACTIVE_MARGIN = (
    0.01  # of what the unknowns change it by: an inequality that comes no farther off its bound is held all along
)
INEQUALITY_POINTS = 4  # for each stage: where inequalities are looked at between the stages


@final
class StepErrors(NamedTuple):
    """The relative errors of the N steps of a solution, each by itself.

    Attributes
    ----------
    states : array of shape (N,)
        Distance from the last state of a step to the state that its controls produce from its first one, relative to
        the spread of the trajectory.
    controls : array of shape (N,)
        Excess of the cost: the squared distance of the control polynomial from the polynomial that includes a stage of
        a neighbour, or half the squared distance from the polynomial of the neighbour, relative to the root mean
        square of the controls, times the fraction of the horizon, times the part of the cost that is curved in the
        control, which is at least the fraction. At least the squared relative excess over a limit that depends on the
        controls, times the fraction; where both are linear in them, the excess times the squared fraction.
    inequalities : array of shape (N,)
        Largest violation of the inequalities that do not depend on the controls, relative to their largest value, or
        to the change by the spread of the states where one is held all along.
    violations : dict of str to array of shape (N,)
        Largest violation of each inequality between the stages, in its own unit.
    """

    states: np.ndarray
    controls: np.ndarray
    inequalities: np.ndarray
    violations: dict[str, np.ndarray]

    @property
    def each(self) -> np.ndarray:
        """The largest relative error of each step, shape ``(N,)``."""
        return np.maximum(np.maximum(self.states, self.controls), self.inequalities)

    @property
    def largest(self) -> float:
        """The largest relative error."""
        return float(np.max(self.each))


@reads_once
def step_errors(problem: OptimalControlProblem, solution: Solution, parameters: Any = None) -> StepErrors:
    """The errors of the steps of a solution, each by itself, which show the steps that are too long.

    Parameters
    ----------
    problem : OptimalControlProblem
        The problem.
    solution : Solution
        A solution of the problem.
    parameters : pytree, optional
        The parameters of the solution.

    Returns
    -------
    StepErrors
        One number for each step; unlike in ``discretization_error``, errors are not carried into the next step.

    Raises
    ------
    InvalidInputError
        For missing parameters, and for a solution without polynomials between its nodes.
    """
    require_treated(problem, "step_errors", *ALONG, *BETWEEN)
    check_parameters(problem, parameters)
    if not isinstance(solution, Solution) or solution.interpolant is None or solution.singular is not None:
        raise InvalidInputError(
            "step_errors takes the solution of a regular problem that is known between its nodes, got "
            f"{brief(solution)}; try what solve returns, or load_solution(path, retraction)"
        )
    return StepErrorEstimator(problem, solution.interpolant.retraction, parameters)(solution, parameters)


@final
class StepErrorEstimator:
    """Estimates the errors of the steps of solutions of one problem."""

    def __init__(self, problem: OptimalControlProblem, retraction: Any, parameters: Any) -> None:
        self.problem = problem
        self.propagator = Propagator(problem, retraction, parameters)
        self.parameter, self.curvature = self.propagator.parameter, ControlCurvature(problem, parameters)

    def __call__(self, solution: Solution, parameters: Any = None, switches: np.ndarray | None = None) -> StepErrors:
        """The errors; controls may jump at the nodes that are ``switches``."""
        with one_tracing(), np.errstate(all="ignore"):
            excess, free, bent, violations = self._inequalities(solution, parameters)
            alone = np.max(excess[:, free], axis=1, initial=0.0)
            share = np.diff(solution.times)[:, None] / (solution.times[-1] - solution.times[0])
            curvature = np.max(self.curvature(solution, parameters), axis=0)
            controls = self._controls(solution, share, curvature, switches)
            # Beyond a bound a cost that is linear falls in proportion, by a slope that is 0 at the switch of the step.
            falls = np.where(bent | np.any(curvature > 0), excess, share)
            controls = np.maximum(controls, np.max((share * falls * excess)[:, ~free], axis=1, initial=0.0))
            return StepErrors(self._states(solution, parameters), controls, alone, violations)

    def _states(self, solution: Solution, parameters: Any) -> np.ndarray:
        arrays = solution.times, solution.states, solution.stage_times, solution.controls
        try:
            gaps = np.abs(self.propagator.gaps(*arrays, parameters))
        except DomainError:  # of the controls of a step that is too long
            return np.full(solution.steps, np.inf)
        spreads, sizes = self._sizes(solution)
        gaps[gaps <= RESOLUTION * sizes] = 0.0  # which no mesh mends
        return np.max(np.where(gaps > 0, gaps / np.where(spreads > 0, spreads, 1.0), 0.0), axis=1, initial=0.0)

    def _sizes(self, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
        """Spreads of the entries of the states, one spread for a leaf that is in no flat space, and sizes of the
        leaves."""
        layout, manifold = self.propagator.state, self.problem.manifold
        rows = layout.rows(solution.states, 1)
        spreads, sizes = np.ptp(rows, axis=0), np.max(np.abs(rows), axis=0)
        factors = manifold.factors if isinstance(manifold, Product) else (manifold,)
        flat = [isinstance(factor, Euclidean) for factor in factors for _ in jax.tree.leaves(factor.ambient)]
        for place, each_own in zip(layout.places, flat, strict=True):
            largest = np.max(spreads[place], initial=0.0)
            spreads[place] = np.where((spreads[place] > 0) & each_own, spreads[place], largest)
            sizes[place] = np.max(sizes[place], initial=0.0)
        return spreads, sizes

    def _controls(
        self, solution: Solution, share: np.ndarray, curvature: np.ndarray, switches: np.ndarray | None
    ) -> np.ndarray:
        times, count = solution.times, solution.steps
        at = solution.stage_times.reshape(count, -1)
        rows = self.propagator.control.rows(solution.controls, 1).reshape(*at.shape, self.propagator.control.size)
        most = np.max(np.abs(rows), axis=(0, 1), initial=0.0)
        # The root of the mean square, to which a cost is in proportion; no more is wrong than all of a control.
        size = np.where(most > 0, np.sqrt(np.sum(share * np.mean(rows**2, axis=1), axis=0)), 1.0)
        # The part of the cost that is curved in an entry; what changes along a step counts where none is.
        part = np.where(curvature > 0, curvature * size**2 / 2 * (times[-1] - times[0]) / abs(solution.cost), 0.0)
        weights = share * np.clip(part, share, 1.0) * self._moving(solution, rows, most)
        linked = np.ones(count - 1, bool)
        linked[[] if switches is None else np.asarray(switches) - 1] = False
        k = np.flatnonzero(linked)
        errors = np.full(count, np.inf)
        for step, other in ((k, k + 1), (k + 1, k)):
            ends = np.stack([times[step], times[step + 1]], axis=1)
            alone = _through(at[step], rows[step], ends)
            both = _through(
                np.concatenate([at[step], at[other]], 1), np.concatenate([rows[step], rows[other]], 1), ends
            )
            apart = np.minimum(np.max(np.abs(alone - both), axis=1), most) / size
            errors[step] = np.minimum(errors[step], np.max(weights[step] * apart**2, axis=1, initial=0.0))
        ends = _through(at, rows, np.stack([times[:-1], times[1:]], axis=1))
        jumps = np.minimum(np.abs(ends[k + 1, 0] - ends[k, 1]) / 2, most)
        for step in (k, k + 1):  # what is bent within one of two steps, near their node, shows there
            errors[step] = np.maximum(errors[step], np.max(weights[step] * (jumps / size) ** 2, axis=1, initial=0.0))
        return errors

    def _moving(self, solution: Solution, rows: np.ndarray, most: np.ndarray) -> np.ndarray:
        """1 for entries of the controls that move the states by more than rounding along the trajectory, else 0.

        An entry of zero at the optimum is rounding in the solution, of which no mesh leaves less.
        """
        states = self.propagator.state.rows(solution.stage_states, 1)
        given = self.propagator.parameter.rows(solution.parameters, 0)
        slopes = self._slopes.at(1, states, rows.reshape(len(states), -1), solution.stage_times[:, None], given[None])[
            0
        ]
        sizes, span = self._sizes(solution)[1], solution.times[-1] - solution.times[0]
        moved = np.max(np.abs(slopes), axis=0) * most * span
        return np.where(np.any(~(moved <= RESOLUTION * sizes[:, None]), axis=0), 1.0, 0.0)

    @cached_property
    def _slopes(self) -> PointwiseFunction:
        sizes = self.propagator.state.size, self.propagator.control.size, 1, self.parameter.size
        return AutomaticEvaluator().values(self._slopes_of, *sizes)

    def _slopes_of(self, q: Array, u: Array, time: Array, parameters: Array) -> tuple[Array]:
        """The derivatives of the velocity by the entries of the control, shape ``(E, U)``."""
        bound = self.problem.with_parameters(self.parameter.point(parameters)).at_time(time[0])
        state, control = self.propagator.state, self.propagator.control
        return (jax.jacfwd(lambda u: state.flat(bound.velocity(state.point(q), control.point(u))))(u),)

    def _inequalities(
        self, solution: Solution, parameters: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """The largest excess of each step over each inequality, relative, and the excess by names in units.

        Flags mark the inequalities that are free of the controls, and those that are curved in them.
        """
        if not self.problem._limits.any or solution.interpolant is None:
            return np.zeros((solution.steps, 0)), np.zeros(0, bool), np.zeros(0, bool), {}
        stages = len(solution.stage_times) // solution.steps
        places = np.linspace(0.0, 1.0, INEQUALITY_POINTS * stages + 1)
        found = solution._between_nodes.within(places, costates=False)
        layouts = (self.propagator.state, found.states), (self.propagator.control, found.controls)
        q, u = (layout.rows(points, 2) for layout, points in layouts)
        given = self.parameter.rows(parameters, 0)
        values, by_state, by_control, twice = self._limits.at(2, q, u, found.times[..., None], given[None, None])
        excess = np.where(np.isfinite(values), np.maximum(values, 0.0), np.inf)
        bound = self.problem.with_parameters(parameters).at_time(0.0)
        violations = self.problem._limits.by_name(np.max(excess, axis=1), bound._inequality_sizes | bound._node_sizes)
        state, room = self._sizes(solution)[0], np.max(np.abs(u), axis=(0, 1), initial=0.0)
        changes = np.max(by_state * state, axis=3), np.max(by_control * room, axis=3, initial=0.0)
        size, change = np.max(np.abs(values), axis=(0, 1)), np.max(changes, axis=(0, 1, 2))
        free = np.max(np.abs(by_control), axis=(0, 1, 3), initial=0.0) == 0
        bent = np.max(twice, axis=(0, 1)) > 0
        # The distance from a bound that holds a control all along grows where the multiplier vanishes, near a switch.
        size = np.where((size <= ACTIVE_MARGIN * change) & (free | bent), change, size)
        relative = np.max(excess, axis=1) / np.where(size > 0, size, 1.0)
        return relative, free, bent, {name: np.max(rows, axis=1) for name, rows in violations.items()}

    @cached_property
    def _limits(self) -> PointwiseFunction:
        sizes = self.propagator.state.size, self.propagator.control.size, 1, self.parameter.size
        return AutomaticEvaluator().values(self._limits_of, *sizes)

    def _limits_of(self, q: Array, u: Array, time: Array, parameters: Array) -> tuple[Array, Array, Array, Array]:
        """The inequalities, with the nodes last, and the sizes of their first and second derivatives by states and
        controls."""
        bound = self.problem.with_parameters(self.parameter.point(parameters)).at_time(time[0])
        state, control = self.propagator.state, self.propagator.control

        def values(q: Array, u: Array) -> Array:
            point = state.point(q)
            return jnp.concatenate([bound.inequalities(point, control.point(u)), bound.node_inequalities(point)])

        by_state, by_control = jax.jacfwd(values, argnums=(0, 1))(q, u)
        twice = jnp.abs(jax.jacfwd(jax.jacfwd(values, 1), 1)(q, u))
        return values(q, u), jnp.abs(by_state), jnp.abs(by_control), jnp.sum(twice, axis=(1, 2))


def _through(at: np.ndarray, rows: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Polynomials through rows, shape (K, j, U), at (K, j), evaluated at times, shape (K, i)."""
    same = np.eye(at.shape[1], dtype=bool)
    apart = np.where(same, 1.0, at[:, :, None] - at[:, None, :])
    ratios = (times[:, :, None, None] - at[:, None, None, :]) / apart[:, None]
    return np.einsum("kij,kju->kiu", np.prod(np.where(same, 1.0, ratios), axis=-1), rows)
