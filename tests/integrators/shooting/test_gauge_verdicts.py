"""Extremals with controls that the equations leave free: their least norm, and the words on their second order."""

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem, solve
from retrax.manifolds import SO, Sphere, hat
from retrax.retractions import Cayley, Exponential, Midpoint

from tests.support.numerics import norm

G = SO(3)


@pytest.mark.slow
@pytest.mark.parametrize("weight", [0.0, 1e-3, 0.7, 10.0])
def test_a_gauge_control_is_not_called_no_minimum(weight: float) -> None:
    """Turns about the third axis cost nothing, and the potential does not see them."""

    def potential(R: Array, u: Array) -> Array:
        return (u[0] ** 2 + u[1] ** 2) / 2 - weight * R[2, 2]

    problem = OptimalControlProblem(G, lambda R, u: R @ hat(u), potential, 3)
    end = np.asarray(Cayley(G)(jnp.eye(3), jnp.asarray(hat(jnp.array([0.3, 0.4, -0.5])))))
    found = solve(problem, np.eye(3), end, 1.0, method=Midpoint(Cayley(G)), steps=10)
    assert found.singular is not None
    assert found.singular.gauge_controls == 1
    assert "not decided" in found.singular.second_order
    assert "not a minimum" not in found.singular.second_order


@pytest.mark.slow
@pytest.mark.parametrize("begin", np.linspace(0, np.pi, 5))
def test_redundant_controls_are_of_least_norm_wherever_the_trajectory_goes(begin):
    """Two controls of a motion on the circle, of which the part across it costs nothing and moves nothing: from the
    places where one of them alone is tangential to the next."""
    circle = Sphere(1)
    problem = OptimalControlProblem(circle, lambda q, u: u - (q @ u) * q, lambda q, u: (u @ u - (q @ u) ** 2) / 2, 2)
    start, end = (np.array([np.cos(angle), np.sin(angle)]) for angle in (begin, begin + 0.7))
    solution = solve(problem, start, end, 1.0, method=Midpoint(Exponential(circle)), steps=4)
    assert solution.singular.gauge_controls == 1
    assert solution.singular.kernel == 0
    assert solution.cost == pytest.approx(0.7**2 / 2, rel=1e-9)
    assert norm(np.sum(solution.controls * solution.stage_states, axis=1)) < 1e-9
