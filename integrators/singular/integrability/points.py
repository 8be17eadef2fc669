"""Consistent points of the derivative array: batched, damped Levenberg-Marquardt steps of least norm from random starts."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....manifolds import CotangentBundle, Euclidean, Manifold
from ....manifolds.manifold import default_tolerance
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient, Frame
from ....manifolds.symplectic import form_matrix
from ....retractions import BundleRetraction, default_retraction
from ...compilation import compiled
from ...problem import OptimalControlProblem
from .jets import DerivativeArray, Pair, hamiltonian_field

CONVERGED = 1e-10  # norm of the array, in its units
ITERATIONS = 100
SMALLEST_DAMPING = 1e-3
PSEUDO_INVERSE_CUTOFF = 1e-9
LARGEST_SHIFT = 1e-2
DESCENTS, EASE = 30, 10.0  # steps of descent, and how much rather they move the control than the state
NEGLIGIBLE = 1e-7  # a row this much smaller than the terms that it sums is rounding
SLOW_RATIO, SLOW_STEPS, SLOW_BELOW = 0.1, 4, 1e-8  # tiny residuals that shrink slower, this often: an irregular constraint
LONG = 1e-2  # steps, in units, of points that go to infinity while residuals are that tiny
BESIDE = 1e-3  # how far, in units, points are taken beside others to see whether their ranks are the same
PRICE = 100.0  # least cost of a control of size one, over the rounding of all cost
NEARBY = 0.1  # how far starts near a state are from it; costates relative to their size


class Linearised(NamedTuple):
    """What the kernel returns at one point of the jet space over ``T*Q``."""

    z: Pair
    control: Ambient
    frame: Frame  # of T_z T*Q: horizontal, then vertical vectors, so that its scale does not depend on that of p
    jet: Array  # (order + 1, m): the control and its derivatives
    array: Array  # (order + 1, m): F_0 ... F_order
    by_state: Array  # (order + 1, m, 2n): derivatives along that frame
    by_jet: Array  # (order + 1, m, order + 1, m)
    velocity: Array  # (2n,): X_H in that frame
    omega: Array  # (2n, 2n): the canonical form in that frame
    costate: Array  # (1 + 2n,): (|p|^2 - 1) / 2 and its derivative along that frame
    cost_rate: Array


def _linearise(array: DerivativeArray, z: Pair, center: Ambient, jet: Array) -> Linearised:
    bundle = CotangentBundle(array.problem.manifold)
    frame, count = bundle.spanning_frame(z), bundle.dimension
    function = jax.jit(lambda z, u: array(z, center, u))
    along = jnp.concatenate([jnp.zeros((count, jet.size)), jnp.eye(jet.size)]).reshape(-1, *jet.shape)
    moved = jax.tree.map(lambda leaf: jnp.concatenate([leaf, jnp.zeros((jet.size, *leaf.shape[1:]))]), frame)
    value, slopes = jax.vmap(lambda a, b: jax.jvp(function, (z, jet), (a, b)), out_axes=(None, 0))(moved, along)
    slopes = jnp.moveaxis(slopes, 0, -1)
    size, slope = jax.vmap(lambda a: jax.jvp(lambda y: (vec.pairing(y[1], y[1]) - 1) / 2, (z,), (a,)), out_axes=(None, 0))(frame)
    base, control = array.problem.manifold.basis(z[0]), array.problem.steer(center, jet[0])
    return Linearised(
        z=z,
        control=control,
        frame=frame,
        jet=jet,
        array=value,
        by_state=slopes[..., :count],
        by_jet=slopes[..., count:].reshape(*jet.shape, *jet.shape),
        velocity=jnp.concatenate([vec.components(base, part) for part in hamiltonian_field(array.problem, z, control)]),
        omega=form_matrix(bundle.two_form, z, frame),
        costate=jnp.concatenate([size[None], slope]),
        cost_rate=array.problem.cost_rate(z[0], control),
    )


@lru_cache
def _kernel() -> Callable[..., Linearised]:
    """Moves a batch of points by coordinates ``d`` of shape ``(batch, 2n + jet)`` and linearises the array there."""

    def batch(array: DerivativeArray, z: Pair, centers: Ambient, jets: Array, d: Array) -> Linearised:
        bundle = CotangentBundle(array.problem.manifold)
        move = BundleRetraction(default_retraction(array.problem.manifold))

        def one(arguments: tuple[Pair, Ambient, Array, Array]) -> Linearised:
            z, center, jet, d = arguments
            near = move(z, vec.combine(bundle.spanning_frame(z), d[: bundle.dimension]))
            return _linearise(array, near, center, jet + d[bundle.dimension :].reshape(jet.shape))

        return jax.lax.map(one, (z, centers, jets, d))

    return compiled(batch, quickly=True)


@dataclass(frozen=True)
class Units:
    """Typical sizes of the array, ``(order + 1, m)``, and of the coordinates of state, ``(2n,)``, and jet, ``(order + 1, m)``."""

    rows: np.ndarray
    state: np.ndarray
    jet: np.ndarray

    @property
    def both(self) -> np.ndarray:
        """Of state and jet, raveled."""
        return np.concatenate([self.state, self.jet.reshape(-1)])


@dataclass(frozen=True)
class Points:
    """A batch of points of the jet space, with the array linearised there, and how the search for them ended.

    ``slow``: the residual shrank slowly; ``away``: so it did while the steps stayed long, as where ``e^u`` is to vanish.
    """

    array: DerivativeArray
    centers: Ambient
    at: Linearised
    units: Units
    residuals: np.ndarray
    slow: np.ndarray
    away: np.ndarray

    @property
    def consistent(self) -> np.ndarray:
        """Which points satisfy the equations they were moved to."""
        return (self.residuals <= CONVERGED) & ~self.away

    @property
    def reliable(self) -> np.ndarray:
        """Consistent points whose ranks can be read: not where equations are irregular, unless they are so at all points."""
        regular = self.consistent & ~self.slow
        return regular if regular.any() else self.consistent

    def matrices(self, level: int) -> tuple[Any, Any]:
        """``F_z`` and ``F_U`` of the levels up to this one in units: ``(batch, rows, 2n)`` and ``(batch, rows, rows)``."""
        batch, rows = len(self.residuals), (level + 1) * self.at.jet.shape[-1]
        scale = self.units.rows[: level + 1].reshape(-1, 1)
        by_state = self.at.by_state[:, : level + 1].reshape(batch, rows, -1) / scale * self.units.state
        by_jet = self.at.by_jet[:, : level + 1, :, : level + 1].reshape(batch, rows, rows)
        return by_state, by_jet / scale * self.units.jet[: level + 1].reshape(-1)


def random_starts(problem: OptimalControlProblem, order: int, count: int, seed: int, near: Pair | None) -> Points:
    """Random points of ``T*Q`` and controls, with vanishing derivatives of the control; with ``near`` it and points around it."""
    keys = jax.random.split(jax.random.key(seed), count)
    (q, p), centers, first, (speed, cost) = jax.tree.map(np.asarray, _draw()(problem, keys))
    size, _ = _sizes(cost, speed)
    z = (q, jax.tree.map(lambda leaf: size * leaf, p)) if near is None else _around(problem.manifold, near, keys, size)
    jets = np.zeros((count, order + 1, problem.controls.dimension))
    jets[:, 0] = first
    return _evaluated(DerivativeArray(problem, order), z, centers, jets)


@lru_cache
def _draw() -> Callable[..., Any]:
    """Points of ``T*Q``, centers of charts of U and coordinates in them, and sizes of the velocity and the cost there.

    A Euclidean U has one chart, around zero, and controls that cost as much as there is of it without them, or, where they cost
    nothing of second order, change the velocity by as much as there is of it: their unit is no size.
    """

    def one(problem: OptimalControlProblem, key: Array) -> tuple[Pair, Ambient, Array]:
        first, second = jax.random.split(key)
        u = problem.controls.random_point(second)
        z = CotangentBundle(problem.manifold).random_point(first)
        if isinstance(problem.controls, Euclidean):
            return z, vec.zeros(problem.controls.ambient), jnp.ravel(u)
        return z, u, jnp.zeros(problem.controls.dimension)

    def sizes(problem: OptimalControlProblem, q: Ambient, u: Ambient) -> tuple[Array, Array]:
        return vec.size(problem.velocity(q, u)), jnp.abs(problem.cost_rate(q, u))

    def batch(problem: OptimalControlProblem, keys: Array) -> Any:
        z, centers, first = jax.lax.map(lambda key: one(problem, key), keys)
        first = _priced(problem, z[0], centers, _balance(problem, z[0], centers, first)) * first
        controls = jax.vmap(problem.steer)(centers, first)
        return z, centers, first, jax.lax.map(lambda at: sizes(problem, *at), (z[0], controls))

    return compiled(batch, quickly=True)


def _balance(problem: OptimalControlProblem, q: Ambient, centers: Ambient, first: Array) -> Array:
    """Typical size of the velocity at the centers over that of its change by these controls; one where either is zero."""

    def sizes(at: tuple[Ambient, Ambient, Array]) -> tuple[Array, Array]:
        q, center, c = at
        still = problem.velocity(q, center)
        return vec.size(still), vec.size(vec.subtract(problem.velocity(q, problem.steer(center, c)), still))

    drift, change = (jnp.mean(a) for a in jax.lax.map(sizes, (q, centers, first)))
    least = default_tolerance() * jnp.maximum(drift, change)
    return jnp.where((drift > least) & (change > least), drift / jnp.where(change > 0, change, 1.0), 1.0)


def _priced(problem: OptimalControlProblem, q: Ambient, centers: Ambient, sizes: Array) -> Array:
    """Controls of which each costs, in second order, as much as there is of cost at the centers; ``sizes`` where none is."""

    def costs(at: tuple[Ambient, Ambient]) -> tuple[Array, Array]:
        q, center = at
        cost = jax.hessian(lambda c: problem.cost_rate(q, problem.steer(center, c)))
        return jnp.abs(problem.cost_rate(q, center)), jnp.abs(jnp.diagonal(cost(jnp.zeros(problem.controls.dimension)))) / 2

    cost, price = (jnp.mean(a, axis=0) for a in jax.lax.map(costs, (q, centers)))
    paid = (price > PRICE * jnp.finfo(price.dtype).eps * cost) & (cost > 0)
    return jnp.where(paid, jnp.sqrt(cost / jnp.where(paid, price, 1.0)), sizes)


def _around(manifold: Manifold, z: Pair, keys: Array, costate: float) -> Pair:
    """The point, and random ones near it; ``costate`` is the typical size of one, for a ``p`` that is zero."""
    bundle, move = CotangentBundle(manifold), BundleRetraction(default_retraction(manifold))
    extent = float(vec.size(z[1])) or costate
    lengths = NEARBY * jnp.repeat(jnp.array([1.0, extent]), manifold.dimension)
    steps = jax.vmap(lambda key: lengths * jax.random.normal(key, lengths.shape))(keys).at[0].set(0.0)
    return jax.tree.map(np.asarray, jax.lax.map(lambda d: move(z, vec.combine(bundle.spanning_frame(z), d)), steps))


def with_order(points: Points, order: int) -> Points:
    """The same points with an array of this order, and no knowledge of units yet."""
    more = order - points.array.order
    jets = np.concatenate([points.at.jet, np.zeros((len(points.residuals), more, points.at.jet.shape[-1]))], axis=1)
    return _evaluated(DerivativeArray(points.array.problem, order), points.at.z, points.centers, jets)


def _evaluated(array: DerivativeArray, z: Pair, centers: Ambient, jets: np.ndarray) -> Points:
    count = len(jets)
    still = np.zeros((count, CotangentBundle(array.problem.manifold).dimension + jets[0].size))
    at = _host(_kernel()(array, z, centers, jnp.asarray(jets), jnp.asarray(still)))
    never = np.full(count, np.inf)
    return Points(array, centers, at, _units(at), never, *np.zeros((2, count), bool))


def _host(at: Linearised) -> Linearised:
    return jax.tree.map(np.asarray, at)


def _units(at: Linearised) -> Units:
    """Rows by their typical largest entry, unless it is rounding of the terms they sum; then columns by their largest one.

    Entries are weighed with the sizes that a state, a costate, a control and its derivatives have at the starts, so that the
    answers do not depend on the units of time, cost and controls.
    """
    costate, rate = _sizes(np.asarray(at.cost_rate), np.linalg.norm(at.velocity[:, : at.velocity.shape[1] // 2], axis=1))
    across = np.repeat([1.0, costate], at.velocity.shape[1] // 2)
    control = np.sqrt(np.mean(at.jet[:, 0] ** 2, axis=0))
    along = np.where(control > 0, control, 1.0) * (rate ** np.arange(at.jet.shape[1]))[:, None]
    by_state, by_jet = np.abs(at.by_state) * across, np.abs(at.by_jet) * along
    largest = np.max(np.concatenate([by_state, by_jet.reshape(*at.array.shape, -1)], axis=-1), axis=-1)
    rows = _typical(np.maximum(largest, np.abs(at.array)))
    shifted = np.concatenate([np.abs(at.jet[:, 1:]), np.zeros_like(at.jet[:, :1])], axis=1)
    terms = np.einsum("bkms,bs->bkm", np.abs(at.by_state), np.abs(at.velocity))
    terms += np.einsum("bkmln,bln->bkm", np.abs(at.by_jet), shifted)
    floor = NEGLIGIBLE * np.concatenate([[np.max(rows[0])], np.max(terms, axis=(0, 2))[:-1]])
    rows = np.maximum(rows, floor[:, None])
    rows = np.where(rows > 0, rows, 1.0)
    capped = np.maximum(largest, rows)
    state = np.max(by_state / capped[..., None], axis=(0, 1, 2))
    jet = np.max(by_jet / capped[..., None, None], axis=(0, 1, 2))
    return Units(rows, across * _reciprocal(state), along * _reciprocal(jet))


def _sizes(costs: np.ndarray, speeds: np.ndarray) -> tuple[float, float]:
    """Costates for which ``<p, X>`` and the cost are comparable, and the rate of change of a state of size one."""
    cost, speed = float(np.mean(np.abs(costs))), float(np.mean(speeds))
    return (cost / speed if cost > 0 and speed > 0 else 1.0), (speed if speed > 0 else 1.0)


def _typical(sizes: np.ndarray) -> np.ndarray:
    """Medians over a batch, which one point near a pole does not move; largest values where more than half are zero."""
    medians = np.median(sizes, axis=0)
    return np.where(medians > 0, medians, np.max(sizes, axis=0))


def _reciprocal(sizes: np.ndarray) -> np.ndarray:
    largest = np.max(sizes)
    return 1 / np.where(sizes > NEGLIGIBLE * largest, sizes, largest) if largest > 0 else np.ones_like(sizes)


def make_consistent(points: Points, level: int, unit_costate: bool) -> Points:
    """Points moved to ``F_0 = ... = F_level = 0``, and to ``|p| = 1`` if asked, by damped steps of least norm.

    Those that come to irregular ones, as where pieces cross, are tried once more with ``DESCENTS`` steps of descent before.
    """
    direct = _moved(points, level, unit_costate, np.ones(len(points.slow), bool), 0)
    stuck = direct.slow & direct.consistent & ~points.slow
    if not stuck.any():
        return direct
    again = _moved(points, level, unit_costate, stuck, DESCENTS)
    better = stuck & again.consistent & ~again.slow
    pairs = ((found.at, found.residuals, found.slow) for found in (again, direct))
    at, residuals, slow = jax.tree.map(lambda a, b: _where(better, a, b), *pairs)
    return replace(direct, at=at, residuals=residuals, slow=slow)


def _moved(points: Points, level: int, unit_costate: bool, which: np.ndarray, descents: int) -> Points:
    at, damping = points.at, np.where(which, 1.0, 0.0)
    slow = np.zeros(len(which), int)
    residual = _residuals(points, at, level, unit_costate)
    for i in range(ITERATIONS):
        active = (residual > CONVERGED * 1e-3) & (damping > SMALLEST_DAMPING)
        if not active.any():
            break
        d = np.where(active, damping, 0.0)[:, None] * _directions(replace(points, at=at), level, unit_costate, i < descents)
        tried = _host(_kernel()(points.array, at.z, points.centers, jnp.asarray(at.jet), jnp.asarray(d)))
        now = _residuals(points, tried, level, unit_costate)
        better = active & (now < (1 - 1e-4 * damping) * residual)
        at = jax.tree.map(lambda a, b, better=better: _where(better, a, b), tried, at)
        slow += better & (damping == 1) & (now > SLOW_RATIO * residual) & (now < SLOW_BELOW)
        residual = np.where(better, now, residual)
        damping = np.where(better, 1.0, np.where(residual <= CONVERGED, 0.0, damping / 2))
    ended, slow = replace(points, at=at, residuals=residual), slow >= SLOW_STEPS
    steps = np.linalg.norm(_directions(ended, level, unit_costate, False) / points.units.both, axis=1)
    return replace(ended, slow=points.slow | slow, away=points.away | (slow & (steps > LONG)))


def _where(which: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The points of ``a`` that are ``which``, the others of ``b``."""
    return np.where(which.reshape(-1, *[1] * (a.ndim - 1)), a, b)


