"""Unstable plants over long horizons: what controls reach there grows without bound, and says nothing of a trajectory.

The cost of ``x' = A x + B u`` from ``x_0`` to rest tends to ``x_0' X x_0 / 2`` with the solution ``X`` of Riccati's
equation, from above, as fast as the horizon grows.
"""

from functools import partial

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Solver
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Gauss, Midpoint
from scipy.linalg import solve_continuous_are

PLANE, START = Euclidean(2), np.array([0.1, 0.0])
UPRIGHT, PUSH = np.array([[0.0, 1.0], [10.0, 0.0]]), np.array([[0.0], [1.0]])
RICCATI = START @ solve_continuous_are(UPRIGHT, PUSH, 2 * np.eye(2), [[0.02]]) @ START / 2


def upright(q, u):
    return jnp.asarray(UPRIGHT) @ q + jnp.array([0.0, 1.0]) * u[0]


def cost(q, u):
    return q @ q + 0.01 * u @ u


METHODS = [
    pytest.param(Midpoint, id="midpoint"),
    pytest.param(partial(Gauss, 2), id="two", marks=pytest.mark.slow),
    pytest.param(partial(Gauss, 3), id="three"),
]


@pytest.mark.parametrize("horizon", [3.0, 6.0, 8.0, 12.0, 20.0, 25.0, 30.0, 60.0, 120.0])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", ["to rest", "free end", "bounded"])
@pytest.mark.usual(2)
def test_a_pendulum_is_held_upright(kind, method, horizon):
    bounds = {"control_bounds": (-3.0, 3.0)} if kind == "bounded" else {}
    method = partial(Gauss, 4) if bounds and method is Midpoint else method
    solver = Solver(OptimalControlProblem(PLANE, upright, cost, 1, **bounds), method(Addition(PLANE)), int(5 * horizon))
    found = solver.solve(START, None if kind == "free end" else np.zeros(2), horizon)
    np.testing.assert_allclose(found.states[0], START, atol=1e-12)
    np.testing.assert_allclose(found.cost, RICCATI, rtol=1e-4 if horizon > 3 else 2e-3)
    assert np.max(np.abs(found.costates)) < 1.0
    assert found.statistics.iterations <= 20


@pytest.mark.parametrize("horizon", [6.0, 12.0, 20.0, 30.0, 60.0])
@pytest.mark.usual(1)
def test_an_upright_pendulum_that_is_not_linear(horizon):
    problem = OptimalControlProblem(PLANE, lambda q, u: jnp.stack([q[1], 10 * jnp.sin(q[0]) + u[0]]), cost, 1)
    found = Solver(problem, Gauss(3, Addition(PLANE)), int(5 * horizon)).solve(START, np.zeros(2), horizon)
    np.testing.assert_allclose(found.cost, 0.0172095, rtol=1e-4)
    assert found.checks.strict_minimum
