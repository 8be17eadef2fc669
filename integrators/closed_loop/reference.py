"""Reference trajectories: piecewise polynomials in charts of a manifold, as functions of time in JAX."""

from typing import Any, Self, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...compute.at_points import judge_point
from ...compute.automatic import AutomaticEvaluator
from ...manifolds import DomainError, InvalidInputError
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...retractions import Retraction, default_retraction
from ..boundary_value.solution.record import Solution
from ..boundary_value.transcription.chart import Polynomials
from ..problem.point_layout import PointLayout
from ..problem.spline_table import Outside, finite_array, locate

NEIGHBOURS = 2  # points on each side of a point from which its velocity is computed: an error of third order
CUBIC = np.array([0.0, 1.0, 2.0, 3.0]) / 3  # places of a piece that determine a cubic polynomial


@final
class ReferencePath:
    """A trajectory on a manifold: on each piece of time a polynomial in the chart of a retraction around a centre."""

    def __init__(self, retraction: Retraction, times: np.ndarray, pieces: Polynomials, outside: Outside) -> None:
        self.retraction, self.times = retraction, times
        self.outside: Outside = outside
        self._pieces, self._layout = pieces, PointLayout.of(retraction.manifold)
        lost = ~np.all(np.isfinite(pieces.coordinates), axis=(1, 2))
        if np.any(lost):
            raise DomainError(
                f"the reference has no chart of {retraction} from t = {times[:-1][lost][0]:.6g} to "
                f"{times[1:][lost][0]:.6g}; expected points that the retraction reaches from one another; try more "
                "points, or a retraction with a larger image"
            )

    @classmethod
    def of_states(cls, solution: Solution, outside: Outside) -> Self:
        """The states of a solution: the polynomials of its method."""
        between = solution._between_nodes
        return cls(between.interpolant.retraction, solution.times, between.states, outside)

    @classmethod
    def of_controls(cls, solution: Solution, outside: Outside) -> Self:
        """The controls of a solution: the polynomials through its stages."""
        between = solution._between_nodes
        return cls(default_retraction(between.interpolant.controls), solution.times, between.controls, outside)

    @classmethod
    def through(cls, name: str, retraction: Retraction, table: tuple[Any, Any], outside: Outside) -> Self:
        """The trajectory through points at times, with a continuous velocity: cubic polynomials between the points.

        The velocity at a point is the derivative of a cubic spline through its neighbours, in its own chart.
        """
        times, rows = _times(name, table[0]), _rows(name, retraction, *table)
        return cls(retraction, times, _hermite(retraction, times, rows), outside)

    def __call__(self, t: Array) -> Ambient:
        """The point at a time."""
        manifold, (places, centres, coordinates) = self.retraction.manifold, self._pieces
        piece, t = locate(self.times, t, self.outside)
        place = (t - piece @ self.times[:-1]) / (piece @ np.diff(self.times))
        others = [[k for k in range(len(places)) if k != j] for j in range(len(places))]
        shares = [jnp.prod((place - places[k]) / (places[j] - places[k])) for j, k in enumerate(others)]
        centre = self._layout.point(piece @ centres)
        c = jnp.stack(shares) @ jnp.tensordot(piece, coordinates, 1)
        return self.retraction(centre, vec.combine(manifold.basis(centre), c))


@np.errstate(all="ignore")
def _hermite(retraction: Retraction, times: np.ndarray, rows: np.ndarray) -> Polynomials:
    """Cubic polynomials between neighbouring points, each in the chart around the first one."""
    from scipy.interpolate import CubicHermiteSpline, CubicSpline  # a third of a second

    manifold, layout = retraction.manifold, PointLayout.of(retraction.manifold)

    def coordinates(x: Array, y: Array) -> Array:
        centre = layout.point(x)
        return vec.components(manifold.basis(centre), retraction.preimage(centre, layout.point(y)))

    def chart_coordinates(x: Array, y: Array, slope: Array) -> tuple[Array, Array]:
        """The coordinates of a point in the chart around another one, and of a velocity there."""
        velocity = layout.flat(vec.combine(manifold.basis(layout.point(y)), slope))
        return jax.jvp(lambda y: coordinates(x, y), (y,), (velocity,))

    size, last, slopes = layout.size, len(times) - 1, np.empty((len(times), manifold.dimension))
    chart = AutomaticEvaluator().values(lambda x, y: (coordinates(x, y),), size, size)
    for k, point in enumerate(rows):
        near = slice(max(min(k - NEIGHBOURS, last - 2 * NEIGHBOURS), 0), max(k + NEIGHBOURS, 2 * NEIGHBOURS) + 1)
        c = chart.at(1, np.broadcast_to(point, rows[near].shape), rows[near])[0]
        slopes[k] = CubicSpline(times[near], c)(times[k], 1) if np.all(np.isfinite(c)) else np.nan
    both = AutomaticEvaluator().values(chart_coordinates, size, size, manifold.dimension)
    ends, arriving = both.at(1, rows[:-1], rows[1:], slopes[1:])
    found = np.full((last, len(CUBIC), manifold.dimension), np.nan)
    for k in np.flatnonzero(np.all(np.isfinite(np.hstack([ends, arriving, slopes[:-1]])), axis=1)):
        span, values = times[k : k + 2], np.stack([np.zeros_like(ends[k]), ends[k]])
        cubic = CubicHermiteSpline(span, values, np.stack([slopes[k], arriving[k]]))
        found[k] = cubic(span[0] + CUBIC * np.diff(span))
    return Polynomials(CUBIC, rows[:-1], found)


def _times(name: str, given: Any) -> np.ndarray:
    """The times of a table; raises for other input."""
    times = finite_array(f"the times of {name}", given)
    if times.ndim != 1 or len(times) < 2 or not np.all(np.diff(times) > 0):
        raise InvalidInputError(f"the times of {name} must be at least two numbers that increase, got {times}")
    return times


def _rows(name: str, retraction: Retraction, times: Any, points: Any) -> np.ndarray:
    """The points of a table as flat rows; raises where one is no point of the manifold."""
    manifold, count = retraction.manifold, len(times)
    points = jax.tree.map(np.asarray, points)
    if any(np.shape(leaf)[:1] != (count,) for leaf in jax.tree.leaves(points)):
        shapes = [np.shape(leaf) for leaf in jax.tree.leaves(points)]
        raise InvalidInputError(
            f"{name} has arrays of the shapes {shapes}, expected {count} points along the first axis, one at each time"
        )
    for k in range(count):
        verdict = judge_point(manifold, vec.taken(points, k))
        if not verdict:
            raise InvalidInputError(f"point {k} of {name} is {verdict.reason}; try manifold.restore(x)")
    return PointLayout.of(manifold).rows(points, 1)
