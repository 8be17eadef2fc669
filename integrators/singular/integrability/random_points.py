"""Random starts: where the functions of a problem are finite, at distances over which they change by their own size."""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array

from ....compute.jit_cache import compile_function
from ....manifolds import CotangentBundle, Euclidean
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.precision import default_tolerance
from ....manifolds.numerics.tolerances import tolerance
from ....retractions import BundleRetraction, default_retraction
from ...problem.optimal_control_problem import OptimalControlProblem
from .derivative_array import DerivativeArray, Pair
from .sample_points import Points, evaluate

PRICE = 100.0  # least cost of a control of size one, over the rounding of all cost
NEARBY = 0.1  # how far starts near a state are from it, over the sizes of its coordinates
CLOSER_STARTS = (1e-3, 1e-6, 1e-9)  # how much closer starts are tried where functions are not finite
START_REACH, STEEP = 3.0, 0.25  # lengths over which functions change that starts span, at the steepest quarter of them


class RandomPoints(NamedTuple):
    """Starts: states, centers of charts of U, coordinates of controls in them, lengths over which functions change."""

    z: Pair
    centers: Ambient
    first: Array
    lengths: Array
    finite: Array


def random_starts(problem: OptimalControlProblem, order: int, count: int, seed: int, near: Pair | None) -> Points:
    """Random points of ``T*Q`` and controls, with vanishing derivatives of the control; with ``near`` it and points
    around it.

    Points of R^n are taken closer to zero, or to ``near``, where functions overflow or are steep, as ``exp(-500 x)``.
    """
    keys = jax.random.split(jax.random.key(seed), count)
    sizes = np.ones(problem.manifold.dimension)
    if near is not None:
        position = np.abs(vec.components(problem.manifold.basis(near[0]), near[0]))
        sizes = np.where(position > default_tolerance(), position, 1.0)
    tried = [(sizes, _draw_points(problem, keys, near, sizes))]
    if not tried[0][1].finite.all():
        tried += [(c * sizes, _draw_points(problem, keys, near, c * sizes)) for c in CLOSER_STARTS]
    sizes, drawn = max(tried, key=lambda pair: pair[1].finite.sum())
    lengths = np.minimum(sizes, START_REACH * _steepness(drawn))
    if not np.all(lengths == sizes):
        closer = _draw_points(problem, keys, near, lengths)
        # As exp(-1/x) is steeper, beside x, the closer x is to zero: what is drawn closer is to be less steep there.
        lengths = np.where(_steepness(closer) / lengths > _steepness(drawn) / sizes, lengths, sizes)
        drawn = _draw_points(problem, keys, near, lengths)
    jets = np.zeros((count, order + 1, problem.controls.dimension))
    jets[:, 0] = drawn.first
    return evaluate(DerivativeArray(problem, order), drawn.z, drawn.centers, jets, lengths)


def _steepness(drawn: RandomPoints) -> np.ndarray:
    """Lengths over which functions change along each coordinate of Q, at the steepest of the starts."""
    return np.quantile(drawn.lengths, STEEP, axis=0, method="lower")


def _draw_points(problem: OptimalControlProblem, keys: Array, near: Pair | None, lengths: np.ndarray) -> RandomPoints:
    return jax.tree.map(np.asarray, _draw()(problem, keys, near, jnp.asarray(lengths)))


@lru_cache
def _draw() -> Callable[..., RandomPoints]:
    """Starts of which the coordinates of Q have these sizes; costates for which ``<p, X>`` and the cost are comparable.

    A Euclidean U has one chart, around zero, and controls that cost as much as there is of it without them, or, where
    they cost nothing of second order, change the velocity by as much as there is of it: their unit is no size.
    """

    def batch(problem: OptimalControlProblem, keys: Array, near: Pair | None, lengths: Array) -> RandomPoints:
        apart = jnp.ones(len(keys)).at[0].set(0.0)  # the first start near a state is that state
        (q, p), steps = jax.lax.map(lambda at: _state(problem, at[0], at[1], near, lengths), (keys, apart))
        centers, first = jax.lax.map(lambda key: _control(problem, jax.random.split(key)[1]), keys)
        first = _price(problem, q, centers, _balance(problem, q, centers, first)) * first
        controls = jax.vmap(problem._steer)(centers, first)
        cost, rate, changes, finite = jax.lax.map(lambda at: _survey(problem, at[0], at[1], lengths), (q, controls))
        action = _middle(cost) / _middle(rate)
        action = jnp.where((action > 0) & jnp.isfinite(action), action, 1.0)
        z = jax.lax.map(lambda at: _with_costate(problem, at[0], at[1], at[2], near, action, lengths), (q, p, steps))
        return RandomPoints(z, centers, first, changes, finite)

    return compile_function(batch)


def _state(
    problem: OptimalControlProblem, key: Array, apart: Array, near: Pair | None, lengths: Array
) -> tuple[Pair, Array]:
    """A random state, and the step to it from ``near``; without ``near`` its coordinates are scaled by their sizes."""
    move = default_retraction(problem.manifold)
    if near is None:
        q, p = CotangentBundle(problem.manifold).random_point(jax.random.split(key)[0])
        frame = problem.manifold.basis(q)
        scaled = move(q, vec.combine(frame, (lengths - 1) * vec.components(frame, q)))
        return (jax.tree.map(lambda a, b: jnp.where(jnp.all(lengths == 1), a, b), q, scaled), p), jnp.zeros(
            2 * lengths.size
        )
    step = NEARBY * apart * jax.random.normal(key, (2 * lengths.size,))
    q = move(near[0], vec.combine(problem.manifold.basis(near[0]), lengths * step[: lengths.size]))
    return (q, near[1]), step


