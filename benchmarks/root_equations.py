"""Equations of the library: what solves them there, and the same as plain functions that any other solver takes.

``CASES`` has functions that make a ``Case``, by its name. Unknowns are in units of their typical sizes on all sides.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from retrax.compute.automatic import AutomaticEvaluator
from retrax.integrators import SymplecticIntegrator, classify
from retrax.integrators.boundary_value.shooting.least_squares import least_squares
from retrax.integrators.boundary_value.transcription.chart import Chart
from retrax.integrators.initial_value.step import StepEquations
from retrax.integrators.singular.integrability.derivative_array import DerivativeArray
from retrax.integrators.singular.integrability.random_points import random_starts
from retrax.integrators.singular.integrability.sample_points import select
from retrax.integrators.singular.integrability.search import make_consistent
from retrax.manifolds import SO, CotangentBundle, LevelSet, Sphere, Stiefel
from retrax.manifolds.level_set import GAUSS_NEWTON_STEPS, positive_norms
from retrax.manifolds.numerics import ambient as vec
from retrax.manifolds.numerics.precision import default_tolerance
from retrax.manifolds.numerics.root import approach_root, find_root
from retrax.problems import SINGULAR
from retrax.retractions import Cayley, CotangentLift, Exponential, Gauss, Midpoint, Projection, ProjectionByNewton
from retrax.retractions.retraction import miss

COUNT = 100  # starts of each kind
SQUARE = "Newton", "Chord", "Dogleg", "LevenbergMarquardt", "BestSoFar"
LEAST = "GaussNewton", "LevenbergMarquardt", "Dogleg"
ROTATIONS, INERTIA = SO(3), jnp.array([1.0, 2.0, 3.0])


class Posed(NamedTuple):
    """Equations at given data: ``residual(c)``, where an iteration starts, and ``ours``, which returns a root and
    whether it is claimed to be one."""

    residual: Callable[[Any], Any]
    start: Any
    ours: Callable[[], Any] | None = None


class Case(NamedTuple):
    """Equations with starts.

    ``pose(data, mark)`` poses them; their unknowns pass through ``mark``. ``starts``: data with a leading axis, by
    kind; ``peers``: solvers of optimistix that are apt; ``wanted(data)``: the root that is asked for, if it is known.
    ``host()``, for a solver of the library that takes a batch as it is, makes a function of data that returns the same
    at its roots, which are zero there, and which of them it claims.
    """

    solved_by: str
    pose: Callable[..., Posed]
    starts: dict[str, Any]
    peers: tuple[str, ...] = SQUARE
    wanted: Callable[[Any], Any] | None = None
    host: Callable[[], Callable[[Any], Any]] | None = None
    can_be_met: bool = True  # a point that does not meet the equations is none


class Ellipsoid(LevelSet):
    """``x^2 + 2 y^2 + 4 z^2 = 1``."""

    def constraint(self, x):
        return x @ (jnp.array([1.0, 2.0, 4.0]) * x) - 1.0


def drawn(manifold, shortest, longest, seed=0):
    """Points, and tangent vectors there, of lengths between these."""
    keys = jax.random.split(jax.random.key(seed), 3)
    x = jax.jit(jax.vmap(manifold.random_point))(jax.random.split(keys[0], COUNT))
    v = jax.jit(jax.vmap(manifold.projection))(x, jax.random.normal(keys[1], x.shape))
    lengths = jax.random.uniform(keys[2], (COUNT,), minval=shortest, maxval=longest)
    return x, jax.vmap(lambda v, s: v * s / jnp.sqrt(jnp.sum(v**2)))(v, lengths)


def inverse_retraction(retraction, easy, hard, approach=False):
    """``R(x, v) = y`` for ``v``, in coordinates of the tangent space; with ``approach`` by Levenberg's steps first."""
    manifold = retraction.manifold

    def start_at(length):
        x, v = drawn(manifold, *length)
        y = jax.jit(jax.vmap(retraction))(x, v)
        there = np.flatnonzero(np.isfinite(np.asarray(y)).reshape(COUNT, -1).all(axis=1))
        return jax.tree.map(lambda a: a[jnp.resize(there, COUNT)], (x, y, v))

    def pose(data, mark):
        x, y, _ = data
        basis, missed = manifold.basis(x), miss(retraction, x, y)
        start = vec.components(basis, y - x)
        if approach:  # as StiefelExponential does
            start = start * jnp.sqrt(jnp.sum((y - x) ** 2) / (start @ start))

        def ours():
            def beside(c):
                return jnp.ravel(retraction(x, vec.combine(basis, mark(c))) - y)

            return find_root(lambda c: missed(mark(c)), approach_root(beside, start) if approach else start)

        return Posed(lambda c: missed(mark(c)), start, ours)

    return Case(
        "approach_root, find_root" if approach else "find_root",
        pose,
        {"easy": start_at(easy), "hard": start_at(hard)},
        wanted=lambda data: vec.components(manifold.basis(data[0]), data[2]),
    )


