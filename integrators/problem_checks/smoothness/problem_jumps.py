"""Jumps of the functions of a problem: the curves on which they are searched for, and the search in the controls."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....manifolds import Euclidean, InvalidInputError
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....retractions import Retraction
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.path_constraints import OF_CONTROL
from ...problem.point_layout import PointLayout
from .jumps import SMALLEST_JUMP, Jump, JumpSearch, largest_jump
from .step_primitives import find_step_primitives

# Distances from a control, times its size, between which a jump is looked for.
CONTROL_DISTANCES = np.concatenate([-(10.0 ** np.arange(6, -5, -1)), [0.0], 10.0 ** np.arange(-4, 7)])
SMOOTH_STEPS = (
    "try jnp.tanh(u / a) with a small a instead of a step, or, for controls from a finite set, a problem for each of "
    "them"
)
BOUND_ROUNDING = 1e-9  # of a bound: a control beyond it by more is not admitted


class Curves(NamedTuple):
    """K curves of states, controls and times from points.

    ``ways``, shape ``(K, d, n + m + 1)``: coordinates of the state and of the control in their charts, and the time, of
    each power of the place from 0 on.
    """

    states: Ambient  # (K, ...)
    controls: Ambient
    times: np.ndarray  # (K,)
    ways: np.ndarray

    @classmethod
    def straight(cls, points: tuple[Ambient, Ambient, np.ndarray], directions: np.ndarray) -> "Curves":
        """Straight lines through points, each in one direction."""
        return cls(*points, np.stack([0 * directions, directions], axis=1))


def search_on_curves(
    function: Callable[..., Array],
    problem: OptimalControlProblem,
    retraction: Retraction | None,
    given: Any,
    row: Any,
) -> JumpSearch:
    """The search for jumps of ``function(problem, q, u, other)`` on curves, with data ``(parameters, other)``.

    Without a retraction the states stay where they are.
    """

    def point(curve: Curves, s: Array) -> tuple[Ambient, Ambient, Any]:
        q, way = curve.states, jnp.stack([s**k for k in range(len(curve.ways))]) @ curve.ways
        if retraction is not None:
            q = retraction(q, vec.combine(retraction.manifold.basis(q), way[: problem.manifold.dimension]))
        return q, problem._steer(curve.controls, way[problem.manifold.dimension : -1]), curve.times + way[-1]

    def values(given: Any, q: Ambient, u: Ambient, t: Array) -> Array:
        return function(problem.with_parameters(given[0]).at_time(t), q, u, given[1])

    return JumpSearch(values, point, given, row)


def require_no_jumps(problem: OptimalControlProblem, q: Ambient, u: Ambient) -> None:
    """Raise if a function of the problem jumps in the controls, along a coordinate of these from ``u``.

    Only functions that compute steps of the controls are looked at.
    """
    steps = control_steps(problem, q, u)
    if steps:
        lines = control_lines(problem, (*vec.taken((q, u), None), np.zeros(1)))
        search = search_on_curves(rates, problem, None, (None, None), vec.taken(lines[0], 0))
        words = control_jump_words(problem, search, lines, steps)
        if words:
            raise InvalidInputError(words)


def control_steps(problem: OptimalControlProblem, q: Ambient, u: Ambient) -> list[str]:
    """Names of the steps that functions of a problem compute from the controls."""
    return find_step_primitives(lambda u: rates(problem, q, u), u)


def control_lines(
    problem: OptimalControlProblem,
    points: tuple[Ambient, Ambient, np.ndarray],
    distances: np.ndarray = CONTROL_DISTANCES,
) -> tuple[Curves, np.ndarray]:
    """Lines from each of some controls along every coordinate to both sides, and the ends of their pieces."""
    n, m, grid = problem.manifold.dimension, problem.controls.dimension, control_size(problem, points[1]) * distances
    k, entry, piece = (part.ravel() for part in np.indices((len(points[2]), m, len(grid) - 1)))
    curves = Curves.straight(vec.taken(points, k), np.eye(n + m + 1)[n + entry])
    return curves, np.stack([grid[piece], grid[piece + 1]], axis=1)


def control_size(problem: OptimalControlProblem, controls: Ambient) -> float:
    """The largest entry of some controls in R^m; 1 for zeros, and on another manifold."""
    return float(np.max(np.abs(controls), initial=0.0)) or 1.0 if isinstance(problem.controls, Euclidean) else 1.0


def control_jump_words(
    problem: OptimalControlProblem,
    search: JumpSearch,
    lines: tuple[Curves, np.ndarray],
    steps: list[str],
    given: Any = (None, None),
    timed: bool = False,
) -> str:
    """Words on the largest jump on these lines at controls that the bounds admit, with its time if that is asked for.

    The words are empty if there is none.
    """
    found = search.jumps(search.crossings(given, *lines))
    jump = largest_jump([jump for jump in found if _is_admissible(problem, jump)])
    if jump is None:
        return ""
    _, u, time = jump.point
    name = rate_names(problem)[jump.entry]
    place = jax.tree.map(lambda leaf: without_rounding(leaf, float(np.max(np.abs(leaf), initial=0.0))), u)
    hint = OF_CONTROL if name in problem._limits.function_words else SMOOTH_STEPS
    at = f" (q as at t = {float(time):.6g})" if timed else ""
    return (
        f"{name} jumps in the controls at u = {place}{at}: it computes {' and '.join(steps)} from them, and no "
        "derivative tells of the jump; expected a smooth function of u, because the conditions dH/du = 0 do not see a "
        f"jump; {hint}"
    )


def without_rounding(a: np.ndarray, size: float) -> np.ndarray:
    """Numbers of this size, rounding among them as zeros."""
    return np.where(np.abs(a) < SMALLEST_JUMP * size, 0.0, a)


def _is_admissible(problem: OptimalControlProblem, jump: Jump) -> bool:
    if problem.control_bounds is None:
        return True
    u, (lower, upper) = jump.point[1], problem.control_bounds
    slack = BOUND_ROUNDING * np.maximum(1.0, np.abs(u))
    return bool(np.all(u >= lower - slack) and np.all(u <= upper + slack))


def rates(problem: OptimalControlProblem, q: Ambient, u: Ambient, _: None = None) -> Array:
    """The entries of the velocity, the running cost, and the constraints."""
    q, u = jax.tree.map(jnp.asarray, (q, u))  # functions may ask for what arrays of NumPy lack
    velocity = PointLayout.of(problem.manifold).flat(problem.velocity(q, u))
    return jnp.concatenate([velocity, jnp.reshape(problem.cost_rate(q, u), (1,)), *problem._limits.of_functions(q, u)])


def rate_names(problem: OptimalControlProblem) -> list[str]:
    """The name of the function of each of these entries."""
    limits = problem.at_time(0.0)._limits.words_of_entries(problem.manifold.ambient, problem.controls.ambient)
    return [*PointLayout.of(problem.manifold).size * ["dynamics"], "running_cost", *limits]
