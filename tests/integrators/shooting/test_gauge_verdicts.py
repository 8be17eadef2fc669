"""Words on the second order of extremals with controls that the equations leave free."""

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem, solve
from retrax.manifolds import SO, hat
from retrax.retractions import Cayley, Midpoint

G = SO(3)


@pytest.mark.parametrize("weight", [0.7, *(pytest.param(own, marks=pytest.mark.slow) for own in (0.0, 1e-3, 10.0))])
@pytest.mark.slow
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