def level_set_projection():
    """The critical point of the distance to ``a = x + v`` and its multiplier, as in ``LevelSetProjection``."""
    manifold = Ellipsoid((3,))

    def pose(a, mark):
        start = manifold.restore(a)
        lengths = positive_norms(manifold.jacobian(start))

        def residual(unknown):
            y, multipliers = jnp.split(mark(unknown), [a.size])
            normal = manifold.jacobian(y).T @ (multipliers / lengths)
            return jnp.concatenate([y - a - normal, manifold.equations(y) / lengths])

        first = jnp.concatenate([start, jnp.zeros_like(lengths)])
        return Posed(residual, first, lambda: find_root(residual, first))

    starts = {kind: sum(drawn(manifold, *size)) for kind, size in {"easy": (0.0, 0.3), "hard": (0.5, 2.0)}.items()}
    return Case("find_root", pose, starts)


def point_of_level_set():
    """A point of an ellipsoid from anywhere, as ``LevelSet.random_point`` finds it: one equation in three unknowns."""
    manifold = Ellipsoid((3,))

    def pose(x, mark):
        def ours():
            y = jax.lax.fori_loop(0, GAUSS_NEWTON_STEPS, lambda _, x: manifold.restore(x), x)
            return y, vec.size(manifold.violations(y)) <= default_tolerance()

        return Posed(lambda y: manifold.equations(mark(y)), x, ours)

    x = jax.random.normal(jax.random.key(0), (COUNT, 3))
    return Case("30 steps of restore", pose, {"easy": x, "hard": 1e-3 * x}, LEAST)


def point_of_final_manifold():
    """A point of ``P_f`` of the curved arc near one that is not on it: ``Submanifold.nearby``, 2 equations in R^6."""
    found = classify(SINGULAR["curved arc"]().problem).manifold
    base = jnp.concatenate(found.random_point(jax.random.key(0)))

    def pose(z, mark):
        def ours():
            y = jnp.concatenate(found.nearby((z[:3], z[3:])))
            return y, vec.size(found.violations((y[:3], y[3:]))) <= default_tolerance()

        return Posed(lambda y: found.equations((mark(y)[:3], y[3:])), z, ours)

    noise = jax.random.normal(jax.random.key(1), (COUNT, 6))
    return Case("Submanifold.nearby", pose, {"easy": base + 0.1 * noise, "hard": base + 2.0 * noise}, LEAST)


def rigid_body(q, p):
    """Kinetic energy of a free rigid body, from its body momentum."""
    momentum = ROTATIONS.body(q, p)
    return momentum @ (momentum / INERTIA) / 2


def pendulum(q, p):
    """Energy of the spherical pendulum."""
    return p @ p / 2 + q[2]


SYSTEMS = {
    "rigid body": (rigid_body, SymplecticIntegrator(CotangentLift(Midpoint(Cayley(ROTATIONS))))),
    "pendulum": (pendulum, SymplecticIntegrator(CotangentLift(Midpoint(Projection(Sphere(2)))))),
    "rigid body, Gauss 3": (rigid_body, SymplecticIntegrator(Gauss(3, Cayley(ROTATIONS)))),
}


def states(integrator):
    """Random points of ``T*Q``."""
    bundle = CotangentBundle(integrator.manifold)
    return jax.jit(jax.vmap(bundle.random_point))(jax.random.split(jax.random.key(0), COUNT))


def pose_step(system, integrator, data, mark):
    """The equations of a step, as ``lifted_step`` poses them, in units of their unknowns, and the equations."""
    q, p, h = data
    stage = integrator.stage(system, h)
    equations = StepEquations.near(stage, q, p, integrator.begin(system, q, p))
    unit, inverse = equations.sizes, stage.small_step_inverse()

    def residual(c):
        return equations.residual(unit * mark(c), q, p)

    start = equations.first / unit
    scaled = None if inverse is None else inverse / unit[:, None]
    return Posed(residual, start, lambda: find_root(residual, start, inverse=scaled)), equations


def implicit_step(name, easy, hard):
    """A step of a symplectic integrator, ``h`` long, from random states."""
    system, integrator = SYSTEMS[name]
    starts = {kind: (*states(integrator), jnp.full(COUNT, h)) for kind, h in {"easy": easy, "hard": hard}.items()}
    return Case("find_root", lambda data, mark: pose_step(system, integrator, data, mark)[0], starts)


