"""Bounds are met as well as is said whatever the guess costs: no unit of it is left in what is found."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, Guess, OptimalControlProblem, Solver
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Gauss, Midpoint
from scipy.optimize import minimize

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


@pytest.mark.parametrize("weight", [1e-9, 1e-3, 1e1, 1e2, 1e3, 1e4, 1e6, 1e9, 1e12])
@pytest.mark.usual(2)
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
@pytest.mark.usual(1)
def test_a_way_around_is_not_judged_by_what_the_way_through_costs(height):
    def hill(q, u, height):
        return u @ u / 2 + height * jnp.exp(-40 * ((q[0] - 0.5) ** 2 + (q[1] - 0.03) ** 2))

    problem = OptimalControlProblem(PLANE, lambda q, u, height: u, hill, 2, control_bounds=(-2.0, 2.0))
    solver = Solver(problem, METHOD, 20)
    found = solver.solve(np.zeros(2), np.array([1.0, 0.0]), 1.0, parameters=height)
    assert products(found, 2.0) < 1e-8
    again = solver.solve(np.zeros(2), np.array([1.0, 0.0]), 1.0, parameters=height, guess=found)
    assert again.cost == pytest.approx(found.cost, rel=1e-10)


WILD = 16  # steps
LIMITS = {
    "free": ({}, lambda u, v: np.zeros(0)),
    "speed": ({"constraints": {"speed": lambda q, u: q[1] - 1.2}}, lambda u, v: 1.2 - (v[1:] + v[:-1]) / 2),
    "too slow": ({"constraints": {"speed": lambda q, u: q[1] - 0.9}}, None),
    "force": ({"control_bounds": (-4.8, 4.8)}, lambda u, v: np.concatenate([4.8 - u, 4.8 + u])),
    "too weak": ({"control_bounds": (-3.9, 3.9)}, None),
}


@cache
def carried(name):
    """A mass that is carried from rest to rest, and the least cost of the midpoint rule, by sequential quadratic
    programming; None if there is none."""
    limits, held = LIMITS[name]
    problem = OptimalControlProblem(PLANE, lambda q, u: jnp.stack([q[1], u[0]]), lambda q, u: u @ u / 2, 1, **limits)
    solver, h = Solver(problem, Midpoint(Addition(PLANE)), WILD), 1 / WILD
    if held is None:
        return solver, None

    def speeds(u):
        return np.concatenate([[0.0], h * np.cumsum(u)])

    def ends(u):
        v = speeds(u)
        return np.array([v[-1], h * np.sum(v[1:] + v[:-1]) / 2 - 1])

    rules = [{"type": "eq", "fun": ends}, {"type": "ineq", "fun": lambda u: held(u, speeds(u))}]
    ramp, options = np.linspace(4, -4, WILD), {"ftol": 1e-15, "maxiter": 500}
    found = minimize(lambda u: h * u @ u / 2, ramp, constraints=rules, method="SLSQP", options=options)
    return solver, found.fun


USUAL = -12, 3, 6, 9, 10, 12
POWERS = [power if power in USUAL else pytest.param(power, marks=pytest.mark.slow) for power in range(-12, 13)]


@pytest.mark.parametrize("power", POWERS)
@pytest.mark.parametrize("name", LIMITS)
@pytest.mark.usual(2)
def test_a_wild_guess_does_not_set_the_measure_of_success(name, power):
    """Through guesses as large as rounding of them is larger than all that is found: no success is a false one."""
    (solver, expected), drawn = carried(name), np.random.default_rng(3)
    states, controls = drawn.standard_normal((WILD, 2)), drawn.standard_normal((WILD, 1))
    for wild in ((10.0**power, 1.0), (1.0, 10.0**power), (10.0**power, 10.0**power)):
        guess = Guess(wild[0] * states, wild[1] * controls)
        found = solver.solve(np.zeros(2), np.array([1.0, 0.0]), 1.0, guess=guess, throw=False)
        if expected is None:
            assert not found.success
        elif found.success or power <= 7:
            assert found.success
            assert found.cost == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("steps", [20, 40])
def test_a_crane_is_judged_by_what_it_costs_in_the_end(steps):
    """Its cost does not depend on the controls, and by next to nothing on what they move within a step."""

    def crane(x, u):
        pull = u[0] + 17.2656 * x[2]
        swing = u[0] + 27.0756 * x[2] + 2 * x[4] * x[5]
        return 9 * jnp.stack([x[3], x[4], x[5], pull, u[1], -swing / x[1]])

    space, lower, upper = Euclidean(6), np.array([-2.83374, -0.80865]), np.array([2.83374, 0.71265])
    problem = OptimalControlProblem(space, crane, lambda x, u: 4.5 * (x[2] ** 2 + x[5] ** 2), 2, None,
                                    control_bounds=(lower, upper))  # fmt: skip
    solver = Solver(problem, Gauss(2, Addition(space)), steps)
    ends = np.array([0, 22.0, 0, 0, -1, 0]), np.array([10, 14.0, 0, 2.5, 0, 0])
    first = again = solver.solve(*ends, 1.0)
    if steps == 40:
        assert first.cost == pytest.approx(0.005117667125, rel=1e-9)  # IPOPT on the same mesh
    for _ in range(2):
        again = solver.solve(*ends, 1.0, guess=again)
        u, nu = np.asarray(again.controls), again.multipliers
        sums = nu["control_bounds lower"] * (u - lower) + nu["control_bounds upper"] * (upper - u)
        assert np.max(sums) < 1e-8 * again.cost
        assert again.cost == pytest.approx(first.cost, rel=1e-9)
        assert again.statistics.iterations <= first.statistics.iterations
