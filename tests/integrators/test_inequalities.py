"""Bounds and constraints: optima known in other ways, units, what is active and what is not, and what contradicts."""

import itertools
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Guess, OptimalControlProblem, Solver, discretization_error, solve
from retrax.manifolds import SO, ConvergenceError, Euclidean, Sphere, hat
from retrax.retractions import Addition, Cayley, Gauss, Midpoint, default_retraction
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

PLANE = Euclidean(2)
STEPS = 40


def cart(bound=None, constraints=None):
    """A cart of unit mass with the force ``u``, in the state (position, velocity)."""

    def dynamics(q, u):
        return jnp.stack([q[1], u[0]])

    bounds = None if bound is None else (-bound, bound)
    return OptimalControlProblem(
        PLANE, dynamics, lambda q, u: u @ u / 2, 1, control_bounds=bounds, constraints=constraints
    )


def clipped_forces(bound):
    """The least effort over a unit of way and time in midpoint steps, and its slope: forces are linear in time, and cut
    off."""
    t = (np.arange(STEPS) + 0.5) / STEPS

    def forces(slope):
        return np.clip(slope * (t - 0.5), -bound, bound)

    slope = brentq(lambda slope: np.sum(forces(slope) * (1 - t)) / STEPS - 1, -1e4, -1.0, xtol=1e-12, rtol=1e-15)
    return forces(slope), slope


@pytest.mark.parametrize("bound", [4.2, 4.5, 5.0, 5.8, 5.84, 5.86, 5.9, 6.5, 100.0])
@pytest.mark.usual(2)
def test_forces_are_those_of_the_conditions_as_a_bound_becomes_active(bound):
    solution = solve(
        cart(bound), np.zeros(2), np.array([1.0, 0.0]), 1.0, method=Midpoint(default_retraction(PLANE)), steps=STEPS
    )
    expected, slope = clipped_forces(bound)
    # At 5 a bound is met with the multiplier zero: there s = nu = sqrt(mu).
    np.testing.assert_allclose(solution.controls[:, 0], expected, atol=1e-5 if bound == 5 else 1e-8)
    assert solution.checks.strict_minimum
    lower, upper = (solution.multipliers[f"control_bounds {side}"][:, 0] for side in ("lower", "upper"))
    unbounded = slope * (solution.stage_times - 0.5)
    np.testing.assert_allclose(
        upper - lower, unbounded - expected, atol=(1e-5 if bound == 5 else 1e-7) * max(1, np.max(np.abs(unbounded)))
    )
    assert np.all(lower >= 0)
    assert np.all(upper >= 0)


@cache
def limited_way():
    """Of one metre in one second."""
    return solve(
        cart(4.5), np.zeros(2), np.array([1.0, 0.0]), 1.0, method=Gauss(2, default_retraction(PLANE)), steps=STEPS
    )


@pytest.mark.parametrize(("length", "time"), [(2, 1), (1e-9, 1), (1e9, 1), (1, 1e4), (1e4, 1e-3), (1e-6, 1e6)])
@pytest.mark.usual(2)
def test_units_do_not_matter(length, time):
    bound = 4.5 * length / time**2
    end = np.array([length, 0.0])
    solution = solve(
        cart(bound), np.zeros(2), end, float(time), method=Gauss(2, default_retraction(PLANE)), steps=STEPS
    )
    here = limited_way()
    assert solution.cost * time**3 / length**2 == pytest.approx(here.cost, rel=1e-9)
    assert abs(solution.statistics.iterations - here.statistics.iterations) <= 2


@pytest.mark.parametrize("bound", [3.0, 3.9, 3.99])
def test_bounds_that_do_not_reach_the_end_are_named(bound):
    solution = solve(
        cart(bound),
        np.zeros(2),
        np.array([1.0, 0.0]),
        1.0,
        method=Midpoint(default_retraction(PLANE)),
        steps=STEPS,
        throw=False,
    )
    assert not solution.success
    assert "contradict" in solution.result
    assert "control_bounds upper" in solution.result


