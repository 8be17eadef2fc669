"""First guesses of a trajectory."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from ...manifolds import DomainError, InvalidInputError
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient, is_finite_number
from ...retractions import Gauss
from ..controls import resting_control
from ..layout import Layout
from ..problem import OptimalControlProblem
from ..records import shapes
from ..text import brief
from .arguments import ALONG, BETWEEN, Method, check_problem, fractions_of
from .end_points import EndReader
from .engine.rollout import RollOut
from .engine.start import Start


class Guess(NamedTuple):
    """A guess for ``solve``: states and controls at the stages, and costates at the N + 1 nodes (None: zero).

    Leaves carry the stages or nodes along their leading axis; a step has one stage, with ``Gauss(s, R)`` it has ``s``.
    What is known of an extremal in addition are its states at the ``nodes`` and its costates at the stages: both or
    neither; and the ``multipliers`` of its inequalities at the stages, and the ``node_multipliers``, by their names as
    in a ``Solution``. Where these fit, an iteration begins near to where it would end.
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
        """The trajectory to which controls lead from ``start`` over ``[0, horizon]``.

        ``controls``: points of U with the stages along the leading axis, as in a ``Guess`` or a ``Solution``, or a
        function of time. Each is held for the share of the step that its stage has as a weight of quadrature.
        ``steps``: their number, or their lengths. Costates are zero. Raises ``InvalidInputError`` or
        ``NotOnManifoldError`` for other arguments, and ``DomainError`` where the controls lead to no finite state.
        """
        return rolled_out(problem, method, start, controls, horizon, steps)

    @classmethod
    def from_waypoints(
        cls, problem: OptimalControlProblem, method: Method, points: Sequence[Ambient], steps: Any, times: Any = None
    ) -> "Guess":
        """The trajectory through ``points``, from each to the next on the way of ``default_guess``.

        ``times`` of the points: ascending, counted relative to the last minus the first; by default evenly spaced.
        Controls rest, costates are zero. Raises ``InvalidInputError`` or ``NotOnManifoldError`` for other arguments,
        and ``DomainError`` if no curve arrives.
        """
        check_problem(problem, method)
        given = list(points)
        if len(given) < 2:
            raise InvalidInputError(
                f"a guess goes through at least two points, got {len(given)}; give the start, the end and more"
            )
        rows, shares = np.stack([*map(EndReader.of(problem).point, given)]), _shares(times, len(given))
        return through(problem, method, rows, shares, steps, Start(problem.manifold, method.retraction))

    def __repr__(self) -> str:
        return (
            f"Guess(states={shapes(self.states)}, controls={shapes(self.controls)}, costates={shapes(self.costates)})"
        )


def default_guess(problem: OptimalControlProblem, method: Method, start: Any, end: Any, steps: Any) -> Guess:
    """The guess that ``solve`` begins with: along the curve of a retraction from start to end, or a walk to the end.

    The retraction is the default one of the manifold, whose curve is a geodesic where that is known; where it does not
    arrive, or in very unequal steps, the method's own. The method's own comes first where no tape gives the default
    one, as on Stiefel manifolds. Where the two points are opposite to each other, as attitudes half a turn apart, the
    walk sets out in a direction that is random but always the same: there are several ways round, and this is one of
    them. Controls rest, costates are zero. Raises ``DomainError`` if no curve arrives near the end.
    """
    ends = EndReader.of(problem).ends(start, end, batched=False)
    ends.require_known(start)
    rows, shares = np.concatenate([ends.start, ends.end]), np.array([0.0, 1.0])
    return through(problem, method, rows, shares, steps, Start(problem.manifold, method.retraction))


def through(
    problem: OptimalControlProblem, method: Method, rows: np.ndarray, shares: np.ndarray, steps: Any, start: Start
) -> Guess:
    """The guess through flat points at these shares of the horizon; ``start`` knows the ways between them."""
    fractions, layout = fractions_of(steps), Layout.of(problem.manifold)
    places = stage_places(method, fractions)
    own = np.clip(np.searchsorted(shares, places, side="right") - 1, 0, len(rows) - 2)
    states = np.empty((len(places), layout.size))
    for k in np.unique(own):
        inside = (places[own == k] - shares[k]) / (shares[k + 1] - shares[k])
        states[own == k] = start.states(rows[k][None], rows[k + 1][None], inside)[0]
    return Guess(layout.points(states), _rest(problem, len(places)), _zero(problem, len(fractions)))


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


def rolled_out(
    problem: OptimalControlProblem, method: Method, start: Ambient, controls: Any, horizon: float, steps: Any
) -> Guess:
    """The guess that controls lead to."""
    check_problem(problem, method)
    problem.require_treated("Guess.from_controls", *ALONG, *BETWEEN)
    if not (is_finite_number(horizon) and horizon > 0):
        raise InvalidInputError(f"horizon must be a positive finite time, got {horizon!r}")
    begin = EndReader.of(problem).point(start)
    fractions, layout, control = fractions_of(steps), Layout.of(problem.manifold), Layout.of(problem.controls)
    places = stage_places(method, fractions)
    if callable(controls):
        values = [jax.tree.map(np.asarray, controls(float(horizon) * place)) for place in places]
        controls = vec.stacked(values)
    check_arrays("controls", controls, problem.controls, len(places))
    weights = np.array(method.weights) if isinstance(method, Gauss) else np.ones(1)
    ended = np.cumsum((fractions[:, None] * weights).ravel())
    before, after = places - np.concatenate([[0.0], ended[:-1]]), ended - places
    rows = control.rows(controls, 1)
    states = RollOut(problem, method.retraction).states(begin, rows, horizon * before, horizon * after)
    if not np.all(np.isfinite(states)):
        lost = int(np.argmin(np.all(np.isfinite(states), axis=1)))
        raise DomainError(
            f"the controls lead to no finite state at time {float(horizon) * places[lost]:.6g}; try smaller controls, "
            "a shorter horizon, or more steps"
        )
    return Guess(layout.points(states), jax.tree.map(np.asarray, controls), _zero(problem, len(fractions)))


def stage_places(method: Method, fractions: np.ndarray) -> np.ndarray:
    """Times of the stages in fractions of the horizon, from those of the steps."""
    inside = np.array(method.nodes) if isinstance(method, Gauss) else np.array([float(method.theta)])
    starts = np.concatenate([[0.0], np.cumsum(fractions)[:-1]])
    return (starts[:, None] + inside * fractions[:, None]).ravel()


def _rest(problem: OptimalControlProblem, count: int) -> Any:
    return jax.tree.map(lambda leaf: np.broadcast_to(leaf, (count, *np.shape(leaf))), resting_control(problem.controls))


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
