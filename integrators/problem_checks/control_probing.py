"""How the functions of a problem depend on the controls, seen at a few of them: curved, flat, or kinked."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...compute.automatic import AutomaticEvaluator
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.numerics.precision import working_precision
from ...manifolds.numerics.tolerances import REGULAR, rounding_of, tolerance
from ..problem.optimal_control_problem import OptimalControlProblem
from ..problem.point_layout import PointLayout
from ..reporting.text import in_line

CURVATURES = 3  # random controls and covectors at which second derivatives are looked at
PROBE_SIZE = 0.3  # size of the coordinates of these controls around the resting one
ACCOUNTS = 1e-3  # of a change of slope: second derivative times distance that is no rounding of a kink
IN_SPACE = 1e-6  # largest distance of a direction from a space that it is in
# How far along a flat line the functions are looked at: no numbers that users write.
DISTANCES = 10.0 ** np.arange(-4.5, 8.5)
LADDER = np.concatenate([[0.0], DISTANCES, -DISTANCES])  # parameters along a line
LASTING_CHANGE, SAME_CHANGE = 3, 1e-2  # places on a line over which a change by a kink lasts, and how much it may vary
HIDDEN_TERMS = 100.0  # times a value: the size of terms that may cancel in it, whose rounding is no kink
PARTS = "dynamics", "running_cost"


class ControlProbe(NamedTuple):
    """The values of the functions of a problem at a point, with the given control and with other controls.

    ``slopes``, shape ``(k, 2, m)``, and ``curvatures``, ``(k, 2, m, m)``, are derivatives of both parts of ``H``,
    ``<p, X>`` and ``F``, by coordinates in the chart around the given control.
    """

    controls: Ambient
    normals: np.ndarray  # size of the normal part of the velocity, with each control
    sizes: np.ndarray  # size of the velocity, with each control
    costs: tuple[np.ndarray, np.ndarray]  # running and terminal, with the first control
    slopes: np.ndarray
    curvatures: np.ndarray
    # Constraints, and their derivatives by the control asked for.
    limits: tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]


def probe(
    problem: OptimalControlProblem, q: Ambient, u: Ambient, directions: np.ndarray, covectors: Ambient
) -> ControlProbe:
    """The functions at ``(q, u)``, and at controls in ``directions`` from ``u``; of ``covectors`` the projections
    count."""
    state, control = PointLayout.of(problem.manifold), PointLayout.of(problem.controls)

    def at(d: Array, first: Array, q: Array, u: Array, c: Array, covector: Array) -> tuple[Any, ...]:
        x, u0 = state.point(q), control.point(u)
        power, rate = parts(problem, x, u0, state.point(covector), c + d)
        moved = problem._steer(u0, c + d)
        own = jnp.stack(_normal_size(problem, x, moved)), jnp.stack([rate, problem.final_cost(x)]), control.flat(moved)
        return jnp.where(first[0] > 0, power, rate), problem._limits.of_functions(x, moved), *own

    m = problem.controls.dimension
    made = AutomaticEvaluator().derivatives(at, m, 1, state.size, control.size, m, state.size)
    points = state.rows(q, 0), control.rows(u, 0)
    coordinates, rows = np.concatenate([np.zeros_like(directions[:1]), directions]), state.rows(covectors, 1)
    each = np.concatenate([rows[:1], rows])
    found = made.at(2, np.array([[[1.0]], [[0.0]]]), *(a[None, None] for a in points), coordinates[None], each[None])
    curvatures, slopes, *others = (a.astype(working_precision()) for a in found)
    count = len(problem._limits.every_name)
    slope, value = (tuple(a[0, 0] for a in others[k : k + count]) for k in (0, count))
    sizes, costs, controls = (a[0] for a in others[2 * count :])
    slopes, curvatures = (a.swapaxes(0, 1) for a in (slopes, curvatures))
    (normals, lengths), (running, final) = sizes.T, costs[0]
    there = control.points(controls)
    return ControlProbe(there, normals, lengths, (running, final), slopes, curvatures, (value, slope))


def parts(problem: OptimalControlProblem, q: Ambient, u: Ambient, covector: Ambient, c: Array) -> Float[Array, " 2"]:
    """``<p, X>`` and ``p_0 F`` at the control with coordinates ``c`` around ``u``."""
    return jnp.stack(problem._parts(q, problem.manifold.projection(q, covector), problem._steer(u, c)))


def flat_directions(slopes: np.ndarray, curvatures: np.ndarray) -> np.ndarray:
    """Directions, shape ``(k, m)``, along which ``H`` has no second derivative but rounding: none where that is not
    finite.

    ``slopes``, shape ``(2, m)``, and ``curvatures`` are those of its two parts, at one control.
    """
    size = curvatures.shape[-1]
    if not np.all(np.isfinite(curvatures)) or not size:
        return np.zeros((0, size))
    rounding = rounding_of(curvatures)
    # Each part by itself: a weak cost is no rounding of strong dynamics, in whatever units the controls are.
    steep = rounding / PROBE_SIZE * np.maximum(np.abs(slopes)[:, :, None], np.abs(slopes)[:, None, :])
    power, cost = np.where(np.abs(curvatures) <= steep, 0.0, curvatures)
    matrix = power - cost
    rows = np.max(np.abs(matrix), axis=1)
    zero = rows <= rounding * np.max(np.abs(power) + np.abs(cost), axis=1)
    units = np.sqrt(np.where(zero, 1.0, rows))
    matrix = np.where(zero[:, None] | zero[None, :], 0.0, matrix) / np.outer(units, units)
    values, vectors = np.linalg.eigh(matrix + np.diag(np.where(zero, 2.0, 0.0)))
    found = vectors[:, np.abs(values) <= tolerance(matrix, REGULAR)].T / units
    found = np.concatenate([np.eye(size)[zero], found])
    return found / np.linalg.norm(found, axis=1, keepdims=True)


class FlatDirection(NamedTuple):
    """A direction in which nothing curves at a control of the probe, and two lines along it: from there, and from rest.

    ``sample``: the number of the control. ``bases``, shape ``(2, m)``; ``curvatures``: ``|d' C d|`` of both parts of
    ``H`` at these, with the rounding of its terms, shape ``(2, 2)``; ``slopes``: the sums of the sizes of the terms of
    their slopes along it, likewise; ``flat``: at which of both nothing curves.
    """

    direction: np.ndarray
    sample: int
    bases: np.ndarray
    curvatures: np.ndarray
    slopes: np.ndarray
    flat: tuple[bool, ...]


def find_flat_directions(probed: ControlProbe, directions: np.ndarray) -> list[list[FlatDirection]]:
    """The flat directions at each of the controls in ``directions``."""
    rest, *others = (flat_directions(*at) for at in zip(probed.slopes, probed.curvatures, strict=True))
    rounding = rounding_of(directions)
    found = list[list[FlatDirection]]()
    for k, ways in enumerate(others):
        found.append([])
        for d in ways:
            here = directions[k], probed.curvatures[k + 1], probed.slopes[k + 1], True
            # Where the flat direction turns with the control, as around a cone, the line from rest is another one.
            constant = all(_contains(other, d) for other in others)
            lines = here, (0 * d, probed.curvatures[0], probed.slopes[0], _contains(rest, d)) if constant else here
            bases, both, slopes = (np.stack([line[i] for line in lines]) for i in (0, 1, 2))
            sizes = np.abs(d @ both @ d) + rounding * (np.abs(d) @ np.abs(both) @ np.abs(d))
            steep, flat = np.abs(slopes) @ np.abs(d), tuple(line[3] for line in lines)
            found[-1].append(FlatDirection(d, k, bases, sizes, steep, flat))
    return found


def _contains(directions: np.ndarray, d: np.ndarray) -> bool:
    """Whether ``d`` lies in the span of directions."""
    return bool(np.linalg.norm(directions.T @ np.linalg.lstsq(directions.T, d)[0] - d) <= IN_SPACE)


class AlongLine(NamedTuple):
    """Both parts of ``H`` and their first two derivatives along both lines of a direction, shape ``(2, s, 2)``, parts
    last."""

    values: Array
    slopes: Array
    curvatures: Array


def along_lines(
    problem: OptimalControlProblem, q: Ambient, u: Ambient, covectors: Ambient, bases: Array, ways: Array, s: Array
) -> AlongLine:
    """The parts of ``H`` along the lines of several directions, with a covector each, at parameters ``s``."""

    def at(covector: Ambient, base: Array, way: Array, s: Array) -> AlongLine:
        def value(s: Array) -> Array:
            return parts(problem, q, u, covector, base + s * way)

        def slope(s: Array) -> tuple[Array, Array]:
            return jax.jvp(value, (s,), (jnp.ones_like(s),))

        (values, slopes), (_, curvatures) = jax.jvp(slope, (s,), (jnp.ones_like(s),))
        return AlongLine(values, slopes, curvatures)

    every = jax.vmap(at, (None, None, None, 0))
    both = jax.vmap(every, (None, 0, None, None))
    return jax.vmap(both, (0, 0, 0, None))(covectors, bases, ways, s)


class Bend(NamedTuple):
    """Where a part of ``H`` is not affine along a line on which nothing curves at first.

    ``part``, ``line`` and ``place``: their numbers; ``jump``: whether its value says so, and not its slope; ``smooth``:
    whether a second derivative that accounts for it is seen on one of the lines.
    """

    part: int
    line: int
    place: int
    jump: bool
    smooth: bool


def find_bend(flat: FlatDirection, found: AlongLine) -> Bend | None:
    """The first part of ``H`` that is not affine along a flat direction, if one is not.

    A smooth function whose second derivative has a constant rank is affine along its null directions.
    """
    for part in range(len(PARTS)):
        for line in np.flatnonzero(flat.flat):
            with np.errstate(all="ignore"):  # far along the line a function may overflow, and is not looked at there
                along = found.values[line, :, part], found.slopes[line, :, part]
                turned, off, jumps = _find_departures(*along, flat.curvatures[line, part], flat.slopes[line, part])
                curves = np.abs(found.curvatures[..., part]) * np.maximum(np.abs(LADDER), np.min(DISTANCES))
            if off.any():
                seen = np.max(curves, where=np.isfinite(curves), initial=0.0)
                return Bend(
                    part, int(line), int(np.argmax(off)), False, bool(seen > ACCOUNTS * np.max(np.abs(turned[off])))
                )
            if jumps.any():
                return Bend(part, int(line), int(np.argmax(jumps)), True, False)
    return None


def _find_departures(
    value: Any, slope: Any, curvature: float, terms: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How a slope changes along a line, where by more than rounding, and where the value does so in another way.

    ``terms``: the sum of the sizes of the terms of the first slope.
    """
    s, rounding = np.abs(LADDER), HIDDEN_TERMS * rounding_of(value)
    value, slope = value.astype(float), slope.astype(float)
    turned, missed = slope - slope[0], value - value[0] - LADDER * slope[0]
    bent = 10 * curvature * s
    # A slope that is a difference, as that of cos^2 + sin^2, is wrong by the rounding of the value, or of its terms.
    steep = max(terms, abs(value[0]) / PROBE_SIZE)
    off = _lasts(turned, bent + rounding * np.maximum(np.abs(slope), steep))
    size, far = rounding * (np.abs(value) + np.abs(value[0]) + s * steep) + bent * s, np.where(s > 0, s, 1.0)
    return turned, off, _lasts(missed, size) | _lasts(missed / far, size / far)


