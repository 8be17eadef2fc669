"""Derivatives that do not tell how a function changes, as where ``jax.lax.stop_gradient`` hides a state or a
control."""

from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr
from jaxtyping import Array

from ....compute.automatic import AutomaticEvaluator
from ....compute.base import PointwiseFunction
from ....jaxpr_tools import is_in_scalars, name_of
from ....manifolds import InvalidInputError
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.tolerances import rounding_of, tolerance
from ....retractions import default_retraction
from ...problem.boundary_conditions import boundary_words
from ...problem.point_layout import PointLayout, parameter_layout
from .step_primitives import dependent_equations, program_of

if TYPE_CHECKING:
    from ...problem.optimal_control_problem import OptimalControlProblem

MADE_BY = {
    "stop_gradient": "jax.lax.stop_gradient",
    "custom_jvp_call": "jax.custom_jvp",
    "custom_vjp_call": "jax.custom_vjp",
    # Since JAX 0.11.
    "CustomJVPTraced": "jax.custom_jvp",
    "CustomVJPTraced": "jax.custom_vjp",
    "CustomRoot": "jax.lax.custom_root",
}
DIFFERENCE_SPANS = 10.0 ** np.arange(-11.5, 1.0)  # of the sizes of coordinates: how far the functions are looked at
POINT_DISTANCE = 1e-3  # of these sizes: not where a user begins, which may be at a kink
# Difference quotients over neighbouring spans that change by less of what the derivative misses.
SETTLED_QUOTIENT, LASTING_SPANS = 0.1, 2
RANDOM_BASES = 3
TRAJECTORY_PLACES = 8  # along a trajectory


class Line(NamedTuple):
    """The values of all functions along a line, at distances ``-s`` and ``s`` from its middle, and the derivatives
    there."""

    below: Any
    above: Any
    slopes: Any


def require_correct_derivatives(problem: "OptimalControlProblem", q: Ambient, u: Ambient) -> None:
    """Raise if a function changes near ``q`` or ``u`` in a way that its derivative does not tell.

    Only functions that have rules of their own for derivatives, or stop some, are looked at.
    """
    derivatives = DerivativeCheck(problem, None)
    if derivatives:
        points = jax.tree.map(lambda leaf: np.asarray(leaf)[None], (q, u))
        words = derivatives.words((*points, np.zeros(1)), None, [""])
        if words:
            raise InvalidInputError(words)


@final
class DerivativeCheck:
    """Looks at some points whether the derivatives of a problem's functions tell of their values; traced once."""

    def __init__(self, problem: "OptimalControlProblem", parameters: Any) -> None:
        self.problem, bound = problem, problem.with_parameters(parameters).at_time(0.0)
        points = (
            jax.tree.map(lambda s: np.zeros(s.shape, s.dtype), m.ambient) for m in (problem.manifold, problem.controls)
        )
        self.rules = own_rules(program_of(partial(_values, bound), *points))
        self.state, self.control = PointLayout.of(problem.manifold), PointLayout.of(problem.controls)
        self._given = parameter_layout(parameters)

    def __bool__(self) -> bool:
        """Whether a function has rules of its own, or stops derivatives."""
        return bool(self.rules)

    def __call__(self, states: Ambient, controls: Ambient, times: np.ndarray, parameters: Any) -> str:
        """Words on the function whose derivative is off by most along a trajectory; empty if none is."""
        known = np.all(
            [np.isfinite(leaf.reshape(len(times), -1)).all(axis=1) for leaf in jax.tree.leaves((states, controls))],
            axis=0,
        )
        stages = np.flatnonzero(known)
        if not (self.rules and len(stages)):
            return ""
        stages = stages[np.linspace(0, len(stages) - 1, TRAJECTORY_PLACES).round().astype(int)]
        points = vec.taken((states, controls, times), stages)
        return self.words(points, parameters, [f" near t = {time:.6g}" for time in points[-1]])

    def words(self, points: tuple[Ambient, Ambient, np.ndarray], parameters: Any, places: list[str]) -> str:
        """Words on that function at some states, controls and times, which have these names."""
        bound, first = self.problem.with_parameters(parameters).at_time(0.0), vec.taken(points[0], 0)
        for about, line in zip(("states", "controls"), self._lines(points, parameters), strict=True):
            wrong = median_missed_share(line)
            place, entry = np.unravel_index(np.argmax(wrong), wrong.shape)
            if wrong[place, entry] > 0:
                return (
                    f"{_names(bound, first)[entry]} changes with the {about} at another rate than its "
                    f"derivative{places[place]}, which is off by {wrong[place, entry]:.1e} of it, where the functions "
                    f"use {' and '.join(self.rules)}; expected the derivatives of the values, because dH/du = 0 and "
                    "the costates are made of them; try it without, or a rule that agrees with the values"
                )
        return ""

    def _lines(self, points: tuple[Ambient, Ambient, np.ndarray], parameters: Any) -> list[Line]:
        """Lines through several points near each state and control, along which the one, or the other, moves."""
        draw, count = np.random.default_rng(0).standard_normal, len(points[-1])
        rows = self.state.rows(points[0], 1), self.control.rows(points[1], 1), points[2][:, None]
        moves = [draw((count, RANDOM_BASES, 2, m.dimension)) for m in (self.problem.manifold, self.problem.controls)]
        spans = np.concatenate([[0.0], -DIFFERENCE_SPANS, DIFFERENCE_SPANS])[:, None]
        given = self._given.rows(parameters, 0)
        own = *(a[:, None, None] for a in rows), *(a.reshape(count, RANDOM_BASES, 1, -1) for a in moves)
        found = self._along.of_any(3, *own, spans[None, None], given[None, None, None])
        found = [a.astype(self._along.precision, copy=False) for a in found]
        below, above = slice(1, 1 + len(DIFFERENCE_SPANS)), slice(1 + len(DIFFERENCE_SPANS), None)
        return [Line(a[:, :, below], a[:, :, above], b[:, :, 0]) for a, b in (found[:2], found[2:])]

    @cached_property
    def _along(self) -> PointwiseFunction:
        n, m = self.problem.manifold.dimension, self.problem.controls.dimension
        sizes = self.state.size, self.control.size, 1, 2 * n, 2 * m, 1, self._given.size
        return AutomaticEvaluator().values(self._values_along, *sizes)

    def _values_along(self, *line: Array) -> tuple[Array, ...]:
        """The values of all functions, and their derivatives, at one place of a line of states and of one of
        controls."""
        state, control, time, ways, turns, place, given = line
        way, turn, q, u = (
            ways.reshape(2, -1),
            turns.reshape(2, -1),
            self.state.point(state),
            self.control.point(control),
        )
        bound = self.problem.with_parameters(self._given.point(given)).at_time(time[0])
        retraction, steered = default_retraction(self.problem.manifold), default_retraction(self.problem.controls)
        base, beside = (
            moved_along(retraction, q, POINT_DISTANCE * way[0]),
            moved_along(steered, u, POINT_DISTANCE * turn[0]),
        )

        def by_state(s: Array) -> Array:
            return _values(bound, moved_along(retraction, base, s * way[1]), beside)

        def by_control(s: Array) -> Array:
            return _values(bound, base, moved_along(steered, beside, s * turn[1]))

        one = jnp.ones_like(place[0])
        return *jax.jvp(by_state, (place[0],), (one,)), *jax.jvp(by_control, (place[0],), (one,))


