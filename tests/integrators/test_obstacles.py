"""Regions that a trajectory keeps out of, with guesses that lead through them."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Solver, solve
from retrax.manifolds import SO, Euclidean, hat
from retrax.retractions import Addition, Cayley, Gauss, Midpoint
from scipy.spatial.transform import Rotation

PLANE = Euclidean(2)


@pytest.mark.slow
def test_a_guess_through_what_is_kept_out_is_led_around_with_any_inertia():
    """A tracker keeps 30 degrees from the sun, which is between its ends: wheels and rates that suffice for less, and
    barely."""
    body, sun, fixed = SO(3) * Euclidean(3), np.array([0.6, 0.8, 0.0]), np.array([0.0, 1.0, 0.0])
    moments = np.array([[0.30, 0.012, -0.004], [0.012, 0.25, 0.006], [-0.004, 0.006, 0.11]])

    def turning(q, u, inertia):
        return q[0] @ hat(q[1]), jnp.linalg.solve(inertia, u - jnp.cross(q[1], inertia @ q[1]))

    held = {
        "keep-out": lambda q, u, inertia: sun @ q[0] @ fixed - np.cos(np.deg2rad(30)),
        "rate": lambda q, u, inertia: q[1] ** 2 / np.deg2rad(2.0) ** 2 - 1.0,
    }
    problem = OptimalControlProblem(
        body, turning, lambda q, u, inertia: u @ u / 2, 3, control_bounds=(-3e-4, 3e-4), constraints=held
    )
    start, end = (
        Rotation.from_euler("zyx", angles, degrees=True).as_matrix() for angles in ([10, 0, 0], [-100, 10, 20])
    )
    factors = np.linspace(0.8, 1.3, 13)
    many = Solver(problem, Gauss(2, Cayley(body)), 15).solve_many(
        (start, np.zeros(3)),
        (end, np.zeros(3)),
        90.0,
        parameters=factors[:, None, None] * moments,
        max_iterations=300,  # it takes up to some 200
    )
    assert many.success.all()
    # Heavier bodies cost more, on one way round: scaled, the cost grows as their square or faster where limits hold.
    assert np.all(np.diff(many.cost / factors**2) > 0)


@pytest.mark.parametrize("beside", [0.0, 1e-12, 1e-6, 0.05])
@pytest.mark.parametrize("radius", [0.1, 0.45])
@pytest.mark.usual(2)
def test_a_guess_through_the_middle_of_an_obstacle_is_led_around(radius, beside):
    """As much speaks for either side there: the path is as long as those around from beside, and is one of them."""
    around = {"disk": lambda q, u: radius**2 - jnp.sum((q - jnp.array([0.5, beside])) ** 2)}
    problem = OptimalControlProblem(PLANE, lambda q, u: u, lambda q, u: u @ u / 2, 2, constraints=around)
    found = solve(problem, np.zeros(2), np.array([1.0, 0.0]), 1.0, method=Midpoint(Addition(PLANE)), steps=20)
    # Straight lines to the disk and an arc around it, at one speed.
    tangents = np.hypot(0.5, beside) ** 2 - radius**2
    angle = np.pi - 2 * np.arctan2(beside, 0.5) - 2 * np.arccos(radius / np.hypot(0.5, beside))
    length = 2 * np.sqrt(tangents) + radius * angle
    assert found.cost == pytest.approx(length**2 / 2, rel=2e-2)
    assert found.checks.strict_minimum
    assert np.all(np.sum((found.stage_states - np.array([0.5, beside])) ** 2, axis=1) >= radius**2 - 1e-7)


@pytest.mark.parametrize("stages", [2, 3])
def test_the_least_time_around_an_island_through_where_it_stands_in_the_way(stages):
    """Zermelo's navigation: the straight guess passes the island until its radius is 0.6, and then leads through it."""

    def velocity(q, u):
        x, y = q[0] - 2, q[1]
        pull = 0.5 / (x**2 + y**2 + 0.5)
        return jnp.stack([jnp.cos(u[0]) - pull * y, jnp.sin(u[0]) + pull * x])

    def island(q, u, radius):
        return radius**2 - (q[0] - 2.2) ** 2 - (q[1] + 0.6) ** 2

    problem = OptimalControlProblem(
        PLANE, lambda q, u, r: velocity(q, u), lambda q, u, r: 1.0, 1, constraints={"island": island}
    )
    solver, times = Solver(problem, Gauss(stages, Addition(PLANE)), 20), []
    for radius in (0.01, 0.3, 0.5, 0.58, 0.62, 0.8, 1.2):
        found = solver.solve(np.zeros(2), np.array([4.0, 0.0]), Free(4.0, 0.5, 20.0), parameters=radius)
        assert found.statistics.iterations <= 80, radius
        times.append(found.horizon)
    assert np.all(np.diff(times) > 0), times
