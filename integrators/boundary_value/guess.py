"""First guesses of a trajectory: a user's, and the default guess with its curve, its controls and its costates."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, final

import jax
import numpy as np

from ...manifolds import DomainError, InvalidInputError
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient, is_finite_number
from ..problem.initial_controls import resting_control, within_bounds
from ..problem.optimal_control_problem import OptimalControlProblem
from ..problem.point_layout import PointLayout
from ..problem_checks.requirements import require_treated
from ..reporting.records import shapes
from ..reporting.text import brief
from ..stages.explicit_runge_kutta import RK4, ExplicitRungeKutta, control_spans, mesh_times
from .inputs.arguments import ALONG, BETWEEN, Method, check_problem, step_fractions
from .inputs.boundary_data import BoundaryDataReader
from .inputs.connecting_curve import ConnectingCurve

WHOLE = np.array([0.0, 1.0])  # shares of the horizon at which a trajectory has its ends


class Guess(NamedTuple):
    """A guess for ``solve``: states and controls at the stages, and costates at the ``N + 1`` nodes.

    Parameters
    ----------
    states : point with a leading axis
        Points of ``problem.manifold`` at the ``N s`` stages: arrays of shape ``(N s, *leaf)``. ``s`` is 1 for a
        discretization map.
    controls : point with a leading axis
        Controls at the stages, such as an array of shape ``(N s, m)``.
    costates : covectors with a leading axis, optional
        Costates at the nodes, shape ``(N + 1, *leaf)``; by default zero.
    nodes : point with a leading axis, optional
        States at the nodes, shape ``(N + 1, *leaf)``, if an extremal is known.
    stage_costates : covectors with a leading axis, optional
        Costates at the stages. Give both ``nodes`` and ``stage_costates``, or neither.
    multipliers : mapping of str to array, optional
        Multipliers of the inequalities at the stages, by name, as in ``Solution.multipliers``.
    node_multipliers : mapping of str to array, optional
        Multipliers of the node constraints, as in ``Solution.node_multipliers``.

    Notes
    -----
    With the states at the nodes, the costates at the stages and the multipliers of a solution, the solver starts close
    to that solution. ``Solution.guess`` returns all of these.

    Examples
    --------
    >>> line = OptimalControlProblem(Euclidean(1), lambda q, u: u, lambda q, u: u @ u / 2, controls=1)
    >>> method = Midpoint(Addition(Euclidean(1)))
    >>> Guess.from_waypoints(line, method, [np.zeros(1), np.ones(1)], steps=4).states[:, 0].tolist()
    [0.125, 0.375, 0.625, 0.875]
    """

    states: Ambient
    controls: Any
    costates: Any = None
    nodes: Any = None
    stage_costates: Any = None
    multipliers: Mapping[str, Any] | None = None
    node_multipliers: Mapping[str, Any] | None = None

    @classmethod
    def from_controls(
        cls, problem: OptimalControlProblem, method: Method, start: Ambient, controls: Any, horizon: float, steps: Any
    ) -> "Guess":
        """The trajectory that given controls produce from ``start`` over ``[0, horizon]``.

        Parameters
        ----------
        problem : OptimalControlProblem
            The dynamics.
        method : Gauss or DiscretizationMap
            The discretization, whose stages the guess has.
        start : point
            The first state.
        controls : point with a leading axis, or callable
            Controls at the stages, shape ``(N s, m)``, or a function of the time. Each is constant over the share of
            the step that is the quadrature weight of its stage.
        horizon : float
            The duration.
        steps : int or array_like
            The number of steps, or their relative lengths.

        Returns
        -------
        Guess
            States at the stages, the controls, and costates that are zero.

        Raises
        ------
        InvalidInputError, NotOnManifoldError
            For other arguments.
        DomainError
            If a state is not finite.
        """
        return roll_out(problem, method, start, controls, horizon, steps)

    @classmethod
    def from_waypoints(
        cls, problem: OptimalControlProblem, method: Method, points: Sequence[Ambient], steps: Any, times: Any = None
    ) -> "Guess":
        """The trajectory through given points; between two points it is the curve of ``default_guess``.

        Parameters
        ----------
        problem : OptimalControlProblem
            The problem, whose manifold has the points.
        method : Gauss or DiscretizationMap
            The discretization, whose stages the guess has.
        points : sequence of points
            At least two points, from start to end.
        steps : int or array_like
            The number of steps, or their relative lengths.
        times : array_like, optional
            Ascending times of the points, relative to the last minus the first; by default evenly spaced.

        Returns
        -------
        Guess
            States at the stages, controls at rest or inside their bounds, and costates that are zero.

        Raises
        ------
        InvalidInputError, NotOnManifoldError
            For other arguments.
        DomainError
            If no curve reaches the next point.
        """
        check_problem(problem, method)
        given = list(points)
        if len(given) < 2:
            raise InvalidInputError(
                f"a guess goes through at least two points, got {len(given)}; give the start, the end and more"
            )
        rows, shares = np.stack([*map(BoundaryDataReader.of(problem).point, given)]), _shares(times, len(given))
        return DefaultGuess(problem, method).through(rows, shares, steps)

    def __repr__(self) -> str:
        return (
            f"Guess(states={shapes(self.states)}, controls={shapes(self.controls)}, costates={shapes(self.costates)})"
        )


class Mesh(NamedTuple):
    """The mesh of a method: lengths of steps, places of stages in a step, and polynomials between the nodes."""

    fractions: np.ndarray  # of the horizon, (N,)
    stages: np.ndarray  # of a step, (s,)
    interpolant: Any  # an ``Interpolant``

    def times(self, horizon: float) -> tuple[np.ndarray, np.ndarray]:
        """Times of the nodes, and of the stages."""
        return mesh_times(horizon * self.fractions, self.stages)


class MeshGuess(ABC):
    """A record of a trajectory that is a guess on every mesh: a base class."""

    @abstractmethod
    def _guess_on(self, mesh: Mesh) -> Guess:
        """The trajectory at the nodes and stages of a mesh."""


def default_guess(problem: OptimalControlProblem, method: Method, start: Any, end: Any, steps: Any) -> Guess:
    """The guess of ``solve``: the curve of a retraction from start to end, or a walk to the end.

    Parameters
    ----------
    problem : OptimalControlProblem
        The problem.
    method : Gauss or DiscretizationMap
        The discretization, whose stages the guess has.
    start, end : point, None or Free
        The ends, as in ``solve``.
    steps : int or array_like
        The number of steps, or their relative lengths.

    Returns
    -------
    Guess
        States at the stages, controls at rest or inside their bounds, and costates that are zero.

    Raises
    ------
    DomainError
        If no curve comes near the end.

    Notes
    -----
    The retraction is the default retraction of the manifold, whose curve is a geodesic where that is known. If it does
    not reach the end, the retraction of ``method`` replaces it. On manifolds without a tape of the default retraction,
    such as Stiefel manifolds, the retraction of ``method`` comes first.

    If the points are opposite to each other, such as attitudes half a turn apart, several curves are shortest. The
    guess follows one of them, in a direction that is random but always the same.
    """
    ends = BoundaryDataReader.of(problem).ends(start, end, batched=False)
    ends.require_known(start)
    return DefaultGuess(problem, method).through(np.concatenate([ends.start, ends.end]), WHOLE, steps)


@final
class DefaultGuess:
    """The default guess: states on a curve, controls at rest or inside their bounds, costates zero.

    A solver begins from it too.
    """

    def __init__(self, problem: OptimalControlProblem, method: Method) -> None:
        self.problem, self.stages = problem, method.nodes
        self._state, self._control = PointLayout.of(problem.manifold), PointLayout.of(problem.controls)
        self._curve = ConnectingCurve(problem.manifold, method.retraction)

    def arrays(
        self, points: np.ndarray, shares: np.ndarray, fractions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Flat states and controls at the stages, shape (B, N s, ...), and costates at the nodes, shape (B, N + 1, E).

        The states go through flat points, shape (B, P, E), at these shares of the horizon.
        """
        (_, places), (count, through, size) = mesh_times(fractions, self.stages), points.shape
        segments = np.clip(np.searchsorted(shares, places, side="right") - 1, 0, through - 2)
        states = np.empty((count, len(places), size))
        for k in range(through - 1):
            here = segments == k
            if here.any():
                inside = (places[here] - shares[k]) / (shares[k + 1] - shares[k])
                states[:, here] = self._curve.states(points[:, k], points[:, k + 1], inside)
        controls = np.empty((count, len(places), self._control.size))
        controls[...] = self._first_control
        return states, controls, np.zeros((count, len(fractions) + 1, size))

    def through(self, points: np.ndarray, shares: np.ndarray, steps: Any) -> Guess:
        """The guess of one trajectory through flat points, shape (P, E), at these shares of the horizon."""
        states, controls, costates = self.arrays(points[None], shares, step_fractions(steps))
        return Guess(self._state.points(states[0]), self._control.points(controls[0]), self._state.points(costates[0]))

    @cached_property
    def _first_control(self) -> np.ndarray:
        """The flat control at rest, or inside the bounds if it is not."""
        return self._control.rows(within_bounds(self.problem._limits, resting_control(self.problem.controls)), 0)


