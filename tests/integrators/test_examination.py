"""What is looked at beside the conditions of a solution: for each structure of parameters, and not where it was
stopped."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Phase, Solver, solve_phases
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Midpoint, default_retraction

LINE = Euclidean(1)
METHOD = Midpoint(Addition(LINE))
START, END = np.zeros(1), np.ones(1)


def pushed(q, u, given):
    return u * jnp.sum(given)


def test_constraints_are_examined_with_parameters_of_any_structure():
    """The constraint holds the trajectory at the end alone, where it is ``sum(given) <= 1``."""
    problem = OptimalControlProblem(
        LINE,
        pushed,
        lambda q, u, given: u @ u / 2,
        1,
        constraints={"wall": lambda q, u, given: jnp.sum(given) * q - 1},
        control_bounds=(-3.0, 3.0),
    )
    solver = Solver(problem, METHOD, 6)
    for parameters, outside in (
        (np.ones(1), False),
        (np.full(2, 0.5), False),
        (np.full(2, 0.7), True),
        (np.full(1, 1.4), True),
    ):
        found = solver.solve(START, END, 1.0, parameters=parameters, throw=False)
        assert found.success != outside
        assert ("violates" in found.result) == outside


@pytest.mark.parametrize("height", [0.0, 0.1])
def test_an_iteration_that_was_stopped_is_said_to_be_stopped(height):
    problem = OptimalControlProblem(
        LINE, lambda q, u: u, lambda q, u: u @ u / 2 + height * jnp.where(q[0] > 0.5, 1.0, 0.0), 1
    )
    found = Solver(problem, METHOD, 6).solve(START, END, 1.0, callback=lambda iteration: True, throw=False)
    assert not found.success
    assert "stopped" in found.result


CART = LINE * LINE
WALLS = {"wall": lambda q, u: -q[0], "speed": lambda q, u: q[1] - 9}
WALL = OptimalControlProblem(CART, lambda q, u: (q[1], u), lambda q, u: u @ u / 2, 1, constraints=WALLS)


@cache
def by_the_wall():
    return Solver(WALL, Midpoint(default_retraction(CART)), 10)


@pytest.mark.parametrize("place", [-0.1, -1e-3, -1e-6, 0.0, 1e-6, 1e-3, 0.1])
@pytest.mark.parametrize("velocity", [None, np.array([0.5])])
@pytest.mark.usual(2)
def test_what_is_prescribed_of_an_end_is_where_constraints_hold(place, velocity):
    """A start behind the wall with a free velocity too; one phase, and the end."""
    behind, ahead = (np.array([place]), velocity), (np.ones(1), np.array([0.5]))
    found = by_the_wall().solve(behind, ahead, 1.0, throw=False)
    assert found.success == (place >= 0)
    assert ("The start violates wall" in found.result) == (place < 0)
    back = by_the_wall().solve(ahead, (behind[0], None if velocity is None else -velocity), 1.0, throw=False)
    assert back.success == (place >= 0)
    phases = solve_phases([Phase(WALL, by_the_wall().method, 10, start=behind, end=ahead, duration=1.0)], throw=False)
    assert phases.success == (place >= 0)
