"""Whether the costs of a problem tell one curve from another, seen at random points with random controls."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

from ...compute.automatic import AutomaticEvaluator
from ...manifolds import InvalidInputError
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.numerics.precision import working_precision
from ...manifolds.numerics.tolerances import rounding_of
from ...retractions import default_retraction
from ..problem.argument_errors import HORIZON
from ..problem.optimal_control_problem import OptimalControlProblem
from ..problem.point_layout import PointLayout
from .control_probing import CURVATURES


def require_cost(
    problem: OptimalControlProblem, around: tuple[Ambient, Ambient, np.ndarray], end: Ambient, fixed: tuple[bool, ...]
) -> None:
    """Raise unless both costs are a number each, around a state, a control, and coordinates of nearby controls."""
    q, u, near = around
    directions = np.concatenate([size * near for size in (1, 1e2, 1e4)])
    moves = (
        np.random.default_rng(0).standard_normal((CURVATURES + 1, problem.manifold.dimension)).astype(directions.dtype)
    )
    moves[0] = 0.0
    costs, slopes = _cost_rates(problem, q, moves, u, directions)
    if problem.abnormal or problem._starts_with_cost or not _is_one_number(costs, np.max(slopes)):
        return
    terminal = "no terminal cost of a free end is given"
    if problem.terminal_cost is not None and not (fixed and all(fixed)):
        ends, tilts = _terminal(problem, _points(problem, end, fixed))
        if not _is_one_number(ends, max(np.max(np.abs(tilt)) for tilt in _free_leaves(tilts, fixed))):
            return
        terminal = f"the terminal cost is {float(ends[0]):.6g} at every end"
    raise InvalidInputError(
        f"the running cost is {float(costs[0, 0]):.6g} at every state and control that was tried, and {terminal}: over "
        "a fixed horizon all curves from start to end then cost the same, and none is the solution; expected a cost of "
        f"states or controls, such as u @ u / 2; if time is to be short, {HORIZON}"
    )


def is_steep(problem: OptimalControlProblem, fixed: tuple[bool, ...] = ()) -> bool:
    """Whether an entry of the differential of the terminal cost is one number, not zero, in an array that is not
    ``fixed``."""
    if problem.terminal_cost is None:
        return False
    _, tilts = _terminal(problem, _points(problem, problem.manifold.random_point(jax.random.key(1))))
    return any(
        bool(np.any((a[0] != 0) & np.all(np.abs(a - a[0]) <= rounding_of(a) * np.abs(a[0]), axis=0)))
        for a in _free_leaves(tilts, fixed)
    )


def _points(problem: OptimalControlProblem, q: Ambient, fixed: tuple[bool, ...] = ()) -> Ambient:
    """A point and random points along the leading axis; arrays that are ``fixed`` are the same in all points."""
    keys = jax.random.split(jax.random.key(0), CURVATURES)
    points = [jax.tree.map(np.asarray, x) for x in (q, *map(problem.manifold.random_point, keys))]
    leaves, structure = jax.tree.flatten(vec.stacked(points))
    known = fixed or (False,) * len(leaves)
    leaves = [np.broadcast_to(a[0], a.shape) if is_known else a for a, is_known in zip(leaves, known, strict=True)]
    return jax.tree.unflatten(structure, leaves)


def _terminal(problem: OptimalControlProblem, points: Ambient) -> tuple[np.ndarray, Ambient]:
    """The terminal cost at several points, and its differentials there, of the structure of the points."""
    layout = PointLayout.of(problem.manifold)

    def at(q: Array) -> tuple[Array, Array]:
        x = layout.point(q)
        return problem.final_cost(x), layout.flat(problem.manifold.projection(x, vec.gradient(problem.final_cost, x)))

    costs, slopes = _evaluate(at, 1, layout.rows(points, 1))
    return costs, layout.points(slopes)


def _cost_rates(
    problem: OptimalControlProblem, q: Ambient, moves: np.ndarray, u: Ambient, directions: np.ndarray
) -> tuple[Float[np.ndarray, "moves controls"], Float[np.ndarray, "moves controls"]]:
    """The running cost at several points around ``q`` and controls around ``u``, and the sizes of its derivatives by
    both."""
    state, control = PointLayout.of(problem.manifold), PointLayout.of(problem.controls)
    retraction = default_retraction(problem.manifold)

    def at(q: Array, u: Array, move: Array, c: Array) -> tuple[Array, Array]:
        x, u0 = state.point(q), control.point(u)
        moved = retraction.chart(x, retraction.frame(x), move)
        rate, slopes = jax.value_and_grad(lambda z: problem.cost_rate(z[0], problem._steer(u0, z[1])))((moved, c))
        return rate, vec.size(slopes)

    points = (layout.rows(x, 0)[None, None] for layout, x in ((state, q), (control, u)))
    return _evaluate(at, 2, *points, moves[:, None], directions[None])


def _evaluate(
    function: Callable[..., tuple[Array, Array]], axes: int, *rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The two values of a function of flat vectors at points with some leading axes."""
    first, second = AutomaticEvaluator().values(function, *(a.shape[-1] for a in rows)).at(axes, *rows)
    return first.astype(working_precision()), second.astype(working_precision())


def _free_leaves(tree: Any, fixed: tuple[bool, ...]) -> list[np.ndarray]:
    """Arrays of a pytree that are not ``fixed``, all if that is empty."""
    leaves = jax.tree.leaves(tree)
    return [leaf for leaf, known in zip(leaves, fixed or (False,) * len(leaves), strict=True) if not known]


def _is_one_number(values: np.ndarray, slope: Any) -> bool:
    """Whether values of a function, and the largest of its slopes, say that it is constant; what overflows is not."""
    rounding = rounding_of(values) * np.max(np.abs(values))
    return bool(np.isfinite(rounding) and np.ptp(values) <= rounding and slope <= rounding)
