"""Kinks beside curvature: where ``dH/du`` changes along a line by what no second derivative accounts for, from however
near."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ....compute.jit_cache import call_compiled
from ....manifolds import Euclidean
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.precision import working_precision
from ....manifolds.numerics.tolerances import FINEST, rounding_of, tolerance
from ..control_probing import PARTS, SMOOTH_COSTS
from .jumps import JUMP_DECREASE, SMALLEST_JUMP

if TYPE_CHECKING:
    from ...boundary_value.solution.record import Solution
    from ...problem.optimal_control_problem import OptimalControlProblem

KINK_STAGES = 5  # of a trajectory from whose controls is looked
KINK_REACH = 2.0  # times the largest control: how far
PIECES, ROUNDS = 16, 13  # of an interval, of which that with the largest unexplained change is taken next
LAST_INTERVALS = 4  # last intervals, over a factor of 16^3, that tell a kink
# At a kink a slope changes with a lower power of the distance than this, and with the first where it is smooth.
SLOWEST_DECREASE = 0.75
ACCOUNTED = 1.2  # times the interval and the larger second derivative at its ends: no smooth function changes by more
STEEPER = 8.0  # how much that grows over the last intervals where it is not bounded
GROWS = 2.0  # how much a change grows towards a kink, and not towards a pole


class Zoom(NamedTuple):
    """Intervals of a line that close in on a point: widths, changes of a slope over them, largest second derivatives at
    the ends.

    Shape ``(ROUNDS,)``; ``places``: their lower ends; ``size``: the largest slope on the line.
    """

    widths: Array
    changes: Array
    curvatures: Array
    places: Array
    size: Array


def zoom_in(
    problem: "OptimalControlProblem", q: Ambient, p: Ambient, u: Ambient, ways: Float[Array, "k d m"], reach: Array
) -> tuple[Zoom, Ambient]:
    """From each of several states, costates and controls along each way, for both parts of ``H``; and the controls
    found."""

    def one(q: Ambient, p: Ambient, u: Ambient, way: Array, part: Array) -> tuple[Zoom, Ambient]:
        def value(s: Array) -> Array:
            return jnp.stack(problem._parts(q, p, problem._steer(u, s * way)))[part]

        def slope(s: Array) -> Array:
            return jax.jvp(value, (s,), (jnp.ones_like(s),))[1]

        zoom = _close_in(slope, -0.93 * reach, 1.01 * reach)
        return zoom, problem._steer(u, zoom.places[-1] * way)

    by_part = jax.vmap(one, (None, None, None, None, 0))
    by_way = jax.vmap(by_part, (None, None, None, 0, None))
    return jax.vmap(by_way, (0, 0, 0, 0, None))(q, p, u, ways, jnp.arange(len(PARTS)))


def _close_in(slope: Callable[[Array], Array], low: Array, high: Array) -> Zoom:
    """Intervals that close in, between ``low`` and ``high``, on where a slope changes by the most that its derivative
    misses.

    At a kink between two points no derivative is asked for.
    """
    reach = jnp.maximum(jnp.abs(low), jnp.abs(high))

    def closer(ends: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], tuple[Array, ...]]:
        low, high = ends
        s = low + (high - low) * jnp.arange(PIECES + 1) / PIECES
        slopes, curvatures = jax.vmap(lambda s: jax.jvp(slope, (s,), (jnp.ones_like(s),)))(s)
        changes, curvatures = jnp.diff(slopes), jnp.where(jnp.isfinite(curvatures), curvatures, 0.0)
        missing = changes - jnp.diff(s) * _mean_curvature(curvatures[:-1], curvatures[1:])
        i = jnp.argmax(jnp.where(jnp.isfinite(missing), jnp.abs(missing), -1.0))
        bends = jnp.maximum(jnp.abs(curvatures[i]), jnp.abs(curvatures[i + 1]))
        largest = jnp.max(jnp.where(jnp.isfinite(slopes), jnp.abs(slopes), 0.0))
        seen = s[i + 1] - s[i], changes[i], bends, s[i], largest
        fine = (high - low) / PIECES < FINEST * tolerance(s, 1.0) * reach
        return jax.tree.map(lambda a, b: jnp.where(fine, a, b), ends, (s[i], s[i + 1])), seen

    _, (widths, changes, bends, places, sizes) = jax.lax.scan(closer, (low, high), None, ROUNDS)
    return Zoom(widths, changes, bends, places, sizes[0])


def _mean_curvature(a: Array, b: Array) -> Array:
    """The mean of second derivatives at the ends of intervals, by which a slope changes over them where it is
    smooth."""
    # Beside a point where it is not bounded the mean is that of the larger one alone, and the smaller one is taken.
    return jnp.where(jnp.abs(a - b) <= jnp.abs(a + b) / 2, (a + b) / 2, jnp.where(jnp.abs(a) < jnp.abs(b), a, b))


def is_kink(widths: np.ndarray, changes: np.ndarray, curvatures: np.ndarray, size: float) -> bool:
    """Whether a slope changes at the point that intervals close in on: by a jump, or with a low power of the
    distance."""
    distinct = np.flatnonzero(np.diff(widths, prepend=np.inf) < -widths / 2)[-LAST_INTERVALS:]
    w, change, bend = widths[distinct], np.abs(changes[distinct]), curvatures[distinct]
    if len(w) < LAST_INTERVALS or not np.all(np.isfinite(change)):
        return False
    jumps, steepens = np.all(change > ACCOUNTED * w * bend), bend[-1] > STEEPER * bend[0]
    rounding = rounding_of(changes) * size
    lasts = change[-1] >= change[0] * (w[-1] / w[0]) ** SLOWEST_DECREASE and change[-1] <= GROWS * change[0]
    return bool((jumps or steepens) and lasts and change[0] > SMALLEST_JUMP * size and np.all(change > rounding))


def find_kinks(problem: "OptimalControlProblem", solution: "Solution") -> str:
    """Words on the largest kink of a function along the controls of a trajectory; empty if none is found.

    From a few stages along every coordinate of U, and in Euclidean space along the control itself, towards zero.
    """
    if not problem.controls.dimension:
        return ""
    leaves = [
        np.asarray(leaf)
        for leaf in jax.tree.leaves((solution.stage_costates, solution.controls, solution.stage_states))
    ]
    known = np.all([np.isfinite(leaf.reshape(len(leaf), -1)).all(axis=1) for leaf in leaves], axis=0)
    stages = np.flatnonzero(known)
    if not stages.size:
        return ""
    stages = stages[np.linspace(0, len(stages) - 1, KINK_STAGES).round().astype(int)]
    found = solution.stage_states, solution.stage_costates, solution.controls
    q, p, u = vec.taken(found, stages)
    ways, reach = _directions(problem, u)
    at_all: Any = jax.tree.map(np.asarray, call_compiled(zoom_in, problem, q, p, u, ways, reach)[0])
    zoom, controls = at_all
    worst, words = 0.0, ""
    for at in np.ndindex(zoom.size.shape):
        size, change = float(zoom.size[at]), float(zoom.changes[at][-1])
        if is_kink(zoom.widths[at], zoom.changes[at], zoom.curvatures[at], size) and abs(change) / size > worst:
            place = jax.tree.map(lambda leaf: without_rounding(leaf, float(reach)), vec.taken(controls, at))
            worst, words = (
                abs(change) / size,
                _words(at[-1], zoom.changes[at], place, float(solution.stage_times[stages[at[0]]])),
            )
    return words


def without_rounding(a: np.ndarray, size: float) -> np.ndarray:
    """Numbers of this size, rounding among them as zeros."""
    return np.where(np.abs(a) < SMALLEST_JUMP * size, 0.0, a)


def _directions(problem: "OptimalControlProblem", u: Ambient) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of directions from several controls, shape ``(k, d, m)``, of size one, and how far to go."""
    count, m = len(jax.tree.leaves(u)[0]), problem.controls.dimension
    ways, reach = np.broadcast_to(np.eye(m), (count, m, m)), 1.0
    if isinstance(problem.controls, Euclidean):
        flat = np.asarray(u).reshape(count, m)
        size = np.max(np.abs(flat), axis=1, keepdims=True)
        reach = KINK_REACH * float(size.max()) or 1.0
        if m > 1:
            ways = np.concatenate([ways, (flat / np.where(size > 0, size, 1.0))[:, None]], axis=1)
    return ways.astype(working_precision()), np.asarray(reach, working_precision())


def _words(part: int, changes: np.ndarray, control: Ambient, time: float) -> str:
    name, smooth = PARTS[part], SMOOTH_COSTS[0 if PARTS[part] == "running_cost" else 1]
    kind = (
        f"has a kink or a jump in the controls at u = {control}: its derivative by them changes there by "
        f"{changes[-1]:.3g}"
    )
    if abs(changes[-1]) < JUMP_DECREASE * abs(changes[-LAST_INTERVALS]):
        kind = f"has a second derivative by the controls that grows without bound at u = {control}"
    return (
        f"{name} {kind} (q and p as at t = {time:.6g}); expected a smooth function of u, because the conditions dH/du "
        f"= 0 do not hold at a kink, and Newton's method does not pass one; try {smooth}"
    )