def _lasts(change: np.ndarray, rounding: np.ndarray) -> np.ndarray:
    """The places on a line at which a change lasts outward, because rounding of hidden terms grows from place to
    place."""
    outward = change[1:].reshape(2, -1)
    lasting = np.isfinite(outward) & (np.abs(outward) > rounding[1:].reshape(2, -1))
    for further in range(1, LASTING_CHANGE):
        later = np.concatenate([outward[:, further:], np.full((2, further), np.nan)], axis=1)
        lasting &= np.abs(later - outward) <= SAME_CHANGE * np.abs(outward)
    return np.concatenate([[False], lasting.reshape(-1)])


SMOOTH_COSTS = (
    "u = a - b with the cost a + b instead of |u|, for controls a and b with control_bounds=(0, jnp.inf), which is "
    "exact; or jnp.sqrt(u**2 + d**2), at first with d as large as the controls, then with smaller ones and the last "
    "solution as guess",
    "control_bounds=(-a, a) and u instead of jnp.clip(u, -a, a), or a * jnp.tanh(u / a)",
)


def kink_words(bent: Bend, direction: np.ndarray, slopes: np.ndarray, controls: list[Ambient]) -> str:
    """Words on a kink of ``dynamics`` or ``running_cost``, with their derivatives along a direction at two controls."""
    name, smooth = PARTS[bent.part], SMOOTH_COSTS[0 if PARTS[bent.part] == "running_cost" else 1]
    along = "" if len(direction) == 1 else f" along {np.array2string(direction, precision=3)}"
    change = f"changes by {slopes[1] - slopes[0]:.3g} of {np.max(np.abs(slopes)):.3g}"
    if bent.jump:
        change = "does not account for the change of its value"
    return (
        f"{name} has a kink or a jump in the controls: its second derivative by u{along} is 0 wherever it was looked "
        f"at, and its first one {change} between u = {controls[0]} and u = {controls[1]}; expected a smooth function "
        f"of u, because the conditions dH/du = 0 do not hold at a kink; try {smooth}"
    )


