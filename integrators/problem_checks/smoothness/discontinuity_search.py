"""Where the functions of a problem may jump along lines, and whether they do: their values on both sides are compared
there."""

from collections.abc import Callable
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.automatic import AutomaticEvaluator
from ....compute.base import PointwiseFunction
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.tolerances import EPS, FINEST, HALF, tolerance
from ....retractions import Retraction
from ...problem.point_layout import PointLayout, parameter_layout
from .kinks import JUMP_DECREASE, LAST_INTERVALS, SMALLEST_JUMP
from .step_primitives import with_margins

if TYPE_CHECKING:
    from ...problem.optimal_control_problem import OptimalControlProblem

DEGREE = 4  # of polynomials that are a trajectory between two of its points
DISTANCE_RATIO = 4.0  # times: each distance from a place at which both sides are compared is that of the one before
MOST_OF_EACH = 24  # places of a step at which it is looked at
SIDE_DISTANCES = 2.0 ** np.array(
    [-3, -7, -14, -28]
)  # of an interval: how near to where a line puts a change it is looked for
BISECTIONS = 60  # in each of which an interval is halved, at least
LOCATION_ACCURACY = 1 / 16  # of the smallest of these distances: how closely such a place is known
MARGIN_ROUNDING = 4.0  # times eps, of what a step compares: a smaller margin is rounding
NEAR_MARGIN = EPS**HALF  # of the largest of what a step compares: nearer ones are at the jump
HIDDEN = 1e4  # times eps, of the largest entry: a smaller change may be rounding of its terms


FlatPoint = tuple[Any, Any]  # the parameters of the problem, and what the function takes in addition
LineFunction = Callable[["OptimalControlProblem", Ambient, Ambient, Any], Array]  # a function that is looked at


class Lines(NamedTuple):
    """K curves through flat states, controls and times: their coordinates there, polynomials of a place, and from where
    to where."""

    states: np.ndarray  # (K, E)
    controls: np.ndarray  # (K, U)
    times: np.ndarray  # (K,)
    ways: np.ndarray  # (K, DEGREE, n): of each power of the place
    turns: np.ndarray  # (K, m)
    spans: np.ndarray  # (K,)
    low: np.ndarray
    high: np.ndarray

    def __getitem__(self, which: Any) -> "Lines":  # pyright: ignore[reportIncompatibleMethodOverride]  # lines, not their parts
        """Some of the lines."""
        return vec.taken(self, which)

    @classmethod
    def through(
        cls, states: np.ndarray, controls: np.ndarray, times: np.ndarray, ways: np.ndarray, turns: np.ndarray
    ) -> "Lines":
        """Straight lines to both sides of points, in one direction each."""
        powers = np.concatenate([ways[:, None], np.zeros((len(ways), DEGREE - 1, ways.shape[1]))], axis=1)
        return cls(states, controls, times, powers, turns, 0 * times, 0 * times - 1, 0 * times + 1)


class LineSamples(NamedTuple):
    """The points, values, margins of steps with their sizes, and slopes of margins, at places of lines."""

    states: np.ndarray  # (K, j, E)
    controls: np.ndarray
    times: np.ndarray  # (K, j, 1)
    values: np.ndarray
    margins: np.ndarray  # (K, j, G)
    sizes: np.ndarray
    slopes: np.ndarray

    def of_step(self, step: np.ndarray) -> list[np.ndarray]:
        """On each line the margins of one step, shape ``(K, j)``, their slopes and their sizes."""
        parts = self.margins, self.slopes, self.sizes
        return [np.take_along_axis(a, step[:, None, None], 2)[:, :, 0] for a in parts]


class LocatedCrossings(NamedTuple):
    """The place on each line where a margin changes its sign, or else is smallest, and what changes there."""

    states: np.ndarray
    controls: np.ndarray
    times: np.ndarray  # (K,)
    margins: np.ndarray  # (K,): at the place
    values: np.ndarray  # (K, E), on one side
    changes: np.ndarray  # (K, J, E): from one side to the other, at several distances
    opposite: np.ndarray  # (K, J): whether the margin has another sign there, beyond rounding

    @property
    def compared(self) -> np.ndarray:
        """Whether the sides are compared, at enough distances to tell a jump."""
        return np.sum(self.opposite, axis=1) >= LAST_INTERVALS