@pytest.mark.parametrize("bound", [4.01, 4.1])
def test_bounds_that_barely_reach_the_end_do(bound):
    assert solve(
        cart(bound), np.zeros(2), np.array([1.0, 0.0]), 1.0, method=Midpoint(default_retraction(PLANE)), steps=STEPS
    ).success


@pytest.mark.parametrize("limit", [1 / 12, 1 / 9, 1 / 6, 0.2, 0.3])
@pytest.mark.usual(1)
def test_a_state_that_is_kept_below_a_limit(limit):
    """Bryson and Denham's problem, through the limits at which the state touches at a point (1/4) and along an arc
    (1/6)."""
    optimum = 4 / (9 * limit) if limit <= 1 / 6 else 2 + 6 * max(0.0, 1 - 4 * limit) ** 2
    problem = cart(constraints={"height": lambda q, u: q[0] - limit})
    solution = solve(
        problem, np.array([0.0, 1.0]), np.array([0.0, -1.0]), 1.0, method=Gauss(3, default_retraction(PLANE)), steps=60
    )
    assert solution.cost == pytest.approx(optimum, rel=2e-4)
    assert np.max(solution.stage_states[:, 0]) <= limit * (1 + 1e-9)
    assert (np.max(solution.multipliers["height"]) > 1e-6) == (limit < 1 / 4)


@pytest.mark.parametrize("steps", [10, 30])
@pytest.mark.parametrize("method", [Midpoint, lambda r: Gauss(3, r)], ids=["midpoint", "Gauss"])
@pytest.mark.usual(1)
def test_a_path_that_begins_inside_a_forbidden_cone_goes_round_it(steps, method):
    axis, sphere = np.array([0.0, 0.6, 0.8]), Sphere(2)
    cone = {"cone": lambda q, u: q @ axis - np.cos(np.deg2rad(25))}
    problem = OptimalControlProblem(sphere, lambda q, u: jnp.cross(u, q), lambda q, u: u @ u / 2, 3, constraints=cone)
    end = np.array([0.05, 0.0, 1.0]) / np.hypot(0.05, 1.0)
    solution = solve(
        problem, np.array([0.0, 1.0, 0.0]), end, 1.0, method=method(default_retraction(sphere)), steps=steps
    )
    # Two arcs of great circles that touch the cone, and the piece of its rim between them.
    rim = np.deg2rad(25)

    def aside(point):
        away = np.arccos(point @ axis)
        tangent, turned = np.arccos(np.cos(away) / np.cos(rim)), np.arccos(np.tan(rim) / np.tan(away))
        return tangent, turned

    first, last = aside(np.array([0.0, 1.0, 0.0])), aside(end)
    sides = [point - (point @ axis) * axis for point in (np.array([0.0, 1.0, 0.0]), end)]
    whole = np.arccos(sides[0] @ sides[1] / np.linalg.norm(sides[0]) / np.linalg.norm(sides[1]))
    length = first[0] + last[0] + (whole - first[1] - last[1]) * np.sin(rim)
    assert solution.cost == pytest.approx(length**2 / 2, rel=2e-2 if steps == 10 else 2e-3)
    assert solution.checks.violation <= 1e-10
    assert solution.checks.conserved == dict.fromkeys(solution.checks.conserved, 0)


@pytest.mark.parametrize("height", [0.45, 0.529, 0.531, 0.8])
@pytest.mark.usual(1)
def test_momenta_are_those_of_symmetries_that_active_constraints_share(height):
    """A great circle that rises to 0.53, below a ceiling."""
    sphere, ceiling = Sphere(2), {"ceiling": lambda q, u: q[2] - height}
    problem = OptimalControlProblem(
        sphere, lambda q, u: jnp.cross(u, q), lambda q, u: u @ u / 2, 3, constraints=ceiling
    )
    ends = (np.array(q) / np.linalg.norm(q) for q in ([1.0, 0.0, 0.4], [-0.2, 1.0, 0.4]))
    checks = solve(problem, *ends, 1.0, method=Gauss(2, default_retraction(sphere)), steps=8).checks
    assert (checks.active["ceiling"] > 0) == (height < 0.53)
    assert [*checks.conserved.values()] == [1 if height < 0.53 else 3]  # the ceiling is level
    assert (max(checks.momentum_spreads.values()) < 1e-8) == (height > 0.53)