def costates_at_an_end():
    """Costates and free rates at an end where the attitude is given, as in ``points_at_ends``: of two equations of
    ``P_f`` one is zero whatever they are."""
    equations = classify(SINGULAR["free actuator"]().problem).equations

    def pose(data, mark):
        attitude, start = data

        def residual(c):
            c = mark(c)
            return equations(((attitude, c[3:]), (ROTATIONS.covector(attitude, c[:3]), jnp.zeros(3))))

        def ours():
            c, left = least_squares(residual, start)
            return c, vec.size(left) <= 1e-10

        return Posed(residual, start, ours)

    attitude, _ = drawn(ROTATIONS, 0.0, 1.0)
    first = jax.random.normal(jax.random.key(1), (COUNT, 6))
    return Case(
        "least_squares", pose, {"easy": (attitude, first), "hard": (attitude, 1e3 * first)}, LEAST, can_be_met=False
    )


def consistent_points():
    """Consistent points of the derivative array of the curved arc to level 2, from random starts: 3 equations, 9
    unknowns."""
    problem = SINGULAR["curved arc"]().problem
    points = random_starts(problem, 2, COUNT, 0, None)
    array, rows = DerivativeArray(problem, 2), points.sizes.rows

    def pose(data, mark):
        z, center, jet, unit, _ = data

        def residual(c):
            d = unit * mark(c)
            moved = z[0] + d[:3], z[1] + d[3:6]
            return jnp.ravel(array(moved, center, jet + d[6:].reshape(jet.shape)) / rows)

        return Posed(residual, jnp.zeros(unit.shape))

    def host(data):
        found = make_consistent(select(points, np.asarray(data[-1])), 2, False)
        return (found.at.z, data[1], found.at.jet, data[3], data[-1]), found.consistent

    data = points.at.z, points.centers, points.at.jet, points.units.both, np.arange(COUNT)
    return Case("make_consistent", pose, {"easy": data}, LEAST, host=lambda: host)


def centres():
    """The rotation midway between two, ``R_x(-v)`` and ``R_x(v)``, from one beside: all pairs at once in NumPy."""
    retraction = Cayley(ROTATIONS)

    def pose(data, mark):
        near, begin, end = data
        frame = ROTATIONS.basis(near)

        def residual(c):
            moved = retraction(near, vec.combine(frame, mark(c)))
            return sum(vec.components(frame, retraction.preimage(moved, q)) for q in (begin, end))

        return Posed(residual, jnp.zeros(3))

    def host():
        chart = Chart(retraction, AutomaticEvaluator())

        def found(data):
            x = chart.centres(*(a.reshape(-1, 9) for a in data)).reshape(-1, 3, 3)
            return (x, *data[1:]), np.isfinite(x).all(axis=(1, 2))

        return found

    def start_at(length):
        x, v = drawn(ROTATIONS, *length)
        begin, end = jax.vmap(retraction)(x, -v), jax.vmap(retraction)(x, v)
        beside = jax.vmap(lambda x, v: retraction(x, 0.3 * v))(x, jnp.roll(v, 1, axis=0))
        return jax.vmap(ROTATIONS.restore)(jax.vmap(ROTATIONS.restore)(beside)), begin, end

    return Case("Chart.centres", pose, {"easy": start_at((0.1, 0.3)), "hard": start_at((1.0, 3.0))}, host=host)


CASES: dict[str, Callable[[], Case]] = {
    "inverse, sphere": lambda: inverse_retraction(Exponential(Sphere(2)), (0.1, 1.5), (1.5, 3.1)),
    "inverse, ellipsoid": lambda: inverse_retraction(ProjectionByNewton(Ellipsoid((3,))), (0.05, 0.3), (0.3, 1.5)),
    "inverse, Stiefel": partial(inverse_retraction, Exponential(Stiefel(4, 2)), (0.1, 1.0), (2.0, 3.1), True),
    "projection, ellipsoid": level_set_projection,
    "step, pendulum": lambda: implicit_step("pendulum", 0.1, 2.0),
    "step, rigid body": lambda: implicit_step("rigid body", 0.1, 2.0),
    "step, rigid body, Gauss 3": lambda: implicit_step("rigid body, Gauss 3", 0.1, 2.0),
    "point of an ellipsoid": point_of_level_set,
    "point of P_f": point_of_final_manifold,
    "costates at an end": costates_at_an_end,
    "consistent points": consistent_points,
    "centres of steps": centres,
}
