"""The search for jumps of a function along lines.

A traced function jumps only where one of its steps changes, such as a comparison, a sign or a rounding
(``step_primitives``). Each step has a margin, a number that changes its sign there. The caller of ``JumpSearch``
chooses the lines: along a trajectory, in the controls, or through a point at which a margin is nearly zero. On every
line the search

1. evaluates the function and the margins at both ends,
2. closes in on the place where a margin changes its sign, or comes nearest to zero between two ends of one sign: where
   it comes nearer than by what it changes on the line,
3. compares the function on both sides of this place, at distances that fall by a factor of four each.

The function jumps if its differences over the smallest distances do not fall. At a kink and on a steep slope they do.
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.automatic import AutomaticEvaluator
from ....compute.base import PointwiseFunction
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.tolerances import EPS, FINEST, rounding_of, tolerance
from ...problem.point_layout import PointLayout, parameter_layout
from .step_primitives import with_margins

SUBINTERVALS = 16  # of an interval, one of which is the next interval
DISTANCE_RATIO = 4.0  # of each distance from a place to the next smaller one
LAST_DISTANCES = 4  # smallest ones, over a factor of 4^3, that tell a jump
LOCATION_ACCURACY = 1 / 16  # of the smallest distance: how closely a place is known
JUMP_DECREASE = 0.9  # of a difference from the first of these distances to the last one, where it is no jump
SMALLEST_JUMP = 1e-6  # of the size of the function: a smaller change may be rounding in single precision
HIDDEN = 1e4  # times eps, of the largest entry: a smaller change may be rounding of its terms
MARGIN_ROUNDING = 4.0  # times eps, of what a step compares: a smaller margin is rounding
MOST_OF_EACH = 24  # lines of a step that are searched


class Samples(NamedTuple):
    """Points of K lines at j places each: flat, with E values of the function and G margins with sizes and slopes."""

    points: np.ndarray  # (K, j, D)
    values: np.ndarray  # (K, j, E)
    margins: np.ndarray  # (K, j, G)
    sizes: np.ndarray
    slopes: np.ndarray

    def of_step(self, step: np.ndarray) -> list[np.ndarray]:
        """On each line the margins of one step, shape ``(K, j)``, their slopes and their sizes."""
        parts = self.margins, self.slopes, self.sizes
        return [np.take_along_axis(a, step[:, None, None], 2)[:, :, 0] for a in parts]


class Crossings(NamedTuple):
    """C places of lines where a margin changes its sign or is smallest, and how the function changes there."""

    ends: Samples  # at both ends of all lines
    line: np.ndarray  # (C,)
    step: np.ndarray  # (C,)
    points: np.ndarray  # (C, D)
    margins: np.ndarray  # (C,)
    values: np.ndarray  # (C, E), on one side
    changes: np.ndarray  # (C, J, E): from one side to the other one, at distances that fall
    opposite: np.ndarray  # (C, J): whether the margin has another sign there, beyond rounding

    @property
    def compared(self) -> np.ndarray:
        """Whether the sides are compared at enough distances to tell a jump."""
        return np.sum(self.opposite, axis=1) >= LAST_DISTANCES


class Jump(NamedTuple):
    """The largest jump at one place of a line, and its share of the size of its entry."""

    share: float
    entry: int
    change: float
    line: int
    point: Any


@final
class JumpSearch:
    """The search for jumps of ``function(given, *point)`` along lines ``line(row, s)`` of points; traced once.

    ``given`` and ``row`` are pytrees of arrays: data that all lines share, and the data of one line. The constructor
    takes examples of both.
    """

    def __init__(
        self, function: Callable[..., Array], line: Callable[[Any, Array], tuple[Any, ...]], given: Any, row: Any
    ) -> None:
        self._function, self._line = function, line
        self._given, self._row = parameter_layout(given), parameter_layout(row)
        self._point = PointLayout(jax.eval_shape(line, row, 0.0))

    def at(self, given: Any, rows: Any, places: np.ndarray) -> Samples:
        """The function and its margins at some places of each line, shape ``(K, j)``."""
        flat = self._row.rows(rows, 1)[:, None], places[..., None], self._given.rows(given, 0)[None, None]
        return Samples(*(a.astype(self._samples.precision, copy=False) for a in self._samples.of_any(2, *flat)))

    def points(self, flat: np.ndarray) -> Any:
        """Points with the entries in the rows of an array."""
        return self._point.points(flat)

    @np.errstate(all="ignore")  # along lines on which nothing is finite nothing changes
    def crossings(self, given: Any, rows: Any, ends: np.ndarray, changing: np.ndarray | None = None) -> Crossings:
        """Where margins change their signs between two places of each line, or nearly do.

        ``ends``, shape ``(K, 2)``; ``changing``, ``(K, G)``: the steps that are looked at, else a few lines of each
        step.
        """
        seen = self.at(given, rows, ends)
        above, trend = seen.margins >= 0, seen.margins * seen.slopes
        found = (above[:, 0] != above[:, 1]) | ((trend[:, 0] < 0) & (trend[:, 1] > 0))
        found &= np.all(np.isfinite(seen.margins), axis=1)
        line, step = few_of_each(found) if changing is None else np.nonzero(found & changing)
        line, step, place = self._close_in(given, rows, ends, line, step)
        count = int(-np.log(FINEST * tolerance(place, 1.0)) / np.log(DISTANCE_RATIO))
        distances = (ends[line, 1:] - ends[line, :1]) * DISTANCE_RATIO ** -np.arange(1.0, count + 1)
        at = np.concatenate([place[:, None], place[:, None] - distances, place[:, None] + distances], axis=1)
        samples = self.at(given, vec.taken(rows, line), at)
        margins, _, sizes = samples.of_step(step)
        clear = np.abs(margins) > MARGIN_ROUNDING * tolerance(margins, 1.0) * sizes  # nearer the sides are rounding
        before, after = slice(1, count + 1), slice(count + 1, None)
        opposite = ((margins[:, before] >= 0) != (margins[:, after] >= 0)) & clear[:, before] & clear[:, after]
        changes = samples.values[:, after] - samples.values[:, before]
        here = samples.points[:, 0], margins[:, 0], samples.values[:, count]
        return Crossings(seen, line, step, *here, changes, opposite)

    @np.errstate(all="ignore")  # of what is not finite
    def jumps(self, found: Crossings, sizes: np.ndarray | None = None) -> list[Jump]:
        """The jumps at places; ``sizes`` of the entries, unless the values there tell them."""
        jumps = list[Jump]()
        every = np.broadcast_to(np.abs(found.values) if sizes is None else sizes, found.values.shape)
        for k in np.flatnonzero(found.compared):
            changes, own = found.changes[k, np.flatnonzero(found.opposite[k])[-LAST_DISTANCES:]], every[k]
            first, last = np.abs(changes[0]), np.abs(changes[-1])
            hidden = max(HIDDEN * EPS, rounding_of(changes)) * np.max(own[np.isfinite(own)], initial=0.0)
            least = np.maximum(SMALLEST_JUMP * own, hidden)
            lasts = np.all(np.isfinite(changes), axis=0) & (last > least) & (last >= JUMP_DECREASE * first)
            if np.any(lasts):
                shares = np.where(lasts, last / np.maximum(own, last), 0.0)
                i = int(np.argmax(shares))
                jumps.append(Jump(shares[i], i, changes[-1, i], int(found.line[k]), self.points(found.points[k])))
        return jumps

    def _close_in(
        self, given: Any, rows: Any, ends: np.ndarray, line: np.ndarray, step: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The lines and steps whose margin comes nearer to zero than by what it changes, and the place of each.

        Of the pieces of an interval the next one is the first with ends on two sides, or else the first whose margin
        falls at one end and rises at the other one, or else that which ends nearest to zero.
        """
        ends = ends[line].astype(self._samples.precision)
        rounds = int(np.ceil(np.log(LOCATION_ACCURACY * FINEST * tolerance(ends, 1.0)) / -np.log(SUBINTERVALS)))
        for k in range(rounds):
            if not len(line):
                break
            places = np.linspace(ends[:, 0], ends[:, 1], SUBINTERVALS + 1, axis=1, dtype=ends.dtype)
            margins, slopes, _ = self.at(given, vec.taken(rows, line), places).of_step(step)
            if k == 0:
                near = ~(np.min(np.abs(margins), axis=1) > np.ptp(margins, axis=1))
                line, step, places, margins, slopes = (a[near] for a in (line, step, places, margins, slopes))
            above, trend = margins >= 0, margins * slopes
            crossed = above[:, 1:] != above[:, :-1]
            dips = (trend[:, :-1] < 0) & (trend[:, 1:] > 0)
            nearest = np.argmin(np.minimum(np.abs(margins[:, 1:]), np.abs(margins[:, :-1])), axis=1)
            first = np.where(np.any(dips, axis=1), np.argmax(dips, axis=1), nearest)
            first = np.where(np.any(crossed, axis=1), np.argmax(crossed, axis=1), first)
            ends = np.take_along_axis(places, np.stack([first, first + 1], axis=1), 1)
        return line, step, ends[:, 1]

    @cached_property
    def _samples(self) -> PointwiseFunction:
        return AutomaticEvaluator().values(self._sample, self._row.size, 1, self._given.size)

    def _sample(self, row: Array, place: Array, given: Array) -> tuple[Array, ...]:
        """The point at a place of a line, the function there and its margins with their slopes along the line."""
        own, line = self._given.point(given), self._row.point(row)

        def sample(s: Array) -> tuple[Any, ...]:
            point = self._line(line, s)
            return *with_margins(lambda *point: self._function(own, *point), *point), self._point.flat(point)

        (values, margins, point), (_, slopes, _) = jax.jvp(sample, (place[0],), (jnp.ones_like(place[0]),))
        return point, values, *margins, slopes.values


def few_of_each(marks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of marks, not more than a few of each column."""
    found = [np.zeros((2, 0), int)]
    for column in np.flatnonzero(np.any(marks, axis=0)):
        rows = np.flatnonzero(marks[:, column])
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), MOST_OF_EACH)).astype(int))]
        found.append(np.stack([rows, np.full(len(rows), column)]))
    rows, columns = np.concatenate(found, axis=1)
    return rows, columns


def largest_jump(jumps: list[Jump]) -> Jump | None:
    """The jump that is the largest share of the size of its entry."""
    return max(jumps, key=lambda jump: jump.share, default=None)


def largest(samples: np.ndarray) -> np.ndarray:
    """The largest finite absolute value of each entry among samples, shape ``(K, j, E)``."""
    return np.max(np.abs(np.where(np.isfinite(samples), samples, 0.0)), axis=(0, 1), initial=0.0)