def test_wide_bounds_change_nothing():
    free = solve(
        cart(), np.zeros(2), np.array([1.0, 0.0]), 1.0, method=Gauss(2, default_retraction(PLANE)), steps=STEPS
    )
    for bound in (10.0, 1e3, 1e6):
        bounded = solve(
            cart(bound), np.zeros(2), np.array([1.0, 0.0]), 1.0, method=Gauss(2, default_retraction(PLANE)), steps=STEPS
        )
        np.testing.assert_allclose(bounded.controls, free.controls, atol=1e-9)


def limited_slew(bound):
    """A rest-to-rest slew of a spacecraft with limited torques."""
    inertia, attitudes = np.array([5621.0, 4547.0, 2364.0]), SO(3)

    def dynamics(q, u):
        return q[0] @ hat(q[1]), (u - jnp.cross(q[1], inertia * q[1])) / inertia

    return OptimalControlProblem(
        attitudes * Euclidean(3),
        dynamics,
        lambda q, u: u @ u / 2,
        3,
        control_bounds=None if bound is None else (-bound, bound),
    )


def test_a_batch_of_limited_slews_is_its_members():
    problem = limited_slew(10.0)
    solver = Solver(problem, Gauss(2, Cayley(problem.manifold)), 20)
    targets = Rotation.from_rotvec(np.random.default_rng(1).uniform(-0.7, 0.7, (5, 3)))
    start = np.eye(3), np.zeros(3)
    ends = targets.as_matrix(), np.zeros((5, 3))
    many = solver.solve_many(start, ends, 60.0)
    assert np.all(many.success)
    for k, one in enumerate(many):
        alone = solver.solve(start, (ends[0][k], np.zeros(3)), 60.0)
        assert one.cost == pytest.approx(alone.cost, rel=1e-9)
        assert np.max(np.abs(one.controls)) <= 10 * (1 + 1e-9)


@pytest.mark.parametrize("method", [Midpoint, lambda r: Gauss(2, r)], ids=["midpoint", "Gauss"])
def test_derivatives_with_active_bounds(method):
    problem = limited_slew(10.0)
    solver = Solver(problem, method(Cayley(problem.manifold)), 20)
    start = np.eye(3), np.zeros(3)
    end = Rotation.from_rotvec(np.deg2rad(150) * np.array([1, 2, -2]) / 3).as_matrix(), np.zeros(3)
    solution = solver.solve(start, end, 60.0)
    assert np.max(np.abs(solution.controls)) == pytest.approx(10, rel=1e-9)
    near = [solver.solve(start, end, 60.0 + step) for step in (-1e-3, 1e-3)]
    found = solver.sensitivity(solution).horizon
    assert found.cost == pytest.approx((near[1].cost - near[0].cost) / 2e-3, rel=1e-5)
    np.testing.assert_allclose(found.controls, (near[1].controls - near[0].controls) / 2e-3, atol=2e-4)


@pytest.fixture(scope="module", params=[Midpoint, lambda r: Gauss(2, r)], ids=["midpoint", "Gauss"])
def avoiding(request):
    """A direction that keeps ``cos`` of its angle from an axis below a number."""
    sphere, axis = Sphere(2), np.array([0.0, 0.6, 0.8])
    cone = {"cone": lambda q, u, p: q @ axis - p}
    problem = OptimalControlProblem(
        sphere, lambda q, u, p: jnp.cross(u, q), lambda q, u, p: u @ u / 2, 3, constraints=cone
    )
    return Solver(problem, request.param(default_retraction(sphere)), 10)


