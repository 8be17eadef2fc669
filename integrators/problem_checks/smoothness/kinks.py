"""Kinks in the controls, which may be why a solve did not succeed: where ``dH/du`` changes by what no second derivative
accounts for.

Along each line through the controls of a few stages, intervals close in on the place where the slope of a part of ``H``
changes by most that the second derivatives at their ends miss. At a kink the change does not fall with the width of the
interval, or falls with a low power of it. No margins of steps are used (``jumps``): a slope also jumps where nothing is
compared, as at the tip of a cone.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.automatic import AutomaticEvaluator
from ....manifolds import Euclidean
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.tolerances import FINEST, rounding_of, tolerance
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.point_layout import parameter_layout
from ..control_probing import PARTS, SMOOTH_COSTS
from .jumps import JUMP_DECREASE, PIECES, SMALLEST_JUMP

KINK_STAGES = 5  # of a trajectory from whose controls is looked
KINK_REACH = 2.0  # times the largest control: how far
ROUNDS = 13  # in each of which an interval is divided into pieces
LAST_INTERVALS = 4  # last intervals, over a factor of 16^3, that tell a kink
# At a kink a slope changes with a lower power of the distance than this, and with the first where it is smooth.
SLOWEST_DECREASE = 0.75
ACCOUNTED = 1.2  # times the interval and the larger second derivative at its ends: no smooth function changes by more
STEEPER = 8.0  # how much that grows over the last intervals where it is not bounded
GROWS = 2.0  # how much a change grows towards a kink, and not towards a pole


class Zoom(NamedTuple):
    """Intervals of lines that close in: widths, changes of a slope over them, largest second derivatives at the ends.

    Shape ``(ROUNDS, K)``; ``places``, ``(K,)``: their last lower ends; ``size``: the largest slope on each line.
    """

    widths: np.ndarray
    changes: np.ndarray
    curvatures: np.ndarray
    places: np.ndarray
    size: np.ndarray


def find_kinks(problem: OptimalControlProblem, solution: Any) -> str:
    """Words on the largest kink of a function along the controls of a record; empty if none is found.

    From a few stages along every coordinate of U, and in Euclidean space along the control itself, towards zero.
    """
    if not problem.controls.dimension:
        return ""
    points = solution.stage_states, solution.stage_costates, solution.controls
    leaves = (np.asarray(leaf) for leaf in jax.tree.leaves(points))
    known = np.all([np.isfinite(leaf.reshape(len(leaf), -1)).all(axis=1) for leaf in leaves], axis=0)
    stages = np.flatnonzero(known)
    if not stages.size:
        return ""
    stages = stages[np.linspace(0, len(stages) - 1, KINK_STAGES).round().astype(int)]
    ways, reach = _directions(problem, vec.taken(solution.controls, stages))
    stage, way, part = (k.ravel() for k in np.indices((*ways.shape[:2], len(PARTS))))
    lines = *vec.taken(points, stages[stage]), ways[stage, way]
    zoom = zoom_in(problem, lines, part, reach)
    worst, words = 0.0, ""
    for k, size in enumerate(zoom.size):
        change = zoom.changes[-1, k]
        if is_kink(zoom.widths[:, k], zoom.changes[:, k], zoom.curvatures[:, k], size) and abs(change) / size > worst:
            u, way = vec.taken((lines[2], lines[3]), k)
            place = jax.tree.map(
                lambda a: without_rounding(np.asarray(a), reach), problem._steer(u, zoom.places[k] * way)
            )
            worst = abs(change) / size
            words = _words(part[k], zoom.changes[:, k], place, float(solution.stage_times[stages[stage[k]]]))
    return words


def _directions(problem: OptimalControlProblem, u: Ambient) -> tuple[np.ndarray, float]:
    """Coordinates of directions from several controls, shape ``(k, d, m)``, of size one, and how far to go."""
    count, m = len(jax.tree.leaves(u)[0]), problem.controls.dimension
    ways, reach = np.broadcast_to(np.eye(m), (count, m, m)), 1.0
    if isinstance(problem.controls, Euclidean):
        flat = np.asarray(u).reshape(count, m)
        size = np.max(np.abs(flat), axis=1, keepdims=True)
        reach = KINK_REACH * float(size.max()) or 1.0
        if m > 1:
            ways = np.concatenate([ways, (flat / np.where(size > 0, size, 1.0))[:, None]], axis=1)
    return ways, reach


@np.errstate(all="ignore")
def zoom_in(problem: OptimalControlProblem, lines: Any, part: np.ndarray, reach: float) -> Zoom:
    """Intervals that close in on where the slope of a part of ``H`` changes by the most that its derivative misses.

    ``lines``: states, costates, controls and directions of K lines. At a kink between two points no derivative is
    asked for.
    """
    layout = parameter_layout(lines, 1)

    def sample(row: Array, place: Array) -> tuple[Array, Array]:
        q, p, u, way = layout.point(row)
        value = lambda s: jnp.stack(problem._parts(q, p, problem._steer(u, s * way)))  # noqa: E731
        one = jnp.ones_like(place[0])
        return jax.jvp(lambda s: jax.jvp(value, (s,), (one,))[1], (place[0],), (one,))

    sampled = AutomaticEvaluator().values(sample, layout.size, 1)
    rows, k = layout.rows(lines, 1)[:, None], np.arange(len(part))
    low, high, seen = np.full(len(k), -0.93 * reach), np.full(len(k), 1.01 * reach), []
    for _ in range(ROUNDS):
        s = (low[:, None] + (high - low)[:, None] * (np.arange(PIECES + 1) / PIECES)).astype(sampled.precision)
        both = sampled.of_any(2, rows, s[..., None])
        slopes, bends = (a[k, :, part].astype(sampled.precision, copy=False) for a in both)
        changes, bends = np.diff(slopes), np.where(np.isfinite(bends), bends, 0.0)
        missing = np.abs(changes - np.diff(s) * _mean_curvature(bends[:, :-1], bends[:, 1:]))
        i = np.argmax(np.where(np.isfinite(missing), missing, -1.0), axis=1)
        largest = np.maximum(np.abs(bends[k, i]), np.abs(bends[k, i + 1]))
        size = np.max(np.abs(slopes), axis=1, where=np.isfinite(slopes), initial=0.0)
        seen.append((s[k, i + 1] - s[k, i], changes[k, i], largest, s[k, i], size))
        coarse = (high - low) / PIECES >= FINEST * tolerance(s, 1.0) * 1.01 * reach
        low, high = (np.where(coarse, new, old) for new, old in ((s[k, i], low), (s[k, i + 1], high)))
    widths, changes, curvatures, places, sizes = (np.stack(part) for part in zip(*seen, strict=True))
    return Zoom(widths, changes, curvatures, places[-1], sizes[0])


def _mean_curvature(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The mean of second derivatives at the ends of intervals, by which a slope changes over them where it is
    smooth."""
    # Beside a point where it is not bounded the mean is that of the larger one alone, and the smaller one is taken.
    return np.where(np.abs(a - b) <= np.abs(a + b) / 2, (a + b) / 2, np.where(np.abs(a) < np.abs(b), a, b))


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


def without_rounding(a: np.ndarray, size: float) -> np.ndarray:
    """Numbers of this size, rounding among them as zeros."""
    return np.where(np.abs(a) < SMALLEST_JUMP * size, 0.0, a)


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