class Jump(NamedTuple):
    """A jump of one entry, and where it is."""

    share: float
    entry: int
    change: float
    state: Ambient
    control: Ambient
    time: float


@final
class DiscontinuitySearch:
    """Looks for jumps of a function of a problem, a state and a control along lines, on which steps change that it
    computes.

    With a ``retraction`` the states move along the lines, else they are as they are. The function takes one thing more,
    which is ``given`` in each call behind the parameters of the problem, in the shapes of the ``example``. What is
    traced is traced once.
    """

    def __init__(
        self,
        function: LineFunction,
        problem: "OptimalControlProblem",
        retraction: Retraction | None,
        example: FlatPoint,
    ) -> None:
        self.function, self.problem, self.retraction = function, problem, retraction
        self.state, self.control = PointLayout.of(problem.manifold), PointLayout.of(problem.controls)
        self._given = parameter_layout(example)

    def seen(self, given: FlatPoint, lines: Lines) -> LineSamples:
        """The values and margins at the ends of lines."""
        return self._at(given, lines, np.stack([lines.low, lines.high], axis=1))

    def slopes(self, given: FlatPoint, points: Lines) -> np.ndarray:
        """At points the derivatives of the margins by coordinates of states, shape ``(K, G, n)``."""
        rows = points.states, points.controls, points.times[:, None], self._given.rows(given, 0)[None]
        return self._by_states.of_any(1, *rows)[0]

    @np.errstate(all="ignore")  # along lines on which nothing is finite nothing changes
    def located(
        self, given: FlatPoint, lines: Lines, seen: LineSamples, of_step: np.ndarray | None = None
    ) -> tuple[LocatedCrossings | None, np.ndarray]:
        """Where steps change along lines, or nearly do, and which; at some places of each.

        ``of_step``: on each line one step alone is looked at.
        """
        before, after = seen.margins[:, 0] >= 0, seen.margins[:, 1] >= 0
        dips = (seen.margins[:, 0] * seen.slopes[:, 0] < 0) & (seen.margins[:, 1] * seen.slopes[:, 1] > 0)
        changing = ((before != after) | dips) & np.all(np.isfinite(seen.margins), axis=1)
        if of_step is not None:
            changing &= np.arange(changing.shape[1]) == np.reshape(of_step, (-1, 1))
        line, step = few_of_each(changing)
        if not len(line):
            return None, step
        own = lines[line]
        place = self._places(given, own, step, vec.taken(seen, line))
        count = int(-np.log(FINEST * tolerance(place, 1.0)) / np.log(DISTANCE_RATIO))
        widths = (own.high - own.low)[:, None] * DISTANCE_RATIO ** -np.arange(1.0, count + 1)
        at = np.concatenate([place[:, None], place[:, None] - widths, place[:, None] + widths], axis=1)
        found = self._at(given, own, at)
        margins, _, sizes = found.of_step(step)
        clear = np.abs(margins) > MARGIN_ROUNDING * tolerance(margins, 1.0) * sizes  # nearer the sides are rounding
        before, after = slice(1, count + 1), slice(count + 1, None)
        opposite = ((margins[:, before] >= 0) != (margins[:, after] >= 0)) & clear[:, before] & clear[:, after]
        point = found.states[:, 0], found.controls[:, 0], found.times[:, 0, 0]
        changes = found.values[:, after] - found.values[:, before]
        return LocatedCrossings(*point, margins[:, 0], found.values[:, count], changes, opposite), step

    def jumps(self, located: LocatedCrossings | None, sizes: np.ndarray | None = None) -> list[Jump]:
        """The jumps at places; ``sizes`` of the entries, where the values at the place do not tell them."""
        if located is None:
            return []
        found = []
        for k in np.flatnonzero(located.compared):
            levels = np.flatnonzero(located.opposite[k])[-LAST_INTERVALS:]
            changes = np.abs(located.changes[k, levels])
            own = np.abs(located.values[k]) if sizes is None else sizes
            least = np.maximum(SMALLEST_JUMP * own, HIDDEN * EPS * np.max(own[np.isfinite(own)], initial=0.0))
            with np.errstate(all="ignore"):
                lasts = (
                    np.all(np.isfinite(changes), axis=0)
                    & (changes[-1] >= JUMP_DECREASE * changes[0])
                    & (changes[-1] > least)
                )
                shares = np.where(lasts, changes[-1] / np.maximum(own, changes[-1]), 0.0)
            if np.any(lasts):
                i = int(np.argmax(shares))
                state, control = self.state.points(located.states[k]), self.control.points(located.controls[k])
                found.append(
                    Jump(shares[i], i, located.changes[k, levels[-1], i], state, control, float(located.times[k]))
                )
        return found

    def _places(self, given: FlatPoint, lines: Lines, step: np.ndarray, seen: LineSamples) -> np.ndarray:
        """Where on each line the margin of a step changes its sign, or else is nearest to zero; ``seen`` at their
        ends.

        Intervals around the places close in: each is cut in its middle and near to where a straight line between its
        ends would put the place.
        """
        ends = np.stack([lines.low, lines.high], axis=1).astype(self._points.precision)
        finest = LOCATION_ACCURACY * FINEST * tolerance(ends, 1.0) * (ends[:, 1:] - ends[:, :1])
        margins, slopes, _ = seen.of_step(step)
        above, crossed = margins[:, 0] >= 0, (margins[:, 0] >= 0) != (margins[:, 1] >= 0)
        for _ in range(BISECTIONS):
            middle, width = ends.mean(axis=1, keepdims=True), ends[:, 1:] - ends[:, :1]
            if np.all((width <= finest) | np.any(middle == ends, axis=1, keepdims=True)):
                break
            # Where both ends are on one side, what is between may be on the other one, about where it is nearest to it.
            falls = np.where(crossed[:, None], margins, slopes)
            likely = ends[:, :1] + width * _zero(falls)[:, None]
            inner = np.concatenate(
                [middle, likely, likely - width * SIDE_DISTANCES, likely + width * SIDE_DISTANCES], axis=1
            )
            inner = np.clip(np.sort(inner, axis=1), ends[:, :1], ends[:, 1:]).astype(ends.dtype)
            here = self._at(given, lines, inner).of_step(step)
            other = (here[0] >= 0) != above[:, None]
            crossed |= np.any(other, axis=1)
            beyond = np.where(crossed[:, None], other, np.sign(here[0]) * here[1] > 0)
            first = np.where(np.any(beyond, axis=1), np.argmax(beyond, axis=1), beyond.shape[1])
            interval = np.stack([first, first + 1], axis=1)
            ends, margins, slopes = (
                np.take_along_axis(np.concatenate([a[:, :1], b, a[:, 1:]], axis=1), interval, 1)
                for a, b in ((ends, inner), (margins, here[0]), (slopes, here[1]))
            )
        return ends[:, 1]

    def _at(self, given: FlatPoint, lines: Lines, places: np.ndarray) -> LineSamples:
        """The values and margins at some places of each line, shape ``(K, j)``."""
        ways = lines.ways.reshape(len(places), -1)
        own = lines.states, lines.controls, lines.times[:, None], ways, lines.turns, lines.spans[:, None]
        rows = *(a[:, None] for a in own), places[..., None], self._given.rows(given, 0)[None, None]
        return LineSamples(*(a.astype(self._points.precision, copy=False) for a in self._points.of_any(2, *rows)))

    @cached_property
    def _points(self) -> PointwiseFunction:
        sizes, n, m = (self.state.size, self.control.size, 1), *self._dimensions
        return AutomaticEvaluator().values(self._seen, *sizes, DEGREE * n, m, 1, 1, self._given.size)

    @cached_property
    def _by_states(self) -> PointwiseFunction:
        return AutomaticEvaluator().values(self._slopes, self.state.size, self.control.size, 1, self._given.size)

    @property
    def _dimensions(self) -> tuple[int, int]:
        return self.problem.manifold.dimension, self.problem.controls.dimension

    def _seen(self, *line: Array) -> tuple[Array, ...]:
        """The values and margins at a place of a line."""
        q, u, t, ways, turn, span, place, given = line

        def point(s: Array) -> tuple[Ambient, Ambient, Array]:
            powers = jnp.stack([s**k for k in range(1, DEGREE + 1)])
            return self._moved((q, u, t), powers @ ways.reshape(DEGREE, -1), s * turn, s * span)

        looked, s = partial(with_margins, lambda s: self._value(point(s), given)), place[0]
        (found, margins), (_, slopes) = jax.jvp(looked, (s,), (jnp.ones_like(s),))
        state, control, time = point(s)
        return self.state.flat(state), self.control.flat(control), time[None], found, *margins, slopes.values

    def _slopes(self, q: Array, u: Array, t: Array, given: Array) -> tuple[Array]:
        """The derivatives of the margins by coordinates of the state."""
        n, m = self._dimensions

        def value(way: Array) -> Array:
            return self._value(self._moved((q, u, t), way, jnp.zeros(m), jnp.zeros(1)), given)

        # Those of the retraction count too, as they do along lines.
        return (jax.jacfwd(lambda way: with_margins(value, way)[1].values)(jnp.zeros(n)),)

    def _moved(
        self, start: tuple[Array, Array, Array], way: Array, turn: Array, span: Array
    ) -> tuple[Ambient, Ambient, Array]:
        """The point where a state, a control and a time have moved so far."""
        q, u, t = start
        state = self.state.point(q)
        if self.retraction is not None:
            state = self.retraction(state, vec.combine(self.retraction.manifold.basis(state), way))
        return state, self.problem._steer(self.control.point(u), turn), (t + span)[0]

    def _value(self, point: tuple[Ambient, Ambient, Array], given: Array) -> Array:
        (parameters, own), (state, control, time) = self._given.point(given), point
        return self.function(self.problem.with_parameters(parameters).at_time(time), state, control, own)