def _normal_size(problem: OptimalControlProblem, q: Ambient, u: Ambient) -> tuple[Array, Array]:
    """Sizes of the normal part of ``X(q, u)``, which is zero for dynamics on the manifold, and of ``X(q, u)``."""
    v = problem.velocity(q, u)
    return vec.size(vec.subtract(v, problem.manifold.projection(q, v))), vec.size(v)


def undefined_words(words: Sequence[str], probed: ControlProbe, q: Ambient) -> str:
    """Words on functions, or derivatives by the controls, that are not finite where they were probed; empty if all
    are."""
    first = int(np.argmin(np.isfinite(probed.sizes)))  # the control that was asked for if all are
    u, size = vec.taken(probed.controls, first), probed.sizes[first]
    point = f"{in_line(q)}, u = {in_line(u)}"
    if not np.all(np.isfinite((size, *probed.costs))):
        return (
            f"the problem's functions are not finite at q = {point}: size of the velocity {size:.3g}, running and "
            f"terminal cost {probed.costs[0]:.3g} and {probed.costs[1]:.3g}; check them there, or pass a guess, or "
            "control_bounds, where they are finite"
        )
    if not np.all(np.isfinite(probed.slopes[0])):
        return (
            f"the problem's functions have no finite derivative by the controls at q = {point}, where the search "
            "begins; try functions that are smooth there, such as u @ u or sqrt(u @ u + 1e-6) instead of sqrt(u @ u), "
            "or pass a guess with other controls"
        )
    for name, values, slopes in zip(words, *probed.limits, strict=True):
        if not (np.all(np.isfinite(values)) and np.all(np.isfinite(slopes))):
            what = "is not finite" if not np.all(np.isfinite(values)) else "has no finite derivative by the controls"
            return (
                f"{name} {what} at q = {point}, where "
                f"its values are {values}; try a function that is smooth also where it is positive, as u @ u - a**2 in "
                "place of sqrt(u @ u) - a"
            )
    return ""
