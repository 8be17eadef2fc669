"""The error of a discrete solution: its controls as functions of time, propagated by an integrator of order 8."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, final

import numpy as np
from jaxtyping import Array

from ....compute.automatic import AutomaticEvaluator
from ....compute.base import Evaluator
from ....manifolds import DomainError, InvalidInputError, Product
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.tolerances import EPS, HALF, ROUNDING
from ....retractions import Retraction, default_retraction
from ....tracing import reads_once
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.point_layout import PointLayout, parameter_layout
from ...problem_checks.requirements import require_treated
from ...stages.explicit_runge_kutta import ExplicitRungeKutta, dop853
from ..inputs.arguments import ALONG, BETWEEN, check_parameters
from ..solution.factor_distances import factor_distances
from ..solution.record import Solution
from ..transcription.chart import lagrange

RELATIVE_ACCURACY = 0.01  # of the error: what the integrator may add to it
RESOLUTION = ROUNDING * EPS  # relative to the states: errors below it
MOST_PARTS = 64  # parts of a step
NEWTON_ROUNDS = 8  # of Newton's method, which takes two to four where the error is small
SLOW_CONVERGENCE = 0.1  # shrinking of its moves below which the derivatives are renewed


@final
@dataclass(frozen=True, eq=False)
class DiscretizationError:
    """The distances between the states of a discrete solution and the states that its controls produce, for each
    factor.

    Attributes
    ----------
    distances : dict of str to array of shape (N + 1,)
        Distances at the nodes, in the unit of the factor. Radians on SO(n), the root of the sum of the squared angles,
        on spheres and for the rotation of SE(n); elsewhere the norm in the ambient space. Infinite if the controls lead
        nowhere.
    resolution : dict of str to float
        An upper estimate of the error of the integrator: the largest change of a state by the last halving of its
        steps.
    """

    distances: dict[str, np.ndarray]
    resolution: dict[str, float]

    @property
    def largest(self) -> dict[str, float]:
        """The largest distance over the nodes, for each factor."""
        return {name: float(np.max(values)) for name, values in self.distances.items()}


@reads_once
def discretization_error(
    problem: OptimalControlProblem, retraction: Retraction, solution: Solution, parameters: Any = None
) -> DiscretizationError:
    """The distances between the states of a solution and the states that its controls, functions of time, produce.

    Parameters
    ----------
    problem : OptimalControlProblem
        The problem.
    retraction : Retraction
        The retraction whose charts the propagation uses.
    solution : Solution
        A solution of the problem.
    parameters : pytree, optional
        The parameters of the solution.

    Returns
    -------
    DiscretizationError
        The distances for each factor of the manifold.

    Raises
    ------
    DomainError
        If the controls of a step are not in one chart of their manifold.
    InvalidInputError
        For another retraction, and for missing parameters.

    Notes
    -----
    The control of a step is the polynomial through its stages. DOP853 propagates it from the first state, in steps so
    short that its own error is a hundredth of the distances.

    References
    ----------
    Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, 1993.
    """
    if not isinstance(retraction, Retraction):
        got = type(retraction).__name__
        raise InvalidInputError(f"discretization_error takes a retraction, got {got}; try method.retraction")
    require_treated(problem, "discretization_error", *ALONG, *BETWEEN)
    check_parameters(problem, parameters)
    arrays = solution.times, solution.states, solution.stage_times, solution.controls
    return Propagator(problem, retraction, parameters).discretization_error(*arrays, parameters)


class _Steps(NamedTuple):
    """A discrete solution of N steps from N + 1 states, with s stages each, as flat points and coordinates of
    controls."""

    begins: np.ndarray  # (N,): times
    steps: np.ndarray  # (N,)
    states: np.ndarray  # (N + 1, E)
    frames: np.ndarray  # (N + 1, n, E)
    scales: np.ndarray  # (n,): sizes of the states' coordinates
    places: np.ndarray  # (s,): of the stages in a step, fractions of it
    bases: np.ndarray  # (N, U): the controls of the first stages
    offsets: np.ndarray  # (N, s, m): the other controls in the charts around these
    parameters: np.ndarray  # (1, P)


@final
class Propagator:
    """Propagates the controls of discrete solutions of one problem on the manifold by DOP853 [Hairer, Norsett, Wanner
    1993].

    The control of a step is the polynomial of time through its stages, in a retraction chart of the control manifold
    around the first of them. The state moves in the retraction chart around the beginning of each step, where its
    coordinates obey ``c' = (D R)^+ X(R(c), u(t))``. The propagated states of all steps are found at once: from the
    solution's own states, Newton's method makes the ends of the steps meet their beginnings. Where the error is too
    large for that, the steps follow one another. Steps are halved until this changes the error by less than one
    hundredth.

    ``parameters``: an example of those that the problem's functions take.
    """

    def __init__(
        self,
        problem: OptimalControlProblem,
        retraction: Retraction,
        parameters: Any = None,
        evaluator: Evaluator | None = None,
    ) -> None:
        self.problem, self.retraction, evaluator = problem, retraction, evaluator or AutomaticEvaluator()
        self.state, self.control = PointLayout.of(problem.manifold), PointLayout.of(problem.controls)
        self.parameter = parameter_layout(parameters)
        self._method = ExplicitRungeKutta(problem, retraction, dop853(), self.parameter, evaluator)
        self._frame = evaluator.values(self._frame_of, self.state.size)
        self._offset = evaluator.values(self._offset_of, self.control.size, self.control.size)

    def discretization_error(
        self, times: np.ndarray, states: Ambient, stage_times: np.ndarray, controls: Any, parameters: Any = None
    ) -> DiscretizationError:
        """Distances of the N + 1 ``states`` at ``times`` from the states to which the controls lead from the first
        state.

        ``controls`` belong to the N s ``stage_times``, s in each step. Raises ``DomainError`` if the controls of a step
        are not in one chart of the control manifold.
        """
        given = self._flat_steps(np.asarray(times), states, np.asarray(stage_times), controls, parameters)
        with np.errstate(all="ignore"):  # a propagation that leaves every chart is infinite, which is its answer
            ways = _AtOnce(self, given), partial(self.in_turn, given)
            found = next(filter(None, (self._refine(given, way) for way in ways)), None)
            return self._infinite(given) if found is None else found

    def gaps(
        self, times: np.ndarray, states: Ambient, stage_times: np.ndarray, controls: Any, parameters: Any = None
    ) -> np.ndarray:
        """Where the controls of each step lead from its own first state, minus its last one: flat, shape (N, E).

        Infinite where they lead nowhere. The parts of the steps are halved until this changes nothing.
        """
        given = self._flat_steps(np.asarray(times), states, np.asarray(stage_times), controls, parameters)
        k, parts = np.arange(len(given.steps)), 1
        rest = np.zeros((len(k), len(given.scales)))
        with np.errstate(all="ignore"):
            ends, change = self.ends(given, k, given.states[:-1], rest, parts), np.inf
            while parts < MOST_PARTS and np.any(change > RELATIVE_ACCURACY):
                parts, coarse, ends = 2 * parts, ends, self.ends(given, k, given.states[:-1], rest, 2 * parts)
                size = np.max(np.abs(ends - given.states[1:]), axis=1)
                size = np.maximum(size, RESOLUTION * np.max(np.abs(given.states), initial=0.0))
                change = np.max(np.abs(ends - coarse), axis=1) / size
        gaps = ends - given.states[1:]
        return np.where(np.isfinite(gaps), gaps, np.inf)

    def _flat_steps(
        self, times: np.ndarray, states: Ambient, stage_times: np.ndarray, controls: Any, parameters: Any
    ) -> _Steps:
        steps, rows = np.diff(times), self.state.rows(states, 1)
        stages = len(stage_times) // len(steps)
        controls = self.control.rows(controls, 1).reshape(len(steps), stages, self.control.size)
        longest = np.argmax(np.abs(steps))
        places = (stage_times.reshape(len(steps), -1)[longest] - times[longest]) / steps[longest]
        frames, sizes = self._frame(rows)
        bases = controls[:, 0]
        (offsets,) = self._offset(np.repeat(bases, stages, axis=0), np.concatenate(controls))
        if not np.all(np.isfinite(offsets)):
            raise DomainError(
                f"the controls of a step are not in one retraction chart of {self.problem.controls}, expected stages "
                "that can be interpolated; try more steps, for which they are nearer to each other"
            )
        scales = np.max(sizes, axis=0)
        scales = np.where(scales > 0, scales, 1.0)
        offsets = offsets.reshape(len(steps), stages, self.problem.controls.dimension)
        given = self.parameter.rows(parameters, 0)[None]
        return _Steps(times[:-1], steps, rows, frames, scales, places, bases, offsets, given)

    def _refine(self, given: _Steps, propagate: Callable[[int], np.ndarray | None]) -> DiscretizationError | None:
        """The error by finer and finer parts of the steps; None if a propagation fails."""
        parts, nodes = 1, propagate(1)
        while nodes is not None:
            parts, coarse, nodes = 2 * parts, nodes, propagate(2 * parts)
            if nodes is None:
                break
            error, change = self._distances(given.states, nodes), self._distances(coarse, nodes)
            largest = {name: float(np.max(values)) for name, values in change.items()}
            allowed = self._tolerances(given, error)
            if parts == MOST_PARTS or all(value <= allowed[name] for name, value in largest.items()):
                return DiscretizationError(error, largest)
        return None

    def _infinite(self, given: _Steps) -> DiscretizationError:
        start = self._distances(given.states, given.states)
        distances = {name: np.where(np.arange(len(zero)) > 0, np.inf, zero) for name, zero in start.items()}
        return DiscretizationError(distances, dict.fromkeys(start, np.inf))

    def _tolerances(self, given: _Steps, error: dict[str, np.ndarray]) -> dict[str, float]:
        """The error that the integrator may add to each factor: a part of the error, or the rounding of the states."""
        # Of the points themselves, in the unit of each.
        size = self._distances(given.states, np.zeros_like(given.states))
        return {name: max(RELATIVE_ACCURACY * np.max(error[name]), RESOLUTION * np.max(size[name])) for name in error}

    def _distances(self, first: np.ndarray, second: np.ndarray) -> dict[str, np.ndarray]:
        points = self.state.points(first), self.state.points(second)
        return {name: found for name, found, _ in factor_distances(self.problem.manifold, *points)}

    def in_turn(self, given: _Steps, parts: int) -> np.ndarray | None:
        """The states to which the controls lead, step after step; None if they are not finite."""
        nodes, rest = given.states.copy(), np.zeros((1, len(given.scales)))
        for k in range(len(given.steps)):
            nodes[k + 1] = self.ends(given, np.array([k]), nodes[k : k + 1], rest, parts)[0]
        return nodes if np.all(np.isfinite(nodes)) else None

    def ends(self, given: _Steps, k: np.ndarray, x: np.ndarray, c: np.ndarray, parts: int) -> np.ndarray:
        """Ends of the steps ``k``, each in some parts, from coordinates ``c`` in the charts around the points ``x``."""
        steps, bases = given.steps[k, None] / parts, given.bases[k]
        offsets = np.ascontiguousarray(given.offsets[k].transpose(0, 2, 1))
        for part in range(parts):

            def control(place: float, part: int = part) -> tuple[np.ndarray, np.ndarray]:
                return bases, offsets @ lagrange(given.places, np.asarray((part + place) / parts))

            c = self._method.step(x, c, given.begins[k, None] + steps * part, steps, control, given.parameters)
        return self.points(x, c)

    def points(self, x: np.ndarray, c: np.ndarray) -> np.ndarray:
        """The points with coordinates ``c`` in the charts around ``x``."""
        return self._method.points(x, c)

    def _frame_of(self, x: Array) -> tuple[Array, Array]:
        point = self.state.point(x)
        frame = self.problem.manifold.basis(point)
        return self.state.flat_frame(frame), vec.coordinate_sizes(frame, point)

    def _offset_of(self, base: Array, control: Array) -> tuple[Array]:
        u, controls = self.control.point(base), self.problem.controls
        v = default_retraction(controls).preimage(u, self.control.point(control))
        return (vec.components(controls.basis(u), v),)


@final
class _AtOnce:
    """Newton's method for the states to which the controls lead, all steps at once, in the charts around the
    solution's.

    After k rounds the first k states are exact. The derivatives of the steps, by differences at the solution's states,
    serve as long as the moves shrink well.
    """

    def __init__(self, propagator: Propagator, given: _Steps) -> None:
        self.propagator, self.given = propagator, given
        self.coordinates = np.zeros(given.frames.shape[:2])
        self.derivatives: np.ndarray | None = None
        manifold = propagator.problem.manifold
        factors = manifold.factors if isinstance(manifold, Product) else (manifold,)
        # Of the coordinates of each factor.
        self.starts = np.cumsum([0, *(f.dimension for f in factors if f.dimension)])[:-1]
        self.entries = np.cumsum([0, *(PointLayout.of(f).size for f in factors)])[:-1]  # of its flat points

    def __call__(self, parts: int) -> np.ndarray | None:
        """The states, each step in some parts; None if the moves do not become small."""
        last = np.inf
        rounding = RESOLUTION * self._sizes(self.given.scales[None])
        for _ in range(NEWTON_ROUNDS):
            move = self._move(parts)
            self.coordinates += move
            size = np.max(
                self._sizes(move) / np.maximum(RELATIVE_ACCURACY / 10 * self._sizes(self.coordinates), rounding)
            )
            if size <= 1:
                nodes = self.propagator.points(self.given.states, self.coordinates)
                return nodes if np.all(np.isfinite(nodes)) else None
            if not np.isfinite(size):
                return None
            if size > SLOW_CONVERGENCE * last:
                self.derivatives = None
            last = size
        return None

    def _sizes(self, coordinates: np.ndarray) -> np.ndarray:
        """The largest coordinate of each factor."""
        return np.maximum.reduceat(np.max(np.abs(coordinates), axis=0), self.starts)

    def _move(self, parts: int) -> np.ndarray:
        """Newton's move of the coordinates, zero for the first state, and NaN for states that are too far.

        NaN where the states are too far for it.
        """
        given, count = self.given, len(self.given.steps)
        n, aside = len(given.scales), EPS**HALF * given.scales
        ways = np.zeros((1, n)) if self.derivatives is not None else np.concatenate([np.zeros((1, n)), np.diag(aside)])
        k = np.repeat(np.arange(count), len(ways))
        begin = (self.coordinates[:-1, None] + ways).reshape(-1, n)
        ends = self.propagator.ends(given, k, given.states[k], begin, parts).reshape(count, len(ways), -1)
        gaps = ends - self.propagator.points(given.states[1:], self.coordinates[1:])[:, None]
        misses = np.einsum("kne,kwe->knw", given.frames[1:], gaps)
        if not self._are_tangential(gaps[:, 0], misses[:, :, 0]):
            return np.full((count + 1, n), np.nan)
        derivatives = self.derivatives
        if derivatives is None:
            derivatives = self.derivatives = (misses[:, :, 1:] - misses[:, :, :1]) / aside
        move = np.zeros((count + 1, n))
        for i in range(count):
            move[i + 1] = derivatives[i] @ move[i] + misses[i, :, 0]
        return move

    def _are_tangential(self, gaps: np.ndarray, misses: np.ndarray) -> bool:
        """Whether gaps are tangential rather than normal: of the chord to a far point the frames see little, or
        nothing."""
        tangential = np.einsum("kne,kn->ke", self.given.frames[1:], misses)
        sizes = [
            np.add.reduceat(a**2, self.entries, axis=1) for a in (gaps - tangential, tangential, self.given.states[1:])
        ]
        return bool(np.all(sizes[0] <= sizes[1] + RESOLUTION**2 * sizes[2]))