def _zero(values: np.ndarray) -> np.ndarray:
    """Where a straight line between two values, shape ``(K, 2)``, is zero, as a fraction of the way; halfway if
    nowhere."""
    with np.errstate(all="ignore"):
        found = values[:, 0] / (values[:, 0] - values[:, 1])
    return np.where((found >= 0) & (found <= 1), found, 0.5)


def few_of_each(marks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of marks, not more than a few of each column."""
    found = [np.zeros((2, 0), int)]
    for column in range(marks.shape[1]):
        rows = np.flatnonzero(marks[:, column])
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), MOST_OF_EACH)).astype(int))]
        found.append(np.stack([rows, np.full(len(rows), column)]))
    rows, columns = np.concatenate(found, axis=1)
    return rows, columns


def largest_jump(jumps: list[Jump]) -> Jump | None:
    """The one that changes most, relative to the size of its entry."""
    return max(jumps, key=lambda jump: jump.share, default=None)


def rates(problem: "OptimalControlProblem", q: Ambient, u: Ambient, _: None = None) -> Array:
    """The entries of the velocity, the running cost, and the constraints."""
    q, u = jax.tree.map(jnp.asarray, (q, u))  # functions may ask for what arrays of NumPy lack
    leaves = jax.tree.leaves(problem.velocity(q, u))
    halves = [
        jnp.ravel(half) for leaf in leaves for half in ((leaf.real, leaf.imag) if jnp.iscomplexobj(leaf) else (leaf,))
    ]
    return jnp.concatenate([*halves, jnp.reshape(problem.cost_rate(q, u), (1,)), *problem._limits.of_functions(q, u)])


def rate_names(problem: "OptimalControlProblem") -> list[str]:
    """The name of the function of each of these entries."""
    count = sum(
        leaf.size * (1 + jnp.issubdtype(leaf.dtype, jnp.complexfloating))
        for leaf in jax.tree.leaves(problem.manifold.ambient)
    )
    limits = problem.at_time(0.0)._limits.words_of_entries(problem.manifold.ambient, problem.controls.ambient)
    return [*count * ["dynamics"], "running_cost", *limits]
