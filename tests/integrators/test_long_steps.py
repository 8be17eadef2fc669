"""Guesses from which Newton's first step is too long, or has no direction: at rest without drift, or opposite to the
end."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from retrax import problems
from retrax.integrators import Guess, OptimalControlProblem, Solver
from retrax.manifolds import SO, Euclidean, hat
from retrax.retractions import Cayley, Midpoint, default_retraction

from .problems import half_square, rotation

N, Q = 20, SO(3)
TURNED = OptimalControlProblem(Q, lambda q, u: q @ hat(jnp.append(u, 0.0)), half_square, 2)
AXIS = np.array([0.6, 0.0, 0.8])


@cache
def turning():
    return Solver(TURNED, Midpoint(default_retraction(Q)), N)


@cache
def slewing():
    problem = OptimalControlProblem(Q * Euclidean(3), lambda q, u: (q[0] @ hat(q[1]), u), half_square, 3)
    return Solver(problem, Midpoint(Cayley(Q * Euclidean(3))), N)


FAR = 0.07  # controls smaller than that are moved aside, by which the trajectory goes half its spread


@pytest.mark.parametrize("size", [0.0, 1e-15, 1e-8, *10.0 ** np.arange(-2.5, 1.01, 0.25)])
@pytest.mark.usual(2)
def test_a_guess_nearly_at_rest_leads_to_a_solution(size):
    times, shares = np.linspace(0, 1, N), []
    solver, end = turning(), rotation([0.4, -0.3, 1.6])
    controls = size * np.stack([np.cos(times), np.sin(2 * times)], axis=1)
    guess = Guess.from_controls(TURNED, solver.method, np.eye(3), controls, 1.0, N)
    found = solver.solve(np.eye(3), end, 1.0, guess=guess, throw=False, callback=lambda i: shares.append(i.fraction[0]))
    assert found.success
    assert found.cost < 16  # with a turn more than needed at most, and not with hundreds
    # The first step is as long as the controls are small: a diameter is this share of it.
    if size > FAR:
        assert shares[0] == pytest.approx(min(1.17 * size, 1.0), rel=0.1)
    else:
        assert shares[0] > 0.3


@pytest.mark.parametrize("angle", np.pi + np.array([-1.0, -0.1, -1e-2, -1e-6, 0.0, 1e-6, 1e-2, 0.1]))
@pytest.mark.parametrize("rate", [0.0, 10.0])
@pytest.mark.usual(2)
def test_ends_that_are_opposite_come_together(angle, rate):
    # All attitudes of the guess are the first one; rates far larger than their entries do not hide the way to the last.
    end = rotation(angle * AXIS), np.zeros(3)
    states = np.tile(np.eye(3), (N, 1, 1)), np.tile(rate * AXIS, (N, 1))
    guess = Guess(states, np.zeros((N, 3)))
    found = slewing().solve((np.eye(3), np.zeros(3)), end, 1.0, guess=guess, throw=False)
    assert found.success


@pytest.mark.parametrize("tilt", [0.0, 1e-16, 1e-12, 1e-4, 1e-2])
@pytest.mark.parametrize("angle", [0.3, 1.2, 2.5, 3.1])
def test_a_turn_that_no_control_gives_to_first_order_is_found(angle, tilt):
    """About the third axis the constraints of the default guess are dependent, and next to it nearly."""
    end = rotation([tilt, 0.0, angle])
    found = turning().solve(np.eye(3), end, 1.0, throw=False)
    assert found.success
    # The shortest curve is sqrt(angle (4 pi - angle)) long.
    assert found.cost == pytest.approx(angle * (4 * np.pi - angle) / 2, rel=0.02 + 5 * tilt / angle)


def spun(q, u):
    """Angles and rates of which products alone move the third; angles in units of their own."""
    angles, rates = q[:3], q[3:]
    return jnp.concatenate([LONG * rates, jnp.stack([*u, rates[0] * rates[1]]) + 0 * angles])


LONG = 1e3


@cache
def spinning():
    space = Euclidean(6)
    return Solver(OptimalControlProblem(space, spun, half_square, 2), Midpoint(default_retraction(space)), N)


@pytest.mark.parametrize("size", [0.0, *10.0 ** np.arange(-12, 2.0, 2), 3.0])
@pytest.mark.usual(2)
def test_a_rate_that_only_products_change_is_no_obstacle(size):
    end = np.array([1.0, 0.5, 0.3, 0, 0, 0]) * np.array([LONG, LONG, LONG, 1, 1, 1])
    solver = spinning()
    guess = Guess.from_waypoints(solver.problem, solver.method, [np.zeros(6), end], N)
    guess = guess._replace(controls=size * np.random.default_rng(0).standard_normal((N, 2)))
    found = solver.solve(np.zeros(6), end, 3.0, guess=guess, throw=False)
    assert found.success
    assert found.cost == pytest.approx(1.910, abs=1e-3)


@cache
def weakened():
    """A spacecraft without the torque about its third axis."""
    entry = problems.get("failed-actuator")
    return entry, Solver(entry.problem, entry.discretization, N)


@pytest.mark.parametrize("size", 10.0 ** np.arange(-4, 1.5))
@pytest.mark.usual(2)
def test_a_guess_near_to_rest_hides_no_unit(size):
    """Beside a rate that 1e-4 N m hardly move, no step would come near to the constraints in the unit of that."""
    entry, solver = weakened()
    guess = Guess.from_waypoints(entry.problem, entry.discretization, [entry.start, entry.end], N)
    guess = guess._replace(controls=size * np.random.default_rng(1).standard_normal(guess.controls.shape))
    found = solver.solve(entry.start, entry.end, entry.horizon, guess=guess, throw=False)
    assert found.success
    assert found.cost >= entry.optimum
