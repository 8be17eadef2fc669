"""Free horizons that tend to zero, where all conditions vanish with them; and horizons that are short in their
units."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Phase, Solver, solve_phases
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Gauss
from scipy.optimize import brentq

LINE = Euclidean(1)
METHOD = Gauss(2, Addition(LINE))
VANISHES = "The horizon tends to zero", "The horizon shrank from"


@cache
def runner():
    """The cost ``price int sqrt(1 / time^2 + (u / length)^2) + weight time (u / length)^2 / 2``, in units of the three;
    for one of each the least is taken at ``weight u^2 / 2 = 1 / sqrt(1 + u^2)``, and without weight nowhere."""

    def cost(q, u, given):
        price, length, time, weight = given
        return price * (jnp.sqrt(1 / time**2 + (u @ u) / length**2) + weight * time * (u @ u) / length**2 / 2)

    problem = OptimalControlProblem(LINE, lambda q, u, given: u, cost, 1)
    return Solver(problem, METHOD, 8)


def run(price=1.0, length=1.0, time=1.0, weight=0.0, guess=1.0, lower=-np.inf):
    horizon = Free(guess * time, lower=lower * time)
    given = np.array([price, length, time, weight])
    return runner().solve(np.zeros(1), np.full(1, length), horizon, parameters=given, throw=False)


@pytest.mark.long("given0", "given3", "given4", "given7", "given8", "given9", "given10")
@pytest.mark.parametrize(
    "given",
    [
        {},
        {"guess": 1e-3},
        {"guess": 1e3},
        {"guess": 1e-6},
        {"guess": 1e-9},
        {"price": 1e-9},
        {"price": 1e9},
        {"length": 1e-6},
        {"length": 1e6},
        {"time": 1e-9},
        {"time": 1e9},
    ],
)
def test_an_infimum_at_no_time_is_named_in_all_units(given):
    found = run(**given)
    assert found.status == "failed"
    assert any(words in found.result for words in VANISHES)
    assert "infimum" in found.result


def powers(power):
    """Costs of time and speed that are the farther from flat at rest, and the nearer to the speed, the higher."""
    return lambda q, u: (1 + u[0] ** power) ** (1 / power)


SHAPES = {f"power {n}": powers(n) for n in (2, 4, 6, 8)} | {
    "with a linear part": lambda q, u: jnp.sqrt(1 + u[0] + u[0] ** 2),
    "smoothed": lambda q, u: jnp.sqrt(1e-6 + u[0] ** 2),
    "concave near rest": lambda q, u: u[0] + 1 / (1 + u[0] ** 2),
}


@cache
def shaped(name):
    return Solver(OptimalControlProblem(LINE, lambda q, u: u, SHAPES[name], 1), METHOD, 8)


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("guess", [1.0, 1e-3, 1e2])
@pytest.mark.usual(2)
def test_an_infimum_at_no_time_is_named_whatever_the_cost(name, guess):
    """``T F(1 / T)`` falls to 1 as T tends to zero; whether a search ends there with success or on its way."""
    found = shaped(name).solve(np.zeros(1), np.ones(1), Free(guess), throw=False)
    assert found.status == "failed"
    assert any(words in found.result for words in VANISHES)
    assert "infimum" in found.result


@pytest.mark.parametrize("guess", [1e-3, 1.0, 1e1, 1e2])
@pytest.mark.usual(1)
def test_a_duration_that_tends_to_zero_is_named(guess):
    """Beside a phase of the time ``sqrt(1 / 2)``, by ``int 1 + u^2 / 2``: that of the length alone has none."""
    paid = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: 1 + u @ u / 2, 1)
    length = OptimalControlProblem(LINE, lambda q, u: u, SHAPES["power 2"], 1)

    def phases(lower):
        last = Phase(length, METHOD, 4, Free(max(guess, 2 * lower), lower=lower), end=np.full(1, 2.0))
        return [Phase(paid, METHOD, 4, Free(1.0), start=np.zeros(1), end=np.ones(1)), last]

    found = solve_phases(phases(0.0), throw=False)
    assert found.status == "failed"
    assert "The duration of phase 1 tends to zero" in found.result
    assert "infimum" in found.result
    held = solve_phases(phases(0.1))
    np.testing.assert_allclose(held.durations, [np.sqrt(0.5), 0.1], rtol=1e-6)


@pytest.mark.parametrize("weight", [10.0, 1.0, 1e-1, 1e-3, 1e-6, 1e-9])
def test_a_weight_of_the_speed_determines_the_horizon(weight):
    """As small as it is, and though the horizon becomes short."""
    speed = brentq(lambda u: weight * u**2 / 2 - 1 / np.sqrt(1 + u**2), 1e-3, 1e5, xtol=1e-14, rtol=1e-14)
    found = run(weight=weight)
    assert found.success
    assert found.horizon == pytest.approx(1 / speed, rel=1e-6)
    assert found.cost == pytest.approx((np.sqrt(1 + speed**2) + weight * speed**2 / 2) / speed, rel=1e-9)


@pytest.mark.parametrize("time", [1e-12, 1e-9, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9, 1e12])
def test_a_horizon_that_is_short_in_its_units_is_a_minimum(time):
    found = run(weight=1.0, time=time)
    assert found.status == "minimum"
    assert found.horizon / time == pytest.approx(run(weight=1.0).horizon, rel=1e-9)


@pytest.mark.parametrize("lower", [1e-1, 1e-2, 3e-3, 1e-3])
def test_a_bound_holds_a_horizon_that_would_vanish(lower):
    found = run(lower=lower)
    assert found.success
    assert found.horizon == pytest.approx(lower, rel=1e-4)
    assert found.cost == pytest.approx(np.sqrt(1 + lower**2), rel=1e-9)


@pytest.mark.parametrize("weight", [0.9, 1.0 - 1e-2, 1.0 + 1e-2, 1.1, 3.0])
@pytest.mark.usual(1)
def test_a_start_that_is_best_left_at_once_or_not_at_all(weight):
    """``int 1 + u^2 / 2`` and ``w (q - 1)^2 / 2`` at the end: the least force ``w`` that pays to set out is sqrt(2)."""
    weight *= np.sqrt(2)
    problem = OptimalControlProblem(
        LINE,
        lambda q, u, w: u,
        lambda q, u, w: 1 + u @ u / 2,
        1,
        terminal_cost=lambda q, w: w * (q[0] - 1) ** 2 / 2,
    )
    found = Solver(problem, METHOD, 6).solve(np.zeros(1), None, Free(1.0), parameters=weight, throw=False)
    assert found.success == (weight > np.sqrt(2))
    if found.success:
        assert found.horizon == pytest.approx((1 - np.sqrt(2) / weight) / np.sqrt(2), rel=1e-8)
    else:
        assert "tends to zero" in found.result
