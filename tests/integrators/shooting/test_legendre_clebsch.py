"""The generalised Legendre-Clebsch condition: Kelley's and Goh's tell a minimum from what is none."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import (
    OptimalControlProblem,
)
from retrax.integrators.boundary_value.shooting.legendre_clebsch import generalised_legendre_clebsch
from retrax.manifolds import Euclidean
from retrax.problems import SINGULAR

from .test_singular_solve import ALY_CHAN, cascade


def test_kelley_and_goh_tell_a_minimum_from_what_is_none():
    """Of ``(a x2^2 - x1^2)/2`` the arc minimises for ``a > 0`` only; ``p = A(q)`` in a magnetic field never does."""
    z, u = ((jnp.ones((2, 1)), jnp.ones((2, 1))), (jnp.ones((2, 1)), jnp.zeros((2, 1)))), jnp.ones((2, 1))
    upside_down = cascade(lambda q, u: -(q[1] @ q[1] + q[0] @ q[0]) / 2)
    assert "strict generalised Legendre-Clebsch condition met" in generalised_legendre_clebsch(ALY_CHAN, z, u)
    assert "condition fails" in generalised_legendre_clebsch(upside_down, z, u)
    particle = SINGULAR["massless particle"]().problem
    assert "Goh's condition fails" in generalised_legendre_clebsch(
        particle, (jnp.ones((2, 2)), jnp.ones((2, 2))), jnp.ones((2, 2))
    )


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.usual(1)
def test_the_sign_of_kelleys_condition_alternates_with_the_order(order):
    """``x_1' = x_2, ..., x_k' = u`` with the cost ``a x_1^2 / 2``: the arc ``x = 0`` of order k minimises for
    ``a > 0``."""
    for sign, words in ((1, "strict Kelley's condition"), (-1, "Kelley's condition of order")):
        problem = OptimalControlProblem(
            Euclidean(order), lambda q, u: jnp.concatenate([q[1:], u]), lambda q, u, a=sign: a * q[0] ** 2 / 2, 1
        )
        found = generalised_legendre_clebsch(
            problem, (np.zeros((2, order)), np.zeros((2, order))), jnp.zeros((2, 1)), order
        )
        assert found.startswith(words)
        assert ("fails" in found) == (sign < 0)
