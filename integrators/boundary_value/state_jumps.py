"""Jumps in the states, and in a time that is not given: whether a trajectory passes one, which no costate tells of."""

from collections.abc import Callable
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...retractions import Retraction
from ..compilation import call_compiled
from ..constraints import constraint_words
from ..jumps import steps_in
from ..kinks import JUMP, Zoom, closing_in, is_jump
from ..problem import OptimalControlProblem
from .engine.layout import Layout
from .solution import Solution

POINTS = 4  # for each stage: between which the functions are looked at
EDGE = 1e-3  # of a step: not where it begins and ends, so that an end on a jump is none that is passed
MOST = 256  # segments and entries in which a jump is looked for more closely
ROUNDING = 1e4  # times the machine epsilon, of the largest entry of an array: a smaller change may be rounding of its terms


class _Segments(NamedTuple):
    """From K points of a trajectory to the next ones: coordinates of these in charts there; and the controls there."""

    states: Ambient
    controls: Ambient
    ways: np.ndarray  # (K, n)
    times: np.ndarray  # (K,)
    spans: np.ndarray  # (K,)


@final
class StateJumps:
    """Looks for jumps of the functions of a problem along its solutions.

    ``timed``: whether jumps in an explicit time count, as they do where the horizon is free and shifts them.
    """

    def __init__(self, problem: OptimalControlProblem, timed: bool) -> None:
        self.problem, self.timed = problem, timed
        self.state = Layout.of(problem.manifold)
        self._steps: list[str] | None = None

    def steps(self, parameters: Any) -> list[str]:
        """What the functions compute from states that may jump; looked at once."""
        if self._steps is None:
            bound = self.problem.with_parameters(parameters)
            q, u = (jax.tree.map(lambda s: np.zeros(s.shape, s.dtype), m.ambient) for m in (bound.manifold, bound.controls))
            given = (q, 0.0) if self.timed else (q,)
            self._steps = steps_in(lambda q, t=0.0: _values(bound.at_time(t), q, u), *given)
        return self._steps

    def __call__(self, solution: Solution) -> str:
        """Words on the largest jump that a trajectory passes; empty if it passes none."""
        steps = self.steps(solution.parameters)
        if not steps or solution.interpolant is None:
            return ""
        given = self.problem, solution.interpolant.retraction, solution.parameters
        segments = self._segments(solution)
        if not len(segments.times):
            return ""
        seen: Any = jax.tree.map(np.asarray, call_compiled(_ends, *given, *segments)[0])
        sizes, rounding = self._sizes(seen[0])
        with np.errstate(all="ignore"):
            missing = np.abs(seen[0][:, 1] - seen[0][:, 0] - seen[1].mean(axis=1))
            share = np.nan_to_num(np.where(missing > rounding, missing / sizes, 0.0))
        order = np.argsort(share, axis=None)[::-1][:MOST]
        where, entry = np.unravel_index(order[share.ravel()[order] > JUMP], share.shape)
        if not len(where):
            return ""
        own = jax.tree.map(lambda leaf: leaf[where], segments)
        zoom: Any = jax.tree.map(np.asarray, call_compiled(_closer, *given, *own, entry)[0])
        return self._words(given, own, zoom, (entry, sizes, rounding), steps)

    def _words(
        self, given: tuple[Any, Retraction, Any], own: _Segments, zoom: Any, known: tuple[np.ndarray, ...], steps: list[str]
    ) -> str:
        entry, sizes, rounding = known
        worst, found = 0.0, None
        for k, i in enumerate(entry):
            change = abs(float(zoom.changes[k, -1]))
            large = change > max(JUMP * sizes[i], rounding[i])
            if large and is_jump(zoom.widths[k], zoom.changes[k], float(sizes[i])) and change / sizes[i] > worst:
                worst, found = change / sizes[i], k
        if found is None:
            return ""
        name = _names(self.problem.with_parameters(given[2]), self.state.size)[entry[found]]
        base, place = (jax.tree.map(lambda leaf: leaf[found], part) for part in (own.states, own.ways * zoom.places[:, -1:]))
        q = jax.tree.map(lambda a: np.array2string(np.asarray(a), precision=6), _moved(given[1], base, jnp.asarray(place)))
        time = own.times[found] + own.spans[found] * zoom.places[found, -1]
        return (
            f"{name} jumps by {zoom.changes[found, -1]:.3g} where the trajectory passes q = {_joined(q)}"
            f"{f' near t = {time:.6g}' if self.timed else ''}: it computes {' and '.join(steps)} from "
            f"{'states and times' if self.timed else 'states'}, and no derivative tells of the jump; expected functions without "
            "jumps along the trajectory, because the costates jump there too, and these do not; try jnp.tanh(x / a) with a small "
            "a in place of a step, or solve_phases, with one phase on each side that ends where the jump is"
        )

    def _segments(self, solution: Solution) -> _Segments:
        """The segments between points of the trajectory where they are known."""
        interpolant: Any = solution.interpolant
        count = POINTS * len(solution.stage_times) // solution.steps
        found = interpolant.within(solution, np.linspace(EDGE, 1 - EDGE, count + 1))
        times = found.times.ravel()
        q, u = (jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), part) for part in (found.states, found.controls))
        rows = self.state.rows(q, 1)
        ways = interpolant.chart.coordinates(rows[:-1], rows[1:])
        leaves = [np.asarray(leaf)[:-1].reshape(len(ways), -1) for leaf in jax.tree.leaves((q, u))]
        known = np.all([np.all(np.isfinite(a), axis=1) for a in (*leaves, ways)], axis=0)
        spans = np.diff(times) if self.timed else 0 * times[1:]
        whole = _Segments(jax.tree.map(lambda a: a[:-1], q), jax.tree.map(lambda a: a[:-1], u), ways, times[:-1], spans)
        return jax.tree.map(lambda leaf: leaf[known], whole)

    def _sizes(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of each entry of the functions the size along the trajectory, and that of the rounding in it."""
        sizes = np.max(np.abs(np.where(np.isfinite(values), values, 0.0)), axis=(0, 1))
        largest = sizes.copy()
        for place in self.state.places:
            largest[place] = np.max(sizes[place], initial=0.0)
        return np.where(sizes > 0, sizes, 1.0), ROUNDING * np.finfo(values.dtype).eps * largest


def _values(problem: OptimalControlProblem, q: Ambient, u: Ambient) -> Array:
    """The entries of the velocity, the running cost, and the constraints."""
    velocity = Layout.of(problem.manifold).flat(problem.velocity(q, u))
    return jnp.concatenate([velocity, jnp.reshape(problem.cost_rate(q, u), (1,)), *problem.limits.of_functions(q, u)])


def _names(problem: OptimalControlProblem, count: int) -> list[str]:
    """Of each of these entries the name of its function."""
    limits = [constraint_words(name) for name, size in problem.at_time(0.0).inequality_sizes.items() for _ in range(size or 1)]
    return [*count * ["dynamics"], "running_cost", *limits]


def _moved(retraction: Retraction, q: Ambient, way: Array) -> Ambient:
    return retraction(q, vec.combine(retraction.manifold.basis(q), way))


def _ends(problem: OptimalControlProblem, retraction: Retraction, parameters: Any, *segments: Any) -> tuple[Array, Array]:
    """The values at both ends of segments, and their slopes there, shape ``(K, 2, entries)``."""

    def one(*segment: Any) -> tuple[Array, Array]:
        value = _along(problem, retraction, parameters, *segment)
        return jax.vmap(lambda s: jax.jvp(value, (s,), (jnp.ones_like(s),)))(jnp.array([0.0, 1.0]))

    return jax.vmap(one)(*segments)


def _closer(problem: OptimalControlProblem, retraction: Retraction, parameters: Any, *given: Any) -> Zoom:
    """Intervals that close in on where an entry of the values changes, of a segment each."""

    def one(*given: Any) -> Zoom:
        *segment, entry = given
        value = _along(problem, retraction, parameters, *segment)
        return closing_in(lambda s: jax.jvp(lambda s: value(s)[entry], (s,), (jnp.ones_like(s),)), jnp.zeros(()), jnp.ones(()))

    return jax.vmap(one)(*given)


def _along(
    problem: OptimalControlProblem,
    retraction: Retraction,
    parameters: Any,
    q: Ambient,
    u: Ambient,
    way: Array,
    t: Array,
    span: Array,
) -> Callable[[Array], Array]:
    """The values along a segment, with the control of where it begins."""
    bound = problem.with_parameters(parameters)
    return lambda s: _values(bound.at_time(t + s * span), _moved(retraction, q, s * way), u)


def _joined(words: Any) -> str:
    leaves = jax.tree.leaves(words)
    return leaves[0] if len(leaves) == 1 else f"({', '.join(leaves)})"
