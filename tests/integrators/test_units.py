"""No answer depends on the units of length, time, mass and cost that a problem is written in."""

from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, PresymplecticIntegrator, Solution, solve
from retrax.integrators.problem.pontryagin import extremal_control
from retrax.manifolds import Euclidean, hat
from retrax.retractions import Cayley, CotangentLift, Exponential, Midpoint

from tests.support.numerics import norm

from .problems import IDENTITY, RIGID, rotation

PLANE, STEPS = Euclidean(2), 10
DECADES = range(24)


class Mass(eqx.Module):
    """A mass on a line under a force, whose square costs a price."""

    mass: jax.Array
    price: jax.Array

    def velocity(self, q: jax.Array, u: jax.Array) -> jax.Array:
        return jnp.stack([q[1], u[0] / self.mass])

    def effort(self, q: jax.Array, u: jax.Array) -> jax.Array:
        return self.price * (u @ u) / 2


class Body(eqx.Module):
    """A rigid body under torques in units of their own."""

    inertia: jax.Array
    unit: jax.Array
    price: jax.Array

    def velocity(self, q: Any, u: jax.Array) -> Any:
        R, w = q
        return R @ hat(w), (self.unit * u - jnp.cross(w, self.inertia * w)) / self.inertia

    def effort(self, q: Any, u: jax.Array) -> jax.Array:
        return self.price * (u @ u) / 2


@cache
def shift(length: float, time: float, mass: float, price: float) -> Solution:
    """From rest to rest over a length."""
    body = Mass(jnp.asarray(mass), jnp.asarray(price))
    problem = OptimalControlProblem(PLANE, body.velocity, body.effort, 1)
    ends = np.zeros(2), np.array([length, 0.0])
    return solve(problem, *ends, time, method=Midpoint(Exponential(PLANE)), steps=STEPS, throw=False)


@cache
def slew(mass: float, time: float, unit: float, price: float) -> Solution:
    """From rest to rest by 150 degrees."""
    body = Body(mass * jnp.array([5.6, 4.5, 2.4]), jnp.asarray(unit), jnp.asarray(price))
    problem = OptimalControlProblem(RIGID, body.velocity, body.effort, 3)
    end = rotation(2.6 * np.array([1.0, 2.0, -2.0]) / 3), np.zeros(3)
    return solve(problem, (IDENTITY, np.zeros(3)), end, time, method=Midpoint(Cayley(RIGID)), steps=STEPS, throw=False)


def random_units(seed: int, *lowest: float) -> np.ndarray:
    """Powers of ten over eighteen decades."""
    return 10.0 ** np.random.default_rng(seed).uniform(lowest, np.add(lowest, 18.0))


@pytest.mark.parametrize("seed", DECADES)
@pytest.mark.usual(2)
def test_a_linear_quadratic_problem_is_solved_by_one_newton_step_in_any_units(seed):
    length, time, mass, price = random_units(seed, -12, -9, -9, -9)
    solution = shift(length, time, mass, price)
    exact = 6 * price * (mass * length) ** 2 / time**3 / (1 - 1 / STEPS**2)
    assert solution.success
    assert solution.statistics.iterations <= 2  # the second mends rounding
    assert solution.cost == pytest.approx(exact, rel=1e-10)
    assert solution.checks.strict_minimum


@pytest.mark.parametrize("seed", DECADES)
@pytest.mark.usual(1)
def test_a_slew_is_the_same_in_any_units(seed):
    mass, time, unit, price = random_units(seed, -9, -6, -9, -9)
    one, other = slew(1.0, 1.0, 1.0, 1.0), slew(mass, time, unit, price)
    assert other.success
    assert abs(other.statistics.iterations - one.statistics.iterations) <= 1  # the last mends rounding
    assert other.checks.strict_minimum
    assert other.cost == pytest.approx(one.cost * price * (mass / unit) ** 2 / time**3, rel=1e-9)


@pytest.mark.parametrize("powers", [(30, -20, 4, 6), (-33, 14, 8, -8)])
def test_powers_of_two_change_nothing_but_rounding(powers):
    length, time, mass, price = 2.0 ** np.array(powers)
    one, other = shift(1.0, 1.0, 1.0, 1.0), shift(length, time, mass, price)
    assert norm(other.controls / (mass * length / time**2) - one.controls) < 1e-13 * norm(one.controls)
    assert norm(other.states / np.array([length, length / time]) - one.states) < 1e-13


@pytest.mark.parametrize("size", 10.0 ** np.arange(-12, 13, 6))
@pytest.mark.usual(1)
def test_controls_of_a_costate_are_found_in_any_units(size):
    """Those that minimise ``sum cosh A u - p u``, one in units of another."""
    units, p = size * np.array([1.0, 1e-3, 1e4]), np.array([1.0, 0.3, -0.7])
    a = np.array([[2, 0.3, 0.1], [0.3, 1, 0.7], [0, 0.7, 3]])
    cost = lambda q, u: jnp.sum(jnp.cosh(a @ (u / units)))  # noqa: E731
    problem = OptimalControlProblem(Euclidean(3), lambda q, u: u / units, cost, 3)
    found = extremal_control(problem, jnp.zeros(3), jnp.asarray(p))
    np.testing.assert_allclose(found / units, np.linalg.solve(a, np.arcsinh(np.linalg.solve(a.T, p))), rtol=1e-12)
    PresymplecticIntegrator(CotangentLift(Midpoint(Exponential(Euclidean(3))))).check(
        problem, jnp.zeros(3), jnp.asarray(p)
    )
