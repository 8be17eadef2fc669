"""Ends far beyond what the steps resolve: whatever the iteration runs into, a success solves the equations."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Solver
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Gauss, Midpoint

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


@pytest.mark.long("1", "3", "5", "7", "9")
@pytest.mark.parametrize("decade", range(12))
def test_a_success_solves_the_equations(spring, decade):
    solved = 0
    for reach in 10.0 ** (decade + np.arange(4) / 4):
        solution = spring.solve(np.zeros(2), np.full(2, reach), 1.0, max_iterations=60, throw=False)
        solved += solution.success
        # The terms of the force are as large as reach^3, and cancel.
        assert not solution.success or missed(solution) <= max(1e-9, 1e-15 * reach**2), (reach, solution)
    assert solved > 0 or decade > 0


def test_a_trajectory_that_grows_without_end_is_no_success():
    """``x' = x u, y' = y + v, z' = x (1 - v)`` from rest to ``(1, y, 1)``, in two steps.

    No control moves x from zero, but with ``u = 4`` the midpoint's first step leads to any x. All extremals have
    ``-2 < x < 2`` there; beyond these the cost only tends to a limit.
    """
    space = Euclidean(3)
    problem = OptimalControlProblem(
        space, lambda q, u: jnp.stack([q[0] * u[0], q[1] + u[1], q[0] * (1 - u[1])]), lambda q, u: u @ u / 2, controls=2
    )
    far = 10.0 ** (np.arange(72) / 8)
    ends = np.stack([np.ones_like(far), far, np.ones_like(far)], axis=1)
    solutions = Solver(problem, Midpoint(Addition(space)), 2).solve_many(np.zeros(3), ends, 1.0)
    assert np.all(np.abs(solutions.states[solutions.success, 1, 0]) < 2)
    assert np.mean(solutions.success) > 0.8
