"""Where the functions of a problem may jump along lines, and whether they do: their values on both sides are compared
there."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.tolerances import EPS, FINEST, HALF, tolerance
from ..retractions import Retraction
from .compilation import held, in_chunks
from .jumps import with_margins
from .kinks import JUMP, LASTS, LESS

if TYPE_CHECKING:
    from .problem import OptimalControlProblem

DEGREE = 4  # of polynomials that are a trajectory between two of its points
CLOSER = 4.0  # times: each distance from a place at which both sides are compared is that of the one before
EACH = 24  # places of a step at which it is looked at
NEAR = EPS**HALF  # of the largest of what a step compares: nearer ones are at the jump
HIDDEN = 1e4  # times eps, of the largest entry: a smaller change may be rounding of its terms


Given = tuple[Any, Any]  # the parameters of the problem, and what the function takes in addition
Looked = Callable[["OptimalControlProblem", Ambient, Ambient, Any], Array]  # a function that is looked at


class Lines(NamedTuple):
    """K curves through states, controls and times: their coordinates there, polynomials of a place, and from where to
    where."""

    states: Ambient
    controls: Ambient
    times: Any  # (K,)
    ways: Any  # (K, DEGREE, n): of each power of the place
    turns: Any  # (K, m)
    spans: Any  # (K,)
    low: Any
    high: Any

    def __getitem__(self, which: Any) -> "Lines":  # pyright: ignore[reportIncompatibleMethodOverride]  # lines, not their parts
        """Some of the lines."""
        return vec.taken(self, which)

    @classmethod
    def through(
        cls, states: Ambient, controls: Ambient, times: np.ndarray, ways: np.ndarray, turns: np.ndarray
    ) -> "Lines":
        """Straight lines to both sides of points, in one direction each."""
        powers = np.concatenate([ways[:, None], np.zeros((len(ways), DEGREE - 1, ways.shape[1]), ways.dtype)], axis=1)
        return cls(states, controls, times, powers, turns, 0 * times, 0 * times - 1, 0 * times + 1)


class Seen(NamedTuple):
    """At both ends of lines: the values, the margins of the steps in them and their sizes, and slopes of the
    margins."""

    values: np.ndarray  # (K, 2, E)
    margins: np.ndarray  # (K, 2, G)
    sizes: np.ndarray
    slopes: np.ndarray


class Located(NamedTuple):
    """The place on each line where a margin changes its sign, or else is smallest, and what changes there."""

    states: Ambient
    controls: Ambient
    times: Any  # (K,)
    margins: Any  # at the place
    values: Any  # (K, E), on one side
    changes: Any  # (K, J, E): from one side to the other, at several distances
    opposite: Any  # (K, J): whether the margin has another sign there


class Jump(NamedTuple):
    """A jump of one entry, and where it is."""

    share: float
    entry: int
    change: float
    state: Ambient
    control: Ambient
    time: float


@final
class Crossings:
    """Looks for jumps of a function of a problem, a state and a control along lines, on which steps change that it
    computes.

    With a ``retraction`` the states move along the lines, else they are as they are. The function takes one thing more,
    which is ``given`` in each call behind the parameters of the problem. What is traced is traced once.
    """

    def __init__(self, function: Looked, problem: "OptimalControlProblem", retraction: Retraction | None) -> None:
        self.problem, self.retraction = problem, retraction
        self._seen, self._slopes, self._located = (
            held(partial(kernel, (function, problem, retraction))) for kernel in (_seen, _slopes, _located)
        )

    def seen(self, given: Given, lines: Lines) -> Seen:
        """What is seen at the ends of lines."""
        return Seen(*in_chunks(partial(self._seen, given), lines))

    def slopes(self, given: Given, lines: Lines) -> np.ndarray:
        """At points the derivatives of the margins by coordinates of states."""
        return in_chunks(partial(self._slopes, given), lines)

    def located(
        self, given: Given, lines: Lines, seen: Seen, of_step: np.ndarray | None = None
    ) -> tuple[Located | None, np.ndarray]:
        """Where steps change along lines, or nearly do, and which; at some places of each.

        ``of_step``: on each line one step alone is looked at.
        """
        before, after = seen.margins[:, 0] >= 0, seen.margins[:, 1] >= 0
        crossed = before != after
        dips = (seen.margins[:, 0] * seen.slopes[:, 0] < 0) & (seen.margins[:, 1] * seen.slopes[:, 1] > 0)
        changing = (crossed | dips) & np.all(np.isfinite(seen.margins), axis=1)
        if of_step is not None:
            changing &= np.arange(changing.shape[1]) == np.reshape(of_step, (-1, 1))
        line, step = some(changing)
        if not len(line):
            return None, step
        own = lines[line], step, before[line, step], crossed[line, step]
        return in_chunks(partial(self._located, given), *own), step

    def jumps(self, located: Located | None, sizes: np.ndarray | None = None) -> list[Jump]:
        """The jumps at places; ``sizes`` of the entries, where the values at the place do not tell them."""
        if located is None:
            return []
        found = []
        for k in range(len(located.times)):
            levels = np.flatnonzero(located.opposite[k])[-LASTS:]
            if len(levels) < LASTS:
                continue
            changes = np.abs(located.changes[k, levels])
            own = np.abs(located.values[k]) if sizes is None else sizes
            least = np.maximum(JUMP * own, HIDDEN * EPS * np.max(own[np.isfinite(own)], initial=0.0))
            with np.errstate(all="ignore"):
                lasts = (
                    np.all(np.isfinite(changes), axis=0) & (changes[-1] >= LESS * changes[0]) & (changes[-1] > least)
                )
                shares = np.where(lasts, changes[-1] / np.maximum(own, changes[-1]), 0.0)
            if np.any(lasts):
                i = int(np.argmax(shares))
                state, control = vec.taken((located.states, located.controls), k)
                found.append(
                    Jump(shares[i], i, located.changes[k, levels[-1], i], state, control, float(located.times[k]))
                )
        return found


def some(marks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of marks, not more than a few of each column."""
    found = [np.zeros((2, 0), int)]
    for column in range(marks.shape[1]):
        rows = np.flatnonzero(marks[:, column])
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), EACH)).astype(int))]
        found.append(np.stack([rows, np.full(len(rows), column)]))
    rows, columns = np.concatenate(found, axis=1)
    return rows, columns