@pytest.mark.parametrize("angle", [1.0, 2.0, 2.2, 2.4, 3.0, 10.0, 25.0])
@pytest.mark.usual(2)
def test_derivatives_and_minima_as_a_cone_becomes_active(avoiding, angle):
    """The way is 2.3 degrees from the axis; around a wider cone, the curvature beside it is not lost in its
    stiffness."""
    ends = np.array([0.0, 1.0, 0.0]), np.array([0.05, 0.0, 1.0]) / np.hypot(0.05, 1.0)
    limit, step = np.cos(np.deg2rad(angle)), 1e-6
    solution = avoiding.solve(*ends, 1.0, parameters=limit)
    assert solution.checks.strict_minimum
    found = avoiding.sensitivity(solution)
    later = [avoiding.solve(*ends, 1.0 + way * step, solution, limit) for way in (-1, 1)]
    wider = [avoiding.solve(*ends, 1.0, solution, limit + way * step) for way in (-1, 1)]
    for derivative, near in ((found.horizon, later), (found.parameters, wider)):
        assert derivative.cost == pytest.approx((near[1].cost - near[0].cost) / (2 * step), rel=1e-6, abs=1e-8)
        for name in ("states", "costates", "controls"):
            difference = (getattr(near[1], name) - getattr(near[0], name)) / (2 * step)
            np.testing.assert_allclose(
                getattr(derivative, name), difference, atol=1e-4 * max(1.0, np.max(np.abs(difference)))
            )


@pytest.mark.parametrize("degrees", [90.0, 150.0, 179.0, 179.9, 180.0])
@pytest.mark.usual(3)
def test_an_inactive_cone_leaves_conjugate_ends_conjugate(avoiding, degrees):
    turn, start = np.deg2rad(degrees), np.array([1.0, 0.0, 0.0])
    problem, controls = avoiding.problem.with_parameters(2.0), np.array([0.0, 0.0, turn])
    guess = Guess.from_controls(problem, avoiding.method, start, lambda t: controls, 1.0, 10)
    solution = avoiding.solve(start, np.array([np.cos(turn), np.sin(turn), 0.0]), 1.0, guess, 2.0)
    assert solution.cost == pytest.approx(turn**2 / 2, rel=1e-2)
    assert solution.checks.strict_minimum == (degrees < 180)
    if degrees == 180:
        with pytest.raises(ConvergenceError, match="conjugate"):
            avoiding.sensitivity(solution)
    else:
        assert avoiding.sensitivity(solution).horizon.cost == pytest.approx(-solution.cost, rel=1e-6)


def test_the_barrier_falls_to_its_last_value_in_any_unit_of_the_cost():
    """By rounding it may end a little above it, where it does not fall on for ever."""
    line = Euclidean(1)

    def cost(q, u, unit):
        return unit * (q @ q + u @ u) / 2

    problem = OptimalControlProblem(line, lambda q, u, unit: u, cost, 1, control_bounds=(-0.5, 0.5))
    units = np.linspace(1.0, 10.0, 50)
    many = Solver(problem, Gauss(2, default_retraction(line)), 4).solve_many(np.ones(1), None, 1.0, parameters=units)
    assert many.success.all()
    np.testing.assert_allclose(many.cost / units, many.cost[0], rtol=1e-10)


