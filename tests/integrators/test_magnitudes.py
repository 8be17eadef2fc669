"""Horizons of another magnitude than their guess, and controls whose directions are not all determined by what they
move."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Phase, Solver, solve, solve_phases
from retrax.manifolds import Euclidean, Sphere
from retrax.retractions import Addition, Exponential, Gauss, Midpoint
from scipy.optimize import brentq

PLANE, GLOBE = Euclidean(2), Sphere(2)
MIDPOINT, GAUSS = Midpoint(Addition(PLANE)), Gauss(2, Addition(PLANE))
REST = np.zeros(2)
HORIZONS = ["1e-09", "1e-08", "7e-07", "1.1e-06", "1e-05", "0.001", "0.1", "1.0", "30.0", "1000.0", "1e+06"]
WINDS = ["0.0", "1e-12", "1e-09", "1e-06", "0.001", "0.1", "0.5", "0.9"]
ANGLE = 1.2


def cart(q: jax.Array, u: jax.Array) -> jax.Array:
    return jnp.stack([q[1], u[0]])


def effort(weight: float) -> OptimalControlProblem:
    """``int (w + u^2 / 2) dt`` from rest to rest over a length of one: ``T^4 = 18 / w``, cost ``4 w T / 3``."""
    return OptimalControlProblem(PLANE, cart, lambda q, u: weight + u @ u / 2, 1)


@pytest.mark.parametrize("horizon", HORIZONS)
@pytest.mark.usual("7e-07", "0.001", "1000.0")
def test_a_horizon_is_found_whatever_its_guess(horizon):
    exact = float(horizon)
    weight = 18 / exact**4
    found = solve(effort(weight), REST, np.array([1.0, 0.0]), Free(1.0), method=GAUSS, steps=10)
    assert found.horizon == pytest.approx(exact, rel=1e-8)
    assert found.cost == pytest.approx(4 * weight * exact / 3, rel=1e-8)
    assert found.checks.strict_minimum


@pytest.mark.parametrize("horizon", HORIZONS)
@pytest.mark.usual("7e-07", "1000.0")
def test_a_least_time_is_found_whatever_its_guess(horizon):
    """From rest to rest over ``T^2 / 4`` with ``|u| <= 1``."""
    exact = float(horizon)
    quickest = OptimalControlProblem(PLANE, cart, lambda q, u: 1.0, 1, control_bounds=(-1, 1))
    found = solve(quickest, REST, np.array([exact**2 / 4, 0.0]), Free(1.0), method=MIDPOINT, steps=10)
    assert found.horizon == pytest.approx(exact, rel=1e-8)
    np.testing.assert_allclose(found.controls.ravel(), np.repeat([1.0, -1.0], 5), atol=1e-7)


def test_a_horizon_is_looked_for_between_its_bounds_only_and_in_batches_too():
    solver = Solver(effort(18 / 1e-5**4), GAUSS, 10)
    end = np.array([1.0, 0.0])
    bounded = solver.solve(REST, end, Free(1.0, 1e-3, 1e3), throw=False)
    assert not bounded.success or bounded.horizon == pytest.approx(1e-3, rel=1e-6)
    many = solver.solve_many(REST, end, Free(np.array([1.0, 1e-5])))
    assert many.success.all()
    np.testing.assert_allclose([one.horizon for one in many], 1e-5, rtol=1e-8)
    seen = solver.solve(REST, end, Free(1.0), callback=lambda it: it.number >= 2, throw=False)
    assert seen.statistics.iterations == 2  # an iteration that was stopped does not begin again


@pytest.mark.slow
@pytest.mark.parametrize("duration", ["1e-07", "0.0001", "1000.0"])
def test_durations_of_phases_are_found_whatever_their_guesses(duration):
    """Two halves of one transfer, whose middle is left to the cost."""
    exact = float(duration)
    problem = effort(18 / (2 * exact) ** 4)
    first = Phase(problem, GAUSS, 5, Free(1.0), start=REST)
    second = Phase(problem, GAUSS, 5, Free(1.0), end=np.array([1.0, 0.0]))
    middle = {"middle": lambda ends: ends[0].end[0] - 0.5}
    found = solve_phases([first, second], boundary_constraints=middle)
    np.testing.assert_allclose([phase.horizon for phase in found.phases], exact, rtol=1e-7)


def crossing(wind: float) -> float:
    """The least time at unit speed: the arc to where the air that is above the target by then is at the start."""
    start = np.array([1.0, 0.0, 0.0])

    def behind(time: float) -> float:
        turn = np.array([np.cos(wind * time), -np.sin(wind * time), 0.0])
        end = np.array([np.cos(ANGLE) * turn[0], np.cos(ANGLE) * turn[1], np.sin(ANGLE)])
        return np.arctan2(np.linalg.norm(np.cross(start, end)), start @ end) - time

    return brentq(behind, 0.5, 3.0, xtol=1e-14)


@cache
def navigator(controls: str, stages: int, steps: int) -> Solver:
    """In the least time, in a wind and at a speed that are parameters."""
    axis = jnp.array([0.0, 0.0, 1.0])

    def fly(q: jax.Array, u: jax.Array, given: tuple) -> jax.Array:
        wind, speed = given
        return speed * jnp.cross(u, q) + wind * jnp.cross(axis, q)

    limits = {"speed": lambda q, u, given: u @ u - 1} if controls == "ball" else None
    among = 3 if controls == "ball" else GLOBE
    problem = OptimalControlProblem(GLOBE, fly, lambda q, u, given: 1.0, among, constraints=limits)
    return Solver(problem, Gauss(stages, Exponential(GLOBE)), steps)


@pytest.mark.parametrize("wind", WINDS)
@pytest.mark.parametrize("controls", ["ball", "sphere"])
@pytest.mark.usual(1)
def test_a_least_time_on_the_sphere_without_wind_and_with_it(controls, wind):
    """The component of the axis of turning along the position moves nothing, and wastes speed."""
    ends = np.array([1.0, 0.0, 0.0]), np.array([np.cos(ANGLE), 0.0, np.sin(ANGLE)])
    found = navigator(controls, 3, 12).solve(*ends, Free(1.0), parameters=(float(wind), 1.0))
    assert found.horizon == pytest.approx(crossing(float(wind)), rel=1e-9)
    np.testing.assert_allclose(np.linalg.norm(found.controls, axis=-1), 1.0, atol=1e-8)
    assert found.checks.strict_minimum


@pytest.mark.parametrize("speed", [1.0, 1e2, 5e-3])
@pytest.mark.usual(1)
def test_a_solution_as_guess_is_still_a_strict_minimum(speed):
    """On the bound of a ball controls have no room along it but by its curvature."""
    solver, given = navigator("ball", 2, 10), (0.0, speed)
    ends = np.array([1.0, 0.0, 0.0]), np.array([np.cos(ANGLE), 0.0, np.sin(ANGLE)])
    first = solver.solve(*ends, Free(1.0), parameters=given)
    again = solver.solve(*ends, Free(first.horizon), guess=first, parameters=given)
    for found in (first, again):
        assert found.horizon == pytest.approx(ANGLE / speed, rel=1e-9)
        assert found.checks.strict_minimum


@pytest.mark.parametrize("angle", [1e-7, 1e-5, 1e-3, 1e-2])
def test_a_short_way_on_the_sphere_in_least_time(angle):
    ends = np.array([1.0, 0.0, 0.0]), np.array([np.cos(angle), 0.0, np.sin(angle)])
    found = navigator("ball", 2, 10).solve(*ends, Free(1.0), parameters=(0.0, 1.0), throw=False)
    assert found.success, found.result
    assert found.horizon == pytest.approx(angle, rel=1e-9)