def largest(jumps: list[Jump]) -> Jump | None:
    """The one that changes most, relative to the size of its entry."""
    return max(jumps, key=lambda jump: jump.share, default=None)


def _along(known: Any, given: Given, line: Lines) -> tuple[Callable[[Array], Any], Callable[[Array], Array]]:
    """The point of a line at a place, and the value there."""
    function, problem, retraction = known
    bound = problem.with_parameters(given[0])

    def point(s: Array) -> tuple[Ambient, Ambient, Array]:
        powers = jnp.stack([s**k for k in range(1, DEGREE + 1)])
        return (
            _moved(retraction, line.states, powers @ line.ways),
            bound.steer(line.controls, s * line.turns),
            line.times + s * line.spans,
        )

    def value(s: Array) -> Array:
        q, u, t = point(s)
        return function(bound.at_time(t), q, u, given[1])

    return point, value


def _moved(retraction: Retraction | None, q: Ambient, way: Array) -> Ambient:
    return q if retraction is None else retraction(q, vec.combine(retraction.manifold.basis(q), way))


def _seen(known: Any, given: Given, lines: Lines) -> tuple[Array, ...]:
    def one(line: Lines) -> tuple[Array, ...]:
        _, value = _along(known, given, line)

        def at(s: Array) -> tuple[Array, ...]:
            (found, margins), (_, slopes) = jax.jvp(lambda s: with_margins(value, s), (s,), (jnp.ones_like(s),))
            return found, *margins, slopes.values

        return jax.vmap(at)(jnp.stack([line.low, line.high]))

    return jax.vmap(one)(lines)


def _slopes(known: Any, given: Given, lines: Lines) -> Array:
    def one(line: Lines) -> Array:
        def margins(way: Array) -> Array:
            there = line._replace(ways=jnp.zeros_like(line.ways).at[0].set(way))
            return with_margins(_along(known, given, there)[1], jnp.ones_like(line.times))[1].values

        return jax.jacfwd(margins)(jnp.zeros_like(line.ways[0]))

    return jax.vmap(one)(lines)


def _located(known: Any, given: Given, lines: Lines, steps: Array, above: Array, crossed: Array) -> Located:
    def one(line: Lines, step: Array, above: Array, crossed: Array) -> Located:
        point, value = _along(known, given, line)

        def margin(s: Array) -> Array:
            return with_margins(value, s)[1].values[step]

        def halved(ends: tuple[Array, Array, Array], _: None) -> tuple[tuple[Array, Array, Array], None]:
            low, high, crossed = ends
            middle = (low + high) / 2
            here, slope = jax.jvp(margin, (middle,), (jnp.ones_like(middle),))
            other = (here >= 0) != above
            # Where both ends are on one side, what is between may be on the other one, about where it is nearest to it.
            beyond = other | (~crossed & (jnp.sign(here) * slope > 0))
            return (jnp.where(beyond, low, middle), jnp.where(beyond, middle, high), crossed | other), None

        def side(s: Array) -> tuple[Array, Array]:
            found, margins = with_margins(value, s)
            return found, margins.values[step]

        begin = jnp.asarray(line.low), jnp.asarray(line.high), crossed
        place = jax.lax.scan(halved, begin, None, jnp.finfo(begin[0].dtype).nmant + 8)[0][1]
        count = int(-np.log(FINEST * tolerance(place, 1.0)) / np.log(CLOSER))
        widths = (begin[1] - begin[0]) * CLOSER ** -jnp.arange(1.0, count + 1, dtype=place.dtype)
        values, margins = jax.vmap(side)(jnp.concatenate([place[None], place - widths, place + widths]))
        changes, sides = values[count + 1 :] - values[1 : count + 1], margins[1:] >= 0
        q, u, t = point(place)
        return Located(q, u, t, margins[0], values[count], changes, sides[:count] != sides[count:])

    return jax.vmap(one)(lines, steps, above, crossed)


def rates(problem: "OptimalControlProblem", q: Ambient, u: Ambient, _: None = None) -> Array:
    """The entries of the velocity, the running cost, and the constraints."""
    q, u = jax.tree.map(jnp.asarray, (q, u))  # functions may ask for what arrays of NumPy lack
    leaves = jax.tree.leaves(problem.velocity(q, u))
    halves = [
        jnp.ravel(half) for leaf in leaves for half in ((leaf.real, leaf.imag) if jnp.iscomplexobj(leaf) else (leaf,))
    ]
    return jnp.concatenate([*halves, jnp.reshape(problem.cost_rate(q, u), (1,)), *problem.limits.of_functions(q, u)])


def rate_names(problem: "OptimalControlProblem") -> list[str]:
    """Of each of these entries the name of its function."""
    count = sum(
        leaf.size * (1 + jnp.issubdtype(leaf.dtype, jnp.complexfloating))
        for leaf in jax.tree.leaves(problem.manifold.ambient)
    )
    limits = problem.at_time(0.0).limits.words_of_entries(problem.manifold.ambient, problem.controls.ambient)
    return [*count * ["dynamics"], "running_cost", *limits]