def own_rules(program: ClosedJaxpr) -> list[str]:
    """The computations of a program from its arguments that have a derivative rule of their own, or none, each once."""
    rules = (MADE_BY.get(name_of(own)) for own in dependent_equations(program.jaxpr) if not is_in_scalars(own))
    return list(dict.fromkeys(filter(None, rules)))


def median_missed_share(line: Any) -> np.ndarray:
    """The share of the change of each function that its derivative misses, the median along several lines."""
    below, above = (np.moveaxis(part, -2, 0).reshape(len(DIFFERENCE_SPANS), -1) for part in (line.below, line.above))
    return np.median(_missed_share(below, above, np.ravel(line.slopes)).reshape(line.slopes.shape), axis=-2)


def _missed_share(below: np.ndarray, above: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """The share of the change of each function that its derivative misses; 0 where that may be rounding."""
    with np.errstate(all="ignore"):
        quotients = (above - below) / (2 * DIFFERENCE_SPANS[:, None])
        size = np.abs(slopes) + np.abs(quotients)
        rounding = rounding_of(above) * np.maximum(np.abs(above), np.abs(below)) / DIFFERENCE_SPANS[:, None]
        apart = np.abs(quotients - slopes)
        clear = apart > rounding / SETTLED_QUOTIENT
        settled = clear[1:] & clear[:-1] & (np.abs(np.diff(quotients, axis=0)) < SETTLED_QUOTIENT * apart[1:])
        known = np.isfinite(quotients) & (rounding < tolerance(above, 1 / 3) * size)
        shares = np.take_along_axis(apart / size, np.argmax(known, axis=0)[None], 0)[0]
    # The shortest spans that are clear of rounding: over longer ones a function may be anything.
    ranks = np.cumsum(known, axis=0)
    shortest = known & (ranks <= LASTING_SPANS)
    tells = (ranks[-1] > LASTING_SPANS) & np.all(settled | ~shortest[:-1], axis=0)
    return np.where(tells, shares, 0.0)


def moved_along(retraction: Any, x: Ambient, way: Array) -> Ambient:
    """The point in a direction of the chart, in units of the sizes of the coordinates."""
    frame = retraction.manifold.basis(x)
    return retraction(x, vec.combine(frame, way * jnp.maximum(vec.coordinate_sizes(frame, x), POINT_DISTANCE)))


def _values(problem: "OptimalControlProblem", q: Ambient, u: Ambient) -> Array:
    """The entries of all functions in a row, with one point for both ends."""
    costs = [problem.cost_rate(q, u), problem.final_cost(q), problem.first_cost(q)]
    velocity = [jnp.real(leaf).ravel() for leaf in jax.tree.leaves(problem.velocity(q, u))]
    return jnp.concatenate(
        [*velocity, jnp.stack(costs), *problem._limits.of_functions(q, u), problem._boundary.values(q, q)]
    )


def _names(problem: "OptimalControlProblem", q: Ambient) -> list[str]:
    """The name of the function of each of these entries."""
    count = sum(leaf.size for leaf in jax.tree.leaves(problem.manifold.ambient))
    limits = problem._limits.words_of_entries(problem.manifold.ambient, problem.controls.ambient)
    ends = [
        boundary_words(name)
        for name, values in zip(problem._boundary.names, jax.eval_shape(problem._boundary.each, q, q), strict=True)
        for _ in range(values.size)
    ]
    return [*count * ["dynamics"], "running_cost", "terminal_cost", "initial_cost", *limits, *ends]