def _with_costate(
    problem: OptimalControlProblem,
    q: Ambient,
    p: Ambient,
    step: Array,
    near: Pair | None,
    action: Array,
    lengths: Array,
) -> Pair:
    """The state with a costate of this action, random, or the costate of ``near`` with a random part.

    At ``near`` itself there is no random part.
    """
    frame = problem.manifold.basis(q)
    if near is None:
        return q, vec.combine(frame, vec.components(frame, p) * action / lengths)
    own = jnp.max(jnp.abs(vec.components(problem.manifold.basis(near[0]), near[1])) * lengths)
    sizes = jnp.concatenate([lengths, jnp.where(own > 0, own, action) / lengths])
    move = BundleRetraction(default_retraction(problem.manifold))
    return move(near, vec.combine(CotangentBundle(problem.manifold).spanning_frame(near), sizes * step))


def _control(problem: OptimalControlProblem, key: Array) -> tuple[Ambient, Array]:
    """Center of a chart of U and coordinates in it."""
    u = problem.controls.random_point(key)
    if isinstance(problem.controls, Euclidean):
        return vec.zeros(problem.controls.ambient), jnp.ravel(u)
    return u, jnp.zeros(problem.controls.dimension)


def _survey(
    problem: OptimalControlProblem, q: Ambient, u: Ambient, lengths: Array
) -> tuple[Array, Array, Array, Array]:
    """Size of the cost, rate of change, lengths over which the functions change by their own size, whether all is
    finite.

    Such a length is ``|f'|/|f''|`` or ``|f''|/|f'''|``, whichever is longer: ``1/k`` for ``exp(k x)``, infinite for
    ``x^2``.
    """
    frame = problem.manifold.basis(q)

    def values(t: Array, e: Ambient) -> Array:
        near = vec.add(q, vec.scale(t, e))
        return ravel_pytree((problem.velocity(near, u), problem.cost_rate(near, u)))[0]

    def derivatives(e: Ambient) -> tuple[Array, ...]:
        def slope(f: Callable[[Array], Array]) -> Callable[[Array], Array]:
            return lambda t: jax.jvp(f, (t,), (jnp.ones_like(t),))[1]

        first = slope(lambda t: values(t, e))
        second = slope(first)
        return tuple(f(jnp.zeros(())) for f in (first, second, slope(second)))

    first, second, third = map(jnp.abs, jax.vmap(derivatives)(frame))
    known = jnp.isfinite(first) & jnp.isfinite(second) & jnp.isfinite(third)
    changes = jnp.maximum(_ratio(first, second), _ratio(second, third))
    changes = jnp.min(jnp.where(known & (changes > 0), changes, jnp.inf), axis=1)
    speeds = vec.components(frame, problem.velocity(q, u))
    cost = jnp.abs(problem.cost_rate(q, u))
    finite = jnp.all(known) & jnp.all(jnp.isfinite(speeds)) & jnp.isfinite(cost)
    return cost, jnp.max(jnp.abs(speeds) / lengths), changes, finite


def _ratio(a: Array, b: Array) -> Array:
    return jnp.where(b > 0, a / jnp.where(b > 0, b, 1.0), jnp.inf)


def _middle(sizes: Array) -> Array:
    """The median of the finite sizes, or their largest if the median is zero."""
    known = jnp.where(jnp.isfinite(sizes), sizes, jnp.nan)
    median = jnp.nanmedian(known)
    return jnp.where(median > 0, median, jnp.nanmax(known))


def _balance(problem: OptimalControlProblem, q: Ambient, centers: Ambient, first: Array) -> Array:
    """The ratio of typical sizes of the velocity and of its change by these controls, one if either is zero."""

    def sizes(at: tuple[Ambient, Ambient, Array]) -> tuple[Array, Array]:
        q, center, c = at
        still = problem.velocity(q, center)
        return vec.size(still), vec.size(vec.subtract(problem.velocity(q, problem._steer(center, c)), still))

    drift, change = (jnp.mean(a) for a in jax.lax.map(sizes, (q, centers, first)))
    least = default_tolerance() * jnp.maximum(drift, change)
    return jnp.where((drift > least) & (change > least), drift / jnp.where(change > 0, change, 1.0), 1.0)


def _price(problem: OptimalControlProblem, q: Ambient, centers: Ambient, sizes: Array) -> Array:
    """Controls of which each costs, in second order, as much as there is of cost at the centers; ``sizes`` where none
    is."""

    def costs(at: tuple[Ambient, Ambient]) -> tuple[Array, Array]:
        q, center = at
        cost = jax.hessian(lambda c: problem.cost_rate(q, problem._steer(center, c)))
        return jnp.abs(problem.cost_rate(q, center)), jnp.abs(
            jnp.diagonal(cost(jnp.zeros(problem.controls.dimension)))
        ) / 2

    cost, price = (jnp.mean(a, axis=0) for a in jax.lax.map(costs, (q, centers)))
    paid = (price > PRICE * tolerance(price, 1.0) * cost) & (cost > 0)
    return jnp.where(paid, jnp.sqrt(cost / jnp.where(paid, price, 1.0)), sizes)
