"""Limits whose slope at the guess tells nothing of where they hold: balls, products, and the same limit bent."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Phase, Solution, solve, solve_phases
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Cayley, Gauss, Midpoint

from tests.integrators.problems import IDENTITY, REST, RIGID, SLEW_END, half_square, spacecraft

PLANE = Euclidean(2)
METHODS = Midpoint(Addition(PLANE)), Gauss(2, Addition(PLANE))


def particle(q: Any, u: Any) -> Any:
    """``x'' = u``."""
    return jnp.stack([q[1], u[0]])


def moved(limit: Any, method: Any) -> Solution:
    """From rest to rest in one second, by one metre, under a limit; the guess has no control."""
    problem = OptimalControlProblem(PLANE, particle, half_square, 1, constraints={"limit": limit})
    return solve(problem, method, np.zeros(2), np.array([1.0, 0.0]), 1.0, 20)


@pytest.mark.parametrize("most", [4.6, 5.0, 5.699, 5.701, 6.2, 10.0, 30.0, 1000.0])
@pytest.mark.parametrize("power", [2, 4])
def test_a_power_of_the_control_is_limited_as_the_control_is(most, power):
    """The largest control of the free optimum of the midpoint rule is some 5.7."""
    for method in METHODS:
        bent = moved(lambda q, u: (u[0] / most) ** power - 1, method)
        plain = OptimalControlProblem(PLANE, particle, half_square, 1, control_bounds=(-most, most))
        expected = solve(plain, method, np.zeros(2), np.array([1.0, 0.0]), 1.0, 20)
        assert bent.cost == pytest.approx(expected.cost, rel=1e-8)
        assert bent.checks.strict_minimum


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_the_unit_of_a_ball_does_not_matter(scale):
    found = moved(lambda q, u: scale * (u @ u - 25), METHODS[0])
    assert found.cost == pytest.approx(moved(lambda q, u: u @ u - 25, METHODS[0]).cost, rel=1e-9)


@pytest.mark.parametrize("top", [1.2, 1.4, 1.499, 1.501, 2.0])
@pytest.mark.parametrize(
    "bend", [lambda x: jnp.tanh(5 * x), lambda x: jnp.exp(20 * x) - 1, lambda x: x + x**3], ids=["tanh", "exp", "cubic"]
)
def test_a_limit_of_the_speed_is_the_same_however_it_is_bent(bend, top):
    """The largest speed of the free optimum is 1.5."""
    for method in METHODS:
        expected = moved(lambda q, u: q[1] - top, method)
        assert moved(lambda q, u: bend(q[1] - top), method).cost == pytest.approx(expected.cost, rel=1e-8)


def test_the_size_of_a_torque_is_limited_from_a_guess_without_torque():
    """A ball through the largest torque of the free slew, some 20 N m, and one around it."""
    start, end, retraction = (IDENTITY, REST), (SLEW_END, REST), Cayley(RIGID)
    free = OptimalControlProblem(RIGID, spacecraft, half_square, 3)
    known = solve(free, Midpoint(retraction), start, end, 60.0, 40)
    largest = np.max(np.linalg.norm(known.controls, axis=1))
    for share in (0.8, 0.999, 1.001, 5.0):
        ball = {"torque": lambda q, u, share=share: u @ u - (share * largest) ** 2}
        problem = OptimalControlProblem(RIGID, spacecraft, half_square, 3, constraints=ball)
        found = solve(problem, Midpoint(retraction), start, end, 60.0, 40)
        assert np.max(np.linalg.norm(found.controls, axis=1)) <= min(share, 1.0) * largest * (1 + 1e-6)
        if share > 1:
            assert found.cost == pytest.approx(known.cost, rel=1e-9)
        else:
            assert found.cost > known.cost * (1 + 1e-9)


def test_two_halves_are_the_whole():
    """Phases have slacks of their own."""
    ball = {"ball": lambda q, u: u @ u - 25}
    problem = OptimalControlProblem(PLANE, particle, half_square, 1, constraints=ball)
    first = Phase(problem, METHODS[0], 10, 0.5, start=np.zeros(2))
    found = solve_phases([first, Phase(problem, METHODS[0], 10, 0.5, end=np.array([1.0, 0.0]))])
    assert found.cost == pytest.approx(moved(ball["ball"], METHODS[0]).cost, rel=1e-9)
