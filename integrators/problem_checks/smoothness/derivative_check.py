"""Derivatives that do not tell how a function changes, as where ``jax.lax.stop_gradient`` hides a state or a control.

Only functions with a derivative rule of their own are looked at. ``DifferenceQuotients`` moves one of two arguments
along random lines near a point, over spans of many powers of ten, and compares the derivative with the quotients over
the shortest spans that are clear of rounding.
"""

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr
from jaxtyping import Array

from ....compute.automatic import AutomaticEvaluator
from ....compute.base import PointwiseFunction
from ....index_bounds import require_indices
from ....jaxpr_tools import is_in_scalars, name_of
from ....manifolds import InvalidInputError
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.tolerances import rounding_of, tolerance
from ....retractions import Retraction, default_retraction
from ....tracing import one_tracing
from ...problem.boundary_conditions import boundary_words
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.point_layout import parameter_layout
from ...problem.user_functions import real_number
from .step_primitives import dependent_equations, program_of

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
RANDOM_BASES = 3  # random lines near each point, of which the median counts
TRAJECTORY_PLACES = 8  # along a trajectory


@final
class DifferenceQuotients:
    """Compares the derivatives of the entries of ``function(given, *point)`` with differences; traced once.

    ``move(point, way)``: the point moved by coordinates, of which the ``first`` ones of ``count`` move its first
    argument. ``given``, which all points share, and ``point`` are examples.
    """

    def __init__(
        self, function: Callable[..., Array], move: Callable[..., Any], first: int, count: int, given: Any, point: Any
    ) -> None:
        self._function, self._move = function, move
        self._moving = np.arange(count) < np.array([[first], [count]])
        self._moving[1] &= ~self._moving[0]
        self._given, self._point = parameter_layout(given), parameter_layout(point)

    def relative_errors(self, given: Any, points: Any) -> np.ndarray:
        """The share of the change of each entry that its derivative misses, by the first argument and by the second.

        The shape is ``(2, K, E)`` at K points: the median of several lines near each of them.
        """
        rows, draw = self._point.rows(points, 1)[:, None, None], np.random.default_rng(0).standard_normal
        shape = len(rows), RANDOM_BASES, 1, self._moving.shape[1]
        bases, ways = draw(shape), draw(shape) * self._moving[:, None, None, None]
        spans = np.concatenate([[0.0], -DIFFERENCE_SPANS, DIFFERENCE_SPANS])[:, None]
        flat = self._given.rows(given, 0)[None, None, None, None]
        found = self._along.of_any(4, rows[None], bases[None], ways, spans[None, None, None], flat)
        values, slopes = (np.moveaxis(a.astype(self._along.precision, copy=False), 3, 0) for a in found)
        count = 1 + len(DIFFERENCE_SPANS)
        return np.median(_relative_error(values[1:count], values[count:], slopes[0]), axis=2)

    @cached_property
    def _along(self) -> PointwiseFunction:
        n = self._moving.shape[1]
        return AutomaticEvaluator().values(self._value_along, self._point.size, n, n, 1, self._given.size)

    def _value_along(self, row: Array, base: Array, way: Array, place: Array, given: Array) -> tuple[Array, Array]:
        """The values and their derivatives at one place of a line."""
        own, beside = self._given.point(given), self._move(self._point.point(row), POINT_DISTANCE * base)
        value = lambda s: self._function(own, *self._move(beside, s * way))  # noqa: E731
        return jax.jvp(value, (place[0],), (jnp.ones_like(place[0]),))


