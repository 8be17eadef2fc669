"""Limits of phases whose guess violates them, in whatever units of the cost: the same answers as in one piece."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Phase, PhasedSolution, Solution, solve, solve_phases
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Midpoint
from scipy.optimize import minimize

PLANE = Euclidean(2)
METHOD, START, END = Midpoint(Addition(PLANE)), np.zeros(2), np.array([1.0, 0.0])
PRICES = ["1e-12", "1e-06", "1.0", "1e+06", "1e+12"]
# From rest to rest over a length of one in a time of two: the least limit is one.
LIMITS = ["0.5", "0.9", "0.9999", "1.000001", "1.0001", "1.01", "1.1", "2.0"]


def cart(q: jax.Array, u: jax.Array) -> jax.Array:
    return jnp.stack([q[1], u[0]])


def problem(price: float, limit: float) -> OptimalControlProblem:
    return OptimalControlProblem(PLANE, cart, lambda q, u: price * (u @ u) / 2, 1, control_bounds=(-limit, limit))


def whole(price: float, limit: float) -> Solution:
    return solve(problem(price, limit), START, END, 2.0, method=METHOD, steps=20, throw=False)


def halves(price: float, limits: tuple[float, float]) -> PhasedSolution:
    first = Phase(problem(price, limits[0]), METHOD, 10, 1.0, start=START)
    second = Phase(problem(price, limits[1]), METHOD, 10, 1.0, end=END)
    return solve_phases([first, second], throw=False)


@pytest.mark.long("1e-12-1.000001", "1e-06-0.9")
@pytest.mark.parametrize("limit", LIMITS)
@pytest.mark.parametrize("price", PRICES)
@pytest.mark.usual("1e-06-0.9", "1e-06-1.01", "1.0-0.9", "1e+12-1.01", "1e-12-1.000001")
def test_two_halves_are_the_whole_in_all_units_of_the_cost(price, limit):
    found, one = halves(float(price), (float(limit),) * 2), whole(float(price), float(limit))
    assert found.success == one.success == (float(limit) > 1)
    if found.success:
        assert found.cost == pytest.approx(one.cost, rel=1e-9)
        assert max(np.abs(phase.controls).max() for phase in found.phases) <= float(limit) * (1 + 1e-9)
    else:
        assert "control_bounds" in found.result


@pytest.mark.parametrize("price", PRICES)
@pytest.mark.usual("1e-06")
def test_a_limit_of_one_half_alone(price):
    """Against SciPy's solution of the quadratic problem of the forces."""
    h, count = 0.1, 20
    left = 2.0 - h * (np.arange(count) + 0.5)
    equations = {
        "type": "eq",
        "fun": lambda u: [h * left @ u - 1, h * u.sum()],
        "jac": lambda u: h * np.stack([left, 0 * u + 1]),
    }
    for limit in (0.9, 0.5, 0.2):
        found = halves(float(price), (10.0, limit))
        limits = [(-10.0, 10.0)] * 10 + [(-limit, limit)] * 10
        given = {"jac": lambda u: h * u, "bounds": limits, "constraints": equations, "method": "SLSQP"}
        best = minimize(lambda u: h * u @ u / 2, np.zeros(count), options={"ftol": 1e-14, "maxiter": 500}, **given)
        assert found.success
        assert found.cost / float(price) == pytest.approx(best.fun, rel=1e-7)
        assert np.abs(found.phases[1].controls).max() <= limit * (1 + 1e-9)


def test_each_phase_names_what_it_violates():
    """Half a way from rest to rest in a unit of time asks for two, and the other for six times as much."""
    cases = {(3.0, 9.0): set(), (1.0, 9.0): {0}, (3.0, 5.0): {1}, (1.0, 5.0): {0, 1}}
    for limits, violating in cases.items():
        first = Phase(problem(1.0, limits[0]), METHOD, 10, 1.0, start=START, end=END / 2)
        second = Phase(problem(1.0, limits[1]), METHOD, 10, 1.0, end=2 * END)
        found = solve_phases([first, second], throw=False)
        assert found.success == (not violating)
        assert {k for k in (0, 1) if f"Phase {k}: It violates control_bounds" in found.result} == violating, limits
        assert found.success or "at the points of these steps" in found.result