def _shares(times: Any, count: int) -> np.ndarray:
    """Times of points in fractions of the horizon."""
    if times is None:
        return np.linspace(0.0, 1.0, count)
    given = np.asarray(times)
    if (
        given.shape != (count,)
        or given.dtype.kind not in "fiu"
        or not np.all(np.diff(given) > 0)
        or not np.all(np.isfinite(given))
    ):
        raise InvalidInputError(f"times must be {count} ascending numbers, one for each point, got {brief(times)}")
    return (given - given[0]) / (given[-1] - given[0])


def roll_out(
    problem: OptimalControlProblem, method: Method, start: Ambient, controls: Any, horizon: float, steps: Any
) -> Guess:
    """The guess that controls lead to."""
    check_problem(problem, method)
    require_treated(problem, "Guess.from_controls", *ALONG, *BETWEEN)
    if not (is_finite_number(horizon) and horizon > 0):
        raise InvalidInputError(f"horizon must be a positive finite time, got {horizon!r}")
    begin = BoundaryDataReader.of(problem).point(start)
    fractions, layout, control = (
        step_fractions(steps),
        PointLayout.of(problem.manifold),
        PointLayout.of(problem.controls),
    )
    _, places = mesh_times(fractions, method.nodes)
    if callable(controls):
        values = [jax.tree.map(np.asarray, controls(float(horizon) * place)) for place in places]
        controls = vec.stacked(values)
    check_arrays("controls", controls, problem.controls, len(places))
    rows, held = control.rows(controls, 1), control_spans(method, horizon * fractions)
    states = ExplicitRungeKutta(problem, method.retraction, RK4).states(begin, rows, held)
    if not np.all(np.isfinite(states)):
        lost = int(np.argmin(np.all(np.isfinite(states), axis=1)))
        raise DomainError(
            f"the controls lead to no finite state at time {float(horizon) * places[lost]:.6g}; try smaller controls, "
            "a shorter horizon, or more steps"
        )
    return Guess(layout.points(states), jax.tree.map(np.asarray, controls), _zero(problem, len(fractions)))


def _zero(problem: OptimalControlProblem, steps: int) -> Any:
    return jax.tree.map(lambda s: np.zeros((steps + 1, *s.shape), s.dtype), problem.manifold.ambient)


def check_arrays(name: str, given: Any, manifold: Any, length: int) -> None:
    """Raise unless these are points of a manifold, or vectors there, as many as ``length``, in finite numbers."""
    shapes_ = jax.tree.map(lambda s: (length, *s.shape), manifold.ambient)
    got = jax.tree.map(np.shape, given)
    if shapes_ != got:
        raise InvalidInputError(f"guess: {name} must have shapes {shapes_}, got {got}")
    numbers = [np.issubdtype(np.asarray(leaf).dtype, np.number) for leaf in jax.tree.leaves(given)]
    kept = zip(jax.tree.leaves(given), jax.tree.leaves(manifold.ambient), strict=True)
    if not (all(numbers) and all(np.isrealobj(leaf) or np.issubdtype(s.dtype, np.complexfloating) for leaf, s in kept)):
        raise InvalidInputError(
            f"guess: {name} must be real numbers, complex where points of {manifold} are; try jnp.real"
        )
    if not all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(given)):
        raise InvalidInputError(f"guess: {name} has entries that are NaN or infinite")
