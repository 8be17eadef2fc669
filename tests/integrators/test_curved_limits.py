"""Limits whose slope at the guess tells nothing of where they hold: balls, products, and the same limit bent."""

from functools import cache
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Phase, Solution, Solver, solve, solve_phases
from retrax.retractions import Addition, Cayley, Gauss, Midpoint

from tests.integrators.problems import IDENTITY, PLANE, REST, RIGID, SLEW_END, half_square, particle, spacecraft

METHODS = Midpoint(Addition(PLANE)), Gauss(2, Addition(PLANE))


def effort(_: Any, u: Any, *__: Any) -> Any:
    """``|u|^2 / 2``."""
    return half_square(_, u)


@cache
def under(limit: Any, method: Any) -> Solver:
    """Of the particle under a limit, the last argument of which is a number."""
    problem = OptimalControlProblem(PLANE, particle, effort, 1, constraints={"limit": limit})
    return Solver(problem, method, 20)


def moved(limit: Any, method: Any, number: float) -> Solution:
    """From rest to rest in one second, by one metre, under a limit; the guess has no control."""
    return under(limit, method).solve(np.zeros(2), np.array([1.0, 0.0]), 1.0, parameters=number)


@cache
def within(most: float, method: Any) -> Solution:
    """The same with a bound of the control."""
    problem = OptimalControlProblem(PLANE, particle, effort, 1, control_bounds=(-most, most))
    return solve(problem, np.zeros(2), np.array([1.0, 0.0]), 1.0, method=method, steps=20)


POWERS = {power: lambda q, u, most, power=power: (u[0] / most) ** power - 1 for power in (2, 4)}


@pytest.mark.parametrize("most", [4.6, 5.0, 5.699, 5.701, 6.2, 10.0, 30.0, 1000.0])
@pytest.mark.parametrize("power", POWERS)
@pytest.mark.usual(2)
def test_a_power_of_the_control_is_limited_as_the_control_is(most, power):
    """The largest control of the free optimum of the midpoint rule is some 5.7."""
    for method in METHODS:
        bent = moved(POWERS[power], method, most)
        assert bent.cost == pytest.approx(within(most, method).cost, rel=1e-8)
        assert bent.checks.strict_minimum


def ball(_: Any, u: Any, scale: Any) -> Any:
    """A square of the control, in any unit."""
    return scale * (u @ u - 25)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_the_unit_of_a_ball_does_not_matter(scale):
    assert moved(ball, METHODS[0], scale).cost == pytest.approx(moved(ball, METHODS[0], 1.0).cost, rel=1e-9)


SPEEDS = {
    "as it is": lambda q, u, top: q[1] - top,
    "tanh": lambda q, u, top: jnp.tanh(5 * (q[1] - top)),
    "exp": lambda q, u, top: jnp.exp(20 * (q[1] - top)) - 1,
    "cubic": lambda q, u, top: (q[1] - top) + (q[1] - top) ** 3,
}


@pytest.mark.parametrize("top", [1.2, 1.4, 1.499, 1.501, 2.0])
@pytest.mark.parametrize("bend", ["tanh", "exp", "cubic"])
@pytest.mark.usual(2)
def test_a_limit_of_the_speed_is_the_same_however_it_is_bent(bend, top):
    """The largest speed of the free optimum is 1.5."""
    for method in METHODS:
        expected = moved(SPEEDS["as it is"], method, top)
        assert moved(SPEEDS[bend], method, top).cost == pytest.approx(expected.cost, rel=1e-8)


def test_the_size_of_a_torque_is_limited_from_a_guess_without_torque():
    """A ball through the largest torque of the free slew, some 20 N m, and one around it."""
    start, end, retraction = (IDENTITY, REST), (SLEW_END, REST), Cayley(RIGID)
    free = OptimalControlProblem(RIGID, spacecraft, half_square, 3)
    known = solve(free, start, end, 60.0, method=Midpoint(retraction), steps=40)
    largest = np.max(np.linalg.norm(known.controls, axis=1))
    for share in (0.8, 0.999, 1.001, 5.0):
        ball = {"torque": lambda q, u, share=share: u @ u - (share * largest) ** 2}
        problem = OptimalControlProblem(RIGID, spacecraft, half_square, 3, constraints=ball)
        found = solve(problem, start, end, 60.0, method=Midpoint(retraction), steps=40)
        assert np.max(np.linalg.norm(found.controls, axis=1)) <= min(share, 1.0) * largest * (1 + 1e-6)
        if share > 1:
            assert found.cost == pytest.approx(known.cost, rel=1e-9)
        else:
            assert found.cost > known.cost * (1 + 1e-9)


def test_two_halves_are_the_whole():
    """Phases have slacks of their own."""
    limits = {"ball": lambda q, u: ball(q, u, 1.0)}
    problem = OptimalControlProblem(PLANE, particle, effort, 1, constraints=limits)
    first = Phase(problem, METHODS[0], 10, 0.5, start=np.zeros(2))
    found = solve_phases([first, Phase(problem, METHODS[0], 10, 0.5, end=np.array([1.0, 0.0]))])
    assert found.cost == pytest.approx(moved(ball, METHODS[0], 1.0).cost, rel=1e-9)
