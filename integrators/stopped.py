"""Derivatives that do not tell how a function changes, as where ``jax.lax.stop_gradient`` hides a state or a
control."""

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..equations import is_in_scalars, name_of
from ..manifolds import InvalidInputError
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.precision import working_precision
from ..manifolds.numerics.tolerances import rounding_of, tolerance
from ..retractions import default_retraction
from .boundary_conditions import boundary_words
from .compilation import call_compiled, held
from .jumps import dependent

if TYPE_CHECKING:
    from .problem import OptimalControlProblem

MADE_BY = {
    "stop_gradient": "jax.lax.stop_gradient",
    "custom_jvp_call": "jax.custom_jvp",
    "custom_vjp_call": "jax.custom_vjp",
    # Since JAX 0.11.
    "CustomJVPTraced": "jax.custom_jvp",
    "CustomVJPTraced": "jax.custom_vjp",
    "CustomRoot": "jax.lax.custom_root",
}
SPANS = 10.0 ** np.arange(-11.5, 1.0)  # of the sizes of coordinates: how far the functions are looked at
MOVE = 1e-3  # of these sizes: not where a user begins, which may be at a kink
# Difference quotients over neighbouring spans that change by less of what the derivative misses.
SETTLED, LASTS = 0.1, 2
BASES = 3
PLACES = 8  # along a trajectory


class Line(NamedTuple):
    """The values of all functions along a line, at distances ``-s`` and ``s`` from its middle, and the derivatives
    there."""

    below: Array
    above: Array
    slopes: Array


def require_true_derivatives(problem: "OptimalControlProblem", q: Ambient, u: Ambient) -> None:
    """Raise if a function changes near ``q`` or ``u`` in a way that its derivative does not tell.

    Only functions that have rules of their own for derivatives, or stop some, are looked at.
    """
    found = own_rules(partial(_values, problem), q, u)
    if found:
        lines = call_compiled(_lines, problem, q, u, *_moves(problem, (BASES,)), SPANS.astype(working_precision()))[0]
        words = _words(problem, q, vec.taken(lines, None), found, [""])
        if words:
            raise InvalidInputError(words)


@final
class TrueDerivatives:
    """Looks at some points of trajectories whether the derivatives of a problem's functions tell of their values;
    traced once."""

    def __init__(self, problem: "OptimalControlProblem", parameters: Any) -> None:
        self.problem, bound = problem, problem.with_parameters(parameters).at_time(0.0)
        points = (
            jax.tree.map(lambda s: np.zeros(s.shape, s.dtype), m.ambient) for m in (problem.manifold, problem.controls)
        )
        self.rules = own_rules(partial(_values, bound), *points)
        self._traced = held(self._lines)

    def __bool__(self) -> bool:
        """Whether a function has rules of its own, or stops derivatives."""
        return bool(self.rules)

    def __call__(self, states: Ambient, controls: Ambient, times: np.ndarray, parameters: Any) -> str:
        """Words on the function whose derivative is off by most; empty if none is."""
        known = np.all(
            [np.isfinite(leaf.reshape(len(times), -1)).all(axis=1) for leaf in jax.tree.leaves((states, controls))],
            axis=0,
        )
        stages = np.flatnonzero(known)
        if not (self.rules and len(stages)):
            return ""
        stages = stages[np.linspace(0, len(stages) - 1, PLACES).round().astype(int)]
        q, u, t = vec.taken((states, controls, times), stages)
        lines: Any = jax.tree.map(np.asarray, self._traced(parameters, q, u, t, *_moves(self.problem, (PLACES, BASES))))
        bound, first = self.problem.with_parameters(parameters).at_time(0.0), vec.taken(q, 0)
        return _words(bound, first, lines, self.rules, [f" near t = {time:.6g}" for time in t])

    def _lines(self, parameters: Any, *points: Any) -> tuple[Line, Line]:
        bound, spans = self.problem.with_parameters(parameters), jnp.asarray(SPANS, working_precision())
        return jax.vmap(lambda q, u, t, ways, turns: _lines(bound.at_time(t), q, u, ways, turns, spans))(*points)


def _moves(problem: "OptimalControlProblem", count: tuple[int, ...]) -> list[np.ndarray]:
    """Random directions of states and of controls, two for each line."""
    draw = np.random.default_rng(0).standard_normal
    return [draw((*count, 2, m.dimension)).astype(working_precision()) for m in (problem.manifold, problem.controls)]


def _words(problem: "OptimalControlProblem", q: Ambient, lines: Any, found: list[str], places: list[str]) -> str:
    """What is said of the lines near some places, along which states and along which controls move."""
    for about, line in zip(("states", "controls"), lines, strict=True):
        wrong = usually_missed(line)
        place, entry = np.unravel_index(np.argmax(wrong), wrong.shape)
        if wrong[place, entry] > 0:
            return (
                f"{_names(problem, q)[entry]} changes with the {about} at another rate than its "
                f"derivative{places[place]}, which is off by {wrong[place, entry]:.1e} of it, where the functions use "
                f"{' and '.join(found)}; expected the derivatives of the values, because dH/du = 0 and the costates "
                "are made of them; try it without, or a rule that agrees with the values"
            )
    return ""


