"""First steps through the length at which they are followed no farther: guesses nearly at rest, of a system without drift."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Guess, OptimalControlProblem, Solver
from retrax.manifolds import SO, hat
from retrax.retractions import Midpoint, default_retraction

from .problems import half_square

N, Q = 20, SO(3)
TURNED = OptimalControlProblem(Q, lambda q, u: q @ hat(jnp.append(u, 0.0)), half_square, 2)
SOLVER = Solver(TURNED, Midpoint(default_retraction(Q)), N)
END = np.asarray(default_retraction(Q)(np.eye(3), hat(jnp.array([0.4, -0.3, 1.6]))))


@pytest.mark.parametrize("size", 10.0 ** np.arange(-2.5, 1.01, 0.25))
def test_a_guess_nearly_at_rest_leads_to_a_solution(size):
    times, shares = np.linspace(0, 1, N), []
    controls = size * np.stack([np.cos(times), np.sin(2 * times)], axis=1)
    guess = Guess.from_controls(TURNED, SOLVER.method, np.eye(3), controls, 1.0, N)
    found = SOLVER.solve(np.eye(3), END, 1.0, guess=guess, throw=False, callback=lambda i: shares.append(i.fraction[0]))
    assert found.success
    # The first step is as long as the controls are small: a diameter is this share of it.
    assert shares[0] == pytest.approx(min(1.17 * size, 1.0), rel=0.1)
