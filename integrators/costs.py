"""Whether the costs of a problem tell one curve from another, seen at random points with random controls."""

from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jaxtyping import Array, Float

from ..manifolds import InvalidInputError
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.tolerances import rounding_of
from ..retractions import default_retraction
from .compilation import call_compiled
from .options import HORIZON
from .probing import CURVATURES

if TYPE_CHECKING:
    from .problem import OptimalControlProblem


def require_cost(
    problem: "OptimalControlProblem", around: tuple[Ambient, Ambient, np.ndarray], end: Ambient, fixed: tuple[bool, ...]
) -> None:
    """Raise if both costs are a number each; ``around``: a state, a control, and coordinates of others around that."""
    q, u, near = around
    directions = np.concatenate([size * near for size in (1, 1e2, 1e4)])
    moves = (
        np.random.default_rng(0).standard_normal((CURVATURES + 1, problem.manifold.dimension)).astype(directions.dtype)
    )
    moves[0] = 0.0
    costs, slopes = jax.device_get(call_compiled(_cost_rates, problem, q, moves, u, directions)[0])
    if problem.abnormal or problem.initial_cost is not None or not _is_one_number(costs, np.max(slopes)):
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


def is_steep(problem: "OptimalControlProblem", fixed: tuple[bool, ...]) -> bool:
    """Whether an entry of the differential of the terminal cost is one number, not zero, in an array that is not
    ``fixed``."""
    if problem.terminal_cost is None:
        return False
    _, tilts = _terminal(problem, _points(problem, problem.manifold.random_point(jax.random.key(1))))
    return any(
        bool(np.any((a[0] != 0) & np.all(np.abs(a - a[0]) <= rounding_of(a) * np.abs(a[0]), axis=0)))
        for a in _free_leaves(tilts, fixed)
    )


def _points(problem: "OptimalControlProblem", q: Ambient, fixed: tuple[bool, ...] = ()) -> Ambient:
    """A point and random ones, along the leading axis; those of its arrays that are ``fixed`` are the same in all."""
    keys = jax.random.split(jax.random.key(0), CURVATURES)
    points = [jax.tree.map(np.asarray, x) for x in (q, *map(problem.manifold.random_point, keys))]
    leaves, structure = jax.tree.flatten(jax.tree.map(lambda *leaves: np.stack(leaves), *points))
    known = fixed or (False,) * len(leaves)
    leaves = [np.broadcast_to(a[0], a.shape) if is_known else a for a, is_known in zip(leaves, known, strict=True)]
    return jax.tree.unflatten(structure, leaves)


def _terminal(problem: "OptimalControlProblem", points: Ambient) -> tuple[np.ndarray, Ambient]:
    return jax.tree.map(np.asarray, call_compiled(_terminal_costs, problem, points)[0])


def _cost_rates(
    problem: "OptimalControlProblem", q: Ambient, moves: Array, u: Ambient, directions: Array
) -> tuple[Float[Array, "moves controls"], Array]:
    """The running cost at several points around ``q`` and controls around ``u``, and the sizes of its derivatives by
    both."""
    retraction = default_retraction(problem.manifold)
    frame = retraction.frame(q)

    def at(q: Ambient, c: Array) -> tuple[Array, Array]:
        rate, slopes = jax.value_and_grad(lambda z: problem.cost_rate(z[0], problem.steer(u, z[1])))((q, c))
        return rate, vec.size(slopes)

    return jax.vmap(lambda move: jax.vmap(lambda c: at(retraction.chart(q, frame, move), c))(directions))(moves)


def _terminal_costs(problem: "OptimalControlProblem", points: Ambient) -> tuple[Array, Ambient]:
    """The terminal cost at several points, and its differentials there, of the structure of the points."""

    def at(q: Ambient) -> tuple[Array, Ambient]:
        return problem.final_cost(q), problem.manifold.projection(q, vec.gradient(problem.final_cost, q))

    return jax.vmap(at)(points)


def _free_leaves(tree: Any, fixed: tuple[bool, ...]) -> list[np.ndarray]:
    """Arrays of a pytree that are not ``fixed``, all if that is empty."""
    leaves = jax.tree.leaves(tree)
    return [leaf for leaf, known in zip(leaves, fixed or (False,) * len(leaves), strict=True) if not known]


def _is_one_number(values: np.ndarray, slope: Any) -> bool:
    """Whether values of a function, and the largest of its slopes, say that it is constant."""
    rounding = rounding_of(values) * np.max(np.abs(values))
    return bool(np.ptp(values) <= rounding and slope <= rounding)