def own_rules(function: Any, *arguments: Any) -> list[str]:
    """What a function computes from its arguments that has a rule of its own for derivatives, or none, each once."""
    rules = (MADE_BY.get(name_of(own)) for own in dependent(function, *arguments) if not is_in_scalars(own))
    return list(dict.fromkeys(filter(None, rules)))


def usually_missed(line: Any) -> np.ndarray:
    """Of each function the share of its change that is not in its derivative, the middle one of those along several
    lines."""
    below, above = (np.moveaxis(part, -2, 0).reshape(len(SPANS), -1) for part in (line.below, line.above))
    return np.median(_missed(below, above, np.ravel(line.slopes)).reshape(line.slopes.shape), axis=-2)


def _missed(below: np.ndarray, above: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Of each function the share of its change that is not in its derivative; 0 where that may be rounding."""
    with np.errstate(all="ignore"):
        quotients = (above - below) / (2 * SPANS[:, None])
        size = np.abs(slopes) + np.abs(quotients)
        rounding = rounding_of(above) * np.maximum(np.abs(above), np.abs(below)) / SPANS[:, None]
        apart = np.abs(quotients - slopes)
        clear = apart > rounding / SETTLED
        settled = clear[1:] & clear[:-1] & (np.abs(np.diff(quotients, axis=0)) < SETTLED * apart[1:])
        known = np.isfinite(quotients) & (rounding < tolerance(above, 1 / 3) * size)
        shares = np.take_along_axis(apart / size, np.argmax(known, axis=0)[None], 0)[0]
    # The shortest spans that are clear of rounding: over longer ones a function may be anything.
    ranks = np.cumsum(known, axis=0)
    shortest = known & (ranks <= LASTS)
    tells = (ranks[-1] > LASTS) & np.all(settled | ~shortest[:-1], axis=0)
    return np.where(tells, shares, 0.0)


def _lines(
    problem: "OptimalControlProblem", q: Ambient, u: Ambient, ways: Array, turns: Array, spans: Array
) -> tuple[Line, Line]:
    """Lines through several points near a state and a control, along which the one and the other moves."""

    def one(way: Array, turn: Array) -> tuple[Line, Line]:
        retraction, steered = default_retraction(problem.manifold), default_retraction(problem.controls)
        base, control = near(retraction, q, MOVE * way[0]), near(steered, u, MOVE * turn[0])

        def by_state(s: Array) -> Array:
            return _values(problem, near(retraction, base, s * way[1]), control)

        def by_control(s: Array) -> Array:
            return _values(problem, base, near(steered, control, s * turn[1]))

        return along_line(by_state, spans), along_line(by_control, spans)

    return jax.vmap(one)(ways, turns)


def along_line(value: Any, spans: Array) -> Line:
    slope = jax.jvp(value, (jnp.zeros_like(spans[0]),), (jnp.ones_like(spans[0]),))[1]
    return Line(jax.vmap(value)(-spans), jax.vmap(value)(spans), slope)


def near(retraction: Any, x: Ambient, way: Array) -> Ambient:
    """The point in a direction of the chart, in units of the sizes of the coordinates."""
    frame = retraction.manifold.basis(x)
    return retraction(x, vec.combine(frame, way * jnp.maximum(vec.coordinate_sizes(frame, x), MOVE)))


def _values(problem: "OptimalControlProblem", q: Ambient, u: Ambient) -> Array:
    """The entries of all functions in a row, those of both ends with one point for both."""
    costs = [problem.cost_rate(q, u), problem.final_cost(q), problem.first_cost(q)]
    velocity = [jnp.real(leaf).ravel() for leaf in jax.tree.leaves(problem.velocity(q, u))]
    return jnp.concatenate(
        [*velocity, jnp.stack(costs), *problem.limits.of_functions(q, u), problem.boundary.values(q, q)]
    )


def _names(problem: "OptimalControlProblem", q: Ambient) -> list[str]:
    """Of each of these entries the name of its function."""
    count = sum(leaf.size for leaf in jax.tree.leaves(problem.manifold.ambient))
    limits = problem.limits.words_of_entries(problem.manifold.ambient, problem.controls.ambient)
    ends = [
        boundary_words(name)
        for name, values in zip(problem.boundary.names, jax.eval_shape(problem.boundary.each, q, q), strict=True)
        for _ in range(values.size)
    ]
    return [*count * ["dynamics"], "running_cost", "terminal_cost", "initial_cost", *limits, *ends]