def points_beside(points: Points, level: int, unit_costate: bool) -> Points:
    """Consistent points at a random short distance from those of a batch: where pieces cross they lie on one of these."""
    count, reach = len(points.residuals), points.at.velocity.shape[1] + (level + 1) * points.at.jet.shape[-1]
    lengths = BESIDE * points.units.both
    lengths[reach:] = 0.0  # derivatives of the control that do not enter
    d = lengths * np.random.default_rng(0).standard_normal((count, lengths.size))
    at = _host(_kernel()(points.array, points.at.z, points.centers, jnp.asarray(points.at.jet), jnp.asarray(d)))
    return make_consistent(replace(points, at=at, slow=np.zeros(count, bool)), level, unit_costate)


def _residuals(points: Points, at: Linearised, level: int, unit_costate: bool) -> np.ndarray:
    """Norm of the equations in units; infinite where one, or a function of the problem, is not finite."""
    entries = np.abs(at.array / points.units.rows)[:, : level + 1].reshape(len(at.array), -1)
    if unit_costate:
        entries = np.concatenate([entries, np.abs(at.costate[:, :1])], axis=1)
    finite = np.isfinite(at.cost_rate) & np.all(np.isfinite(at.velocity), axis=1)
    return np.where(finite, np.nan_to_num(np.linalg.norm(entries, axis=1), nan=np.inf), np.inf)


