"""Ends far beyond what the steps resolve: whatever the iteration runs into, a success solves the equations."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Solver
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Gauss

STEPS, METHOD = 4, Gauss(2, Addition(Euclidean(2)))


@pytest.fixture(scope="module")
def spring():
    """A cart on a spring that stiffens with the cube of its length."""
    problem = OptimalControlProblem(
        Euclidean(2), lambda q, u: jnp.stack([q[1], u[0] - q[0] ** 3]), lambda q, u: u @ u / 2, controls=1
    )
    return Solver(problem, METHOD, STEPS)


def missed(solution):
    """What the collocation equations lack, relative to the states."""
    h, matrix, weights = 1 / STEPS, np.array(METHOD.matrix), np.array(METHOD.weights)
    nodes, stages = solution.states, solution.stage_states.reshape(STEPS, 2, 2)
    slopes = np.stack([stages[..., 1], solution.controls.reshape(STEPS, 2) - stages[..., 0] ** 3], axis=-1)
    inside = stages - nodes[:-1, None] - h * np.einsum("ij,kja->kia", matrix, slopes)
    after = np.diff(nodes, axis=0) - h * np.einsum("j,kja->ka", weights, slopes)
    size = np.abs(nodes).max(axis=0)
    return max(np.max(np.abs(inside) / size), np.max(np.abs(after) / size))


@pytest.mark.parametrize("decade", range(12))
def test_a_success_solves_the_equations(spring, decade):
    solved = 0
    for reach in 10.0 ** (decade + np.arange(4) / 4):
        solution = spring.solve(np.zeros(2), np.full(2, reach), 1.0, max_iterations=60, throw=False)
        solved += solution.success
        # The terms of the force are as large as reach^3, and cancel.
        assert not solution.success or missed(solution) <= max(1e-9, 1e-15 * reach**2), (reach, solution)
    assert solved > 0 or decade > 0
