"""Strict minima of phases with inequalities, as the core tells them, judged by closed forms."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Phase, solve_phases
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Gauss, Midpoint

LINE = Euclidean(1)
STEPS, HORIZON = 12, 2.0
# Of a sum of (dq / h)^2 - c x^2 at the middles x of steps between two zeros the least eigenvalue is zero.
FOCAL = (2 * STEPS / HORIZON * np.tan(np.pi / 2 / STEPS)) ** 2


def velocity(q: Any, u: Any) -> Any:
    return u


def halves(c: float, method: Any, **options: Any) -> Any:
    """Rest between two zeros, in two phases."""
    problem = OptimalControlProblem(LINE, velocity, lambda q, u: (u @ u - c * q @ q) / 2, 1, **options)
    first = Phase(problem, method, STEPS // 2, HORIZON / 2, start=np.zeros(1))
    return solve_phases([first, Phase(problem, method, STEPS // 2, HORIZON / 2, end=np.zeros(1))], throw=False)


@pytest.mark.parametrize("share", [0.5, 0.9, 0.99, 1.01, 1.1, 3.0])
@pytest.mark.parametrize(
    "limits",
    [{"control_bounds": (-1.0, 1.0)}, {"constraints": {"near": lambda q, u: q[0] ** 2 - 1}}],
    ids=["bounds", "constraint"],
)
@pytest.mark.usual(2)
def test_rest_is_a_minimum_up_to_the_focal_point(share, limits):
    """Limits that do not pull change nothing."""
    found = halves(share * FOCAL, Midpoint(Addition(LINE)), **limits)
    assert found.success
    np.testing.assert_allclose(found.cost, 0.0, atol=1e-9)
    assert bool(found.strict_minimum) == (share < 1)


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_so_it_is_by_collocation(share):
    """With polynomials of two stages the focal point is that of the continuous problem but for 1e-5."""
    found = halves(share * (np.pi / HORIZON) ** 2, Gauss(2, Addition(LINE)), control_bounds=(-1.0, 1.0))
    assert found.success
    assert bool(found.strict_minimum) == (share < 1)


@pytest.mark.parametrize("method", [Midpoint(Addition(LINE)), Gauss(2, Addition(LINE))], ids=["map", "Gauss"])
@pytest.mark.parametrize("curvature", [-2.0, -0.5, 0.5])
@pytest.mark.usual(2)
def test_limits_that_pull_make_a_minimum_of_a_cost_that_is_curved_downward(curvature, method):
    """In the second phase the force is at its bound, whatever its curvature: the end is dear by its slope."""
    free = OptimalControlProblem(LINE, velocity, lambda q, u: u @ u / 2, 1)
    bounded = OptimalControlProblem(
        LINE, velocity, lambda q, u: curvature * u @ u / 2, 1, control_bounds=(-1.0, 1.0),
        terminal_cost=lambda q: -5 * jnp.sum(q),
    )  # fmt: skip
    first = Phase(free, method, 5, 1.0, start=np.zeros(1))
    found = solve_phases([first, Phase(bounded, method, 5, 1.0, end=Free(np.ones(1)))], throw=False)
    assert found.success
    np.testing.assert_allclose(found.phases[1].controls, 1.0, atol=1e-6)
    np.testing.assert_allclose(found.phases[0].controls, 5.0, rtol=1e-8)
    assert found.strict_minimum