def _directions(points: Points, level: int, unit_costate: bool, descent: bool) -> np.ndarray:
    """Steps of Levenberg and Marquardt, zero for derivatives of the control that do not enter; shape ``(batch, 2n + jet)``.

    With ``descent`` nearly along the gradient in units in which control and derivatives are moved rather than the state: these
    go to one of the pieces that cross, while steps of Gauss and Newton go straight to where they do.
    """
    at, units = points.at, points.units
    by_state, by_jet = points.matrices(level)
    batch, rows, count = by_state.shape
    matrix = np.concatenate([by_state, by_jet], axis=2)
    values = (at.array / units.rows)[:, : level + 1].reshape(batch, rows)
    if unit_costate:
        extra = np.concatenate([at.costate[:, 1:] * units.state, np.zeros((batch, by_jet.shape[2]))], axis=1)
        matrix = np.concatenate([matrix, extra[:, None]], axis=1)
        values = np.concatenate([values, at.costate[:, :1]], axis=1)
    finite = np.asarray(np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(values).all(axis=1))
    matrix = np.where(finite[:, None, None], matrix, 0.0)
    values = np.where(finite[:, None], values, 0.0)
    ease = np.where(descent & (np.arange(matrix.shape[2]) >= count), EASE, 1.0)
    step = -ease * _regularised(matrix * ease, values, descent)
    scale = np.concatenate([units.state, units.jet[: level + 1].reshape(-1)])
    full = np.zeros((batch, count + at.jet[0].size))
    full[:, : len(scale)] = step * scale
    return full


