"""Bounds are met as well as is said whatever the guess costs: no unit of it is left in what is found."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Solver
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Gauss

PLANE = Euclidean(2)
METHOD = Gauss(2, Addition(PLANE))
START, END = np.array([1.0, 0.3]), np.array([-0.3, 0.0])
LIMIT = 1.5


def pendulum(q, u, weight):
    return jnp.stack([q[1], u[0] - jnp.sin(q[0])])


def weighted(q, u, weight):
    return weight * (u @ u / 2 + q @ q)


def speed(first, last, weight):
    return last[1]


@cache
def swings():
    problem = OptimalControlProblem(PLANE, pendulum, weighted, 1, control_bounds=(-LIMIT, LIMIT))
    return Solver(problem, METHOD, 15)


@cache
def stops():
    """The same, with the speed at the end as an equation: coupled conditions."""
    bounds = (-LIMIT, LIMIT)
    given = {"control_bounds": bounds, "boundary_constraints": {"speed": speed}}
    return Solver(OptimalControlProblem(PLANE, pendulum, weighted, 1, **given), METHOD, 15)


def products(solution, limit):
    """The largest product of a multiplier and its slack, beside the cost of a unit of time."""
    u, nu = np.asarray(solution.controls), solution.multipliers
    largest = max(
        np.max(nu["control_bounds lower"] * (u + limit)),
        np.max(nu["control_bounds upper"] * (limit - u)),
    )
    return largest * solution.horizon / solution.cost


@pytest.mark.long("10.0", "1000.0", "1000000.0")
@pytest.mark.parametrize("weight", [1e-9, 1e-3, 1e1, 1e2, 1e3, 1e4, 1e6, 1e9, 1e12])
def test_a_guess_of_another_weight_leads_to_the_same(weight):
    for solver, end in ((swings(), END), (stops(), Free(END))):
        alone = solver.solve(START, end, 3.0, parameters=1.0)
        guess = solver.solve(START, end, 3.0, parameters=weight)
        found = solver.solve(START, end, 3.0, parameters=1.0, guess=guess)
        assert found.cost == pytest.approx(alone.cost, rel=1e-11)
        assert products(found, LIMIT) < 3e-9


def test_members_of_a_batch_have_units_of_their_own():
    weights = 10.0 ** np.arange(-6, 13, 3)
    guesses = [swings().solve(START, END, 3.0, parameters=weight) for weight in weights]
    found = swings().solve_many(START, END, 3.0, parameters=np.ones(len(weights)), guesses=guesses)
    assert found.success.all()
    np.testing.assert_allclose(found.cost, found.cost[0], rtol=1e-11)
    assert max(products(solution, LIMIT) for solution in found) < 3e-9


@pytest.mark.parametrize("height", [1e2, 1e4, 1e6, 1e8])
def test_a_way_around_is_not_judged_by_what_the_way_through_costs(height):
    def hill(q, u, height):
        return u @ u / 2 + height * jnp.exp(-40 * ((q[0] - 0.5) ** 2 + (q[1] - 0.03) ** 2))

    problem = OptimalControlProblem(PLANE, lambda q, u, height: u, hill, 2, control_bounds=(-2.0, 2.0))
    solver = Solver(problem, METHOD, 20)
    found = solver.solve(np.zeros(2), np.array([1.0, 0.0]), 1.0, parameters=height)
    assert products(found, 2.0) < 1e-8
    again = solver.solve(np.zeros(2), np.array([1.0, 0.0]), 1.0, parameters=height, guess=found)
    assert again.cost == pytest.approx(found.cost, rel=1e-10)