def test_a_slew_that_its_torques_cannot_make_is_said_to_be_impossible():
    """A turn about an axis by ``a`` in the time T needs a torque of ``4 J a / T^2``; the cheapest turn has ``6 J a /
    T^2``.

    With somewhat less torque there are turns that leave the axis [Bilimoria, Wie 1993]. No turn is faster than that of
    the torque ``sqrt(3) most`` about an axis of the least inertia.
    """
    body, inertia, angle = SO(3) * Euclidean(3), jnp.array([3.0, 2.0, 1.5]), 2.0
    end = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])

    def turning(q, u, most):
        rate = q[1]
        return q[0] @ hat(rate), (most * u - jnp.cross(rate, inertia * rate)) / inertia

    problem = OptimalControlProblem(body, turning, lambda q, u, most: u @ u / 2, 3, control_bounds=(-1.0, 1.0))
    solver = Solver(problem, Midpoint(Cayley(body)), 20)
    for share in (0.15, 0.3, 0.6, 0.65, 0.68, 0.8, 1.1):
        most = share * 6 * 3.0 * angle / 4.0**2
        found = solver.solve((np.eye(3), np.zeros(3)), (end, np.zeros(3)), 4.0, parameters=np.array(most), throw=False)
        if not found.success:
            assert share < 2 / 3, share
            assert "contradict" in found.result
            continue
        assert np.sqrt(3) * most > 4 * 1.5 * angle / 4.0**2, share
        assert np.max(np.abs(found.controls)) <= 1
        assert (np.max(np.abs(found.states[1][:, 1:])) > 0.1) == (share < 2 / 3), share
        way = discretization_error(problem, Cayley(body), found, parameters=np.array(most))
        assert max(way.largest.values()) < 0.01


@pytest.mark.slow
def test_random_slews_with_limits_are_solved_or_impossible():
    """By shares of the largest torque of the slews without limits: a turn about one axis needs two thirds of it."""
    body, rng, count = SO(3) * Euclidean(3), np.random.default_rng(5), 40

    def turning(q, u, given):
        torque = given["torque"] * u
        return q[0] @ hat(q[1]), (torque - jnp.cross(q[1], given["inertia"] * q[1])) / given["inertia"]

    def effort(q, u, given):
        return given["torque"] ** 2 * u @ u / 2

    masses = rng.uniform(0.05, 1.0, (count, 3))
    inertia, ends = (
        masses.sum(axis=1, keepdims=True) - masses,
        (Rotation.random(count, rng=rng).as_matrix(), np.zeros((count, 3))),
    )
    start, given, solved = (np.eye(3), np.zeros(3)), {"inertia": inertia, "torque": np.ones(count)}, []
    free, limited = (
        Solver(OptimalControlProblem(body, turning, effort, 3, control_bounds=bounds), Midpoint(Cayley(body)), 20)
        for bounds in (None, (-1.0, 1.0))
    )
    peaks = np.array([np.abs(found.controls).max() for found in free.solve_many(start, ends, 10.0, parameters=given)])
    for share in (0.45, 0.6, 0.63, 0.66, 0.7, 0.9):
        many = limited.solve_many(start, ends, 10.0, parameters=given | {"torque": share * peaks})
        assert all(found.success or "contradict" in found.result for found in many), share
        solved.append(many.success)
    assert not solved[0].any()
    assert solved[-1].all()
    assert all(np.all(less <= more) for less, more in itertools.pairwise(solved))


@pytest.mark.slow
def test_ten_thousand_steps_with_bounds_that_hold():
    """A cart from rest to rest by 1 m in 1 s, which would take 6 m/s^2 at most."""
    plane = Euclidean(2)
    problem = OptimalControlProblem(
        plane, lambda q, u: jnp.stack([q[1], u[0]]), lambda q, u: u @ u / 2, 1, control_bounds=(-5.0, 5.0)
    )
    found = solve(problem, np.zeros(2), np.array([1.0, 0.0]), 1.0, method=Midpoint(Addition(plane)), steps=10_000)
    assert found.checks.strict_minimum
    assert found.checks.active["control_bounds upper"] > 1000
    # u is odd about the middle and linear between the bounds, for a share b of the time: 5/4 - 5 b^2 / 12 is the way.
    rest = np.sqrt(3 / 5)
    assert np.mean(np.abs(found.controls) < 5 * (1 - 1e-6)) == pytest.approx(rest, rel=1e-3)
    assert found.cost == pytest.approx(25 / 2 * (1 - rest + rest / 3), rel=1e-6)