def _relative_error(below: np.ndarray, above: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """The share of the change of each function that its derivative misses; 0 where that may be rounding.

    ``below`` and ``above``: the values at both sides, for each span along the leading axis.
    """
    spans = DIFFERENCE_SPANS.reshape(-1, *[1] * slopes.ndim)
    with np.errstate(all="ignore"):
        quotients = (above - below) / (2 * spans)
        size = np.abs(slopes) + np.abs(quotients)
        rounding = rounding_of(above) * np.maximum(np.abs(above), np.abs(below)) / spans
        apart = np.abs(quotients - slopes)
        clear = apart > rounding / SETTLED_QUOTIENT
        settled = clear[1:] & clear[:-1] & (np.abs(np.diff(quotients, axis=0)) < SETTLED_QUOTIENT * apart[1:])
        # Values that change over longer spans alone are rounded more coarsely than they are large: their terms cancel.
        still = (above == below) & np.any(above != below, axis=0)
        known = np.isfinite(quotients) & (rounding < tolerance(above, 1 / 3) * size) & ~still
        shares = np.take_along_axis(apart / size, np.argmax(known, axis=0)[None], 0)[0]
    # The shortest spans that are clear of rounding: over longer ones a function may be anything.
    ranks = np.cumsum(known, axis=0)
    shortest = known & (ranks <= LASTING_SPANS)
    tells = (ranks[-1] > LASTING_SPANS) & np.all(settled | ~shortest[:-1], axis=0)
    return np.where(tells, shares, 0.0)


def require_correct_derivatives(problem: OptimalControlProblem, q: Ambient, u: Ambient) -> None:
    """Raise if a function changes near ``q`` or ``u`` in a way that its derivative does not tell."""
    derivatives = DerivativeCheck(problem, None)
    if derivatives:
        points = jax.tree.map(lambda leaf: np.asarray(leaf)[None], (q, u))
        words = derivatives.words((*points, np.zeros(1)), None, [""])
        if words:
            raise InvalidInputError(words)


@final
class DerivativeCheck:
    """Checks at some points whether the derivatives of a problem's functions tell of their values; traced once."""

    def __init__(self, problem: OptimalControlProblem, parameters: Any) -> None:
        self.problem, bound, spaces = problem, problem.with_parameters(parameters), (problem.manifold, problem.controls)
        point = (*(jax.tree.map(lambda s: np.zeros(s.shape, s.dtype), m.ambient) for m in spaces), 0.0)
        self.rules = own_rules(program_of(partial(_values, bound.at_time(0.0)), *point[:2]))

        def values(parameters: Any, q: Ambient, u: Ambient, time: Array) -> Array:
            return _values(problem.with_parameters(parameters).at_time(time), q, u)

        def move(point: Any, way: Array) -> Any:
            retractions = default_retraction(problem.manifold), default_retraction(problem.controls)
            (q, u, time), (along, turn) = point, jnp.split(way, [n])
            return move_along(retractions[0], q, along), move_along(retractions[1], u, turn), time

        n, m = (space.dimension for space in spaces)
        self._quotients = DifferenceQuotients(values, move, n, n + m, parameters, point)

    def __bool__(self) -> bool:
        """Whether a function has rules of its own, or stops derivatives."""
        return bool(self.rules)

    def __call__(self, states: Ambient, controls: Ambient, times: np.ndarray, parameters: Any) -> str:
        """Words on the function whose derivative is off by most along a trajectory; empty if none is."""
        leaves = (leaf.reshape(len(times), -1) for leaf in jax.tree.leaves((states, controls)))
        stages = np.flatnonzero(np.all([np.isfinite(leaf).all(axis=1) for leaf in leaves], axis=0))
        if not (self.rules and len(stages)):
            return ""
        stages = stages[np.linspace(0, len(stages) - 1, TRAJECTORY_PLACES).round().astype(int)]
        points = vec.taken((states, controls, times), stages)
        return self.words(points, parameters, [f" near t = {time:.6g}" for time in points[-1]])

    def words(self, points: tuple[Ambient, Ambient, np.ndarray], parameters: Any, places: list[str]) -> str:
        """Words on that function at some states, controls and times, which have these names."""
        for about, wrong in zip(
            ("states", "controls"), self._quotients.relative_errors(parameters, points), strict=True
        ):
            place, entry = np.unravel_index(np.argmax(wrong), wrong.shape)
            if wrong[place, entry] > 0:
                bound, first = self.problem.with_parameters(parameters).at_time(0.0), vec.taken(points[0], 0)
                return (
                    f"{_names(bound, first)[entry]} changes with the {about} at another rate than its "
                    f"derivative{places[place]}, which is off by {wrong[place, entry]:.1e} of it, where the functions "
                    f"use {' and '.join(self.rules)}; expected the derivatives of the values, because dH/du = 0 and "
                    "the costates are made of them; try it without, or a rule that agrees with the values"
                )
        return ""


def require_correct_hamiltonian_derivatives(
    hamiltonian: Callable[[Ambient, Ambient], Any], retraction: Retraction, q: Ambient, p: Ambient
) -> None:
    """Raise if the derivative of a Hamiltonian near ``(q, p)`` disagrees with its values, or if an index is out of
    bounds."""

    def read() -> tuple[list[str], Any]:
        program = program_of(hamiltonian, q, p)
        require_indices(program, "the Hamiltonian")
        return own_rules(program), hamiltonian

    with one_tracing() as reading:
        rules = reading.once(("rules of", id(hamiltonian)), read)[0]
    if not rules:
        return

    n = retraction.manifold.dimension

    def move(point: Any, way: Array) -> Any:
        q, p = point
        frame = retraction.manifold.basis(q)
        units = jnp.maximum(jnp.abs(vec.components(frame, p)), POINT_DISTANCE)
        return move_along(retraction, q, way[:n]), vec.add(p, vec.combine(frame, way[n:] * units))

    def value(_: None, q: Ambient, p: Ambient) -> Array:
        return real_number("the Hamiltonian", hamiltonian(q, p))[None]

    missed = DifferenceQuotients(value, move, n, 2 * n, None, (q, p)).relative_errors(None, vec.taken((q, p), None))
    for about, wrong in zip(("states", "momenta"), missed[:, 0, 0], strict=True):
        if wrong > 0:
            raise InvalidInputError(
                f"the Hamiltonian changes with the {about} at another rate than its derivative, which is off by "
                f"{wrong:.1e} of it, where it uses {' and '.join(rules)}; expected the derivatives of the values, "
                "because Hamilton's equations are made of them; try it without, or a rule that agrees with the values"
            )


def own_rules(program: ClosedJaxpr) -> list[str]:
    """The computations of a program from its arguments that have a derivative rule of their own, or none, each once."""
    rules = (MADE_BY.get(name_of(own)) for own in dependent_equations(program.jaxpr) if not is_in_scalars(own))
    return list(dict.fromkeys(filter(None, rules)))


def move_along(retraction: Retraction, x: Ambient, way: Array) -> Ambient:
    """The point in a direction of the chart, in units of the sizes of the coordinates."""
    frame = retraction.manifold.basis(x)
    return retraction(x, vec.combine(frame, way * jnp.maximum(vec.coordinate_sizes(frame, x), POINT_DISTANCE)))


def _values(problem: OptimalControlProblem, q: Ambient, u: Ambient) -> Array:
    """The entries of all functions in a row, with one point for both ends."""
    costs = [problem.cost_rate(q, u), problem.final_cost(q), problem._start_cost(q)]
    velocity = [jnp.real(leaf).ravel() for leaf in jax.tree.leaves(problem.velocity(q, u))]
    return jnp.concatenate(
        [*velocity, jnp.stack(costs), *problem._limits.of_functions(q, u), problem._boundary.values(q, q)]
    )


def _names(problem: OptimalControlProblem, q: Ambient) -> list[str]:
    """The name of the function of each of these entries."""
    count = sum(leaf.size for leaf in jax.tree.leaves(problem.manifold.ambient))
    limits = problem._limits.words_of_entries(problem.manifold.ambient, problem.controls.ambient)
    ends = [
        boundary_words(name)
        for name, values in zip(problem._boundary.names, jax.eval_shape(problem._boundary.each, q, q), strict=True)
        for _ in range(values.size)
    ]
    return [*count * ["dynamics"], "running_cost", "terminal_cost", "initial_cost", *limits, *ends]