def _regularised(matrix: np.ndarray, values: np.ndarray, descent: bool) -> np.ndarray:
    """``J' (J J' + d)^+ F`` with ``d`` the square of ``F``, at most ``LARGEST_SHIFT``, in a batch.

    Converges quadratically wherever ``F`` bounds the distance to its zeros, though the rank of ``J`` may drop on them
    [Yamashita, Fukushima, On the rate of convergence of the Levenberg-Marquardt method, 2001]: steps of Gauss and Newton
    are drawn to where pieces cross. With ``descent`` ``d`` is at least the square of the largest singular value.
    """
    left, sizes, right = np.linalg.svd(matrix, full_matrices=False)
    shift = np.minimum(np.sum(values**2, axis=1), LARGEST_SHIFT)[:, None]
    shift = np.maximum(shift, sizes[:, :1] ** 2) if descent else shift
    counted = sizes > PSEUDO_INVERSE_CUTOFF * sizes[:, :1]
    filtered = np.where(counted, sizes / np.where(counted, sizes**2 + shift, 1.0), 0.0)
    return np.einsum("bri,br,bkr,bk->bi", right, filtered, left, values)


def select(points: Points, which: Any) -> Points:
    """A part of a batch."""
    part = jax.tree.map(lambda leaf: leaf[which], (points.centers, points.at))
    evidence = points.residuals[which], points.slow[which], points.away[which]
    return Points(points.array, part[0], part[1], points.units, *evidence)
