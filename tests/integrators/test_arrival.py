"""Guesses from which nothing but a search over the whole trajectory arrives: states drawn at random, flat costs."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, Guess, OptimalControlProblem, Solver
from retrax.manifolds import SE, SO, Euclidean, Product, hat
from retrax.retractions import Addition, Gauss, Midpoint, default_retraction
from scipy.spatial.transform import Rotation

STEPS = 30


@pytest.fixture(scope="module")
def docking():
    """A free body with forces and moments, from rest to rest at a pose half a turn away."""
    group = SE(3)
    Q, inertia = group * Euclidean(6), np.array([1.0, 1.7, 2.3, 2.0, 2.0, 2.0])

    def dynamics(q, u):
        pose, twist = q
        momentum = inertia * twist
        turn = jnp.concatenate([jnp.cross(momentum[:3], twist[:3]), jnp.cross(momentum[3:], twist[:3])])
        return pose @ group.hat(twist), (u + turn) / inertia

    problem = OptimalControlProblem(Q, dynamics, lambda _, u: u @ u / 2, 6)
    return Solver(problem, Midpoint(default_retraction(Q)), STEPS), problem


def scattered(manifold: Product, seed: int) -> Guess:
    """States drawn at random, each by itself, and random controls."""
    draw = np.random.default_rng([1, seed])
    states = []
    for _ in range(STEPS):
        key = jax.random.key(int(draw.integers(2**31)))
        states.append((np.asarray(manifold.factors[0].random_point(key)), draw.standard_normal(6)))
    return Guess(tuple(map(np.stack, zip(*states, strict=True))), 2 * draw.standard_normal((STEPS, 6)))


@pytest.mark.parametrize("seed", [3, 4, 7, 9])
@pytest.mark.usual(1)
def test_docking_arrives_from_scattered_states(docking, seed):
    solver, problem = docking
    pose = SE(3).pose(Rotation.from_rotvec([2.9, 0.3, -0.4]).as_matrix(), np.array([3.0, -2.0, 1.0]))
    rest = np.zeros(6)
    guess = scattered(problem.manifold, seed)
    ends = (np.eye(4), rest), (np.asarray(pose), rest)
    # From so far off it takes 30 to 115 iterations, and rounding alone changes their number by twenty.
    solution = solver.solve(*ends, 5.0, guess=guess, throw=False, max_iterations=200)
    assert solution.success, solution.result


@pytest.mark.parametrize("method", [Midpoint, partial(Gauss, 2), partial(Gauss, 3)], ids=["midpoint", "two", "three"])
@pytest.mark.parametrize("current", [0.0, 0.2, 0.5, 0.9])
@pytest.mark.usual(2)
def test_least_time_with_a_heading_needs_no_bounds_of_the_horizon(method, current):
    """Zermelo's navigation around a vortex: the cost is flat in the controls, and saddles turn many times."""

    def velocity(q, u):
        x, y = q[0] - 2, q[1]
        pull = current / (x**2 + y**2 + 0.5)
        return jnp.stack([jnp.cos(u[0]) - pull * y, jnp.sin(u[0]) + pull * x])

    plane = Euclidean(2)
    solver = Solver(OptimalControlProblem(plane, velocity, lambda q, u: 1.0, 1), method(Addition(plane)), 20)
    way = np.zeros(2), np.array([4.0, 0.0])
    bounded = solver.solve(*way, Free(4.0, 0.5, 20.0))
    for guess in (3.0, 4.0, 6.0):
        found = solver.solve(*way, Free(guess))
        assert found.checks.strict_minimum
        assert found.statistics.iterations <= 40
        np.testing.assert_allclose(found.horizon, bounded.horizon, rtol=1e-8)


@pytest.mark.parametrize("place", ["start", "end", "beside"])
def test_a_guess_at_rest_that_cannot_be_steered_from_is_no_flat_cost(place):
    """Turns about two axes towards one about the third: at rest the ends depend on each other, and nothing is near."""
    rotations, end = SO(3), Rotation.from_rotvec([0.4, -0.3, 1.6]).as_matrix()
    problem = OptimalControlProblem(rotations, lambda q, u: q @ hat(jnp.append(u, 0.0)), lambda q, u: u @ u / 2, 2)
    solver = Solver(problem, Midpoint(default_retraction(rotations)), 40)
    at = {"start": np.eye(3), "end": end, "beside": Rotation.from_rotvec([1.0, 2.0, -0.5]).as_matrix()}[place]
    guess = Guess(np.broadcast_to(at, (40, 3, 3)), np.zeros((40, 2)))
    found = solver.solve(np.eye(3), end, 1.0, guess=guess, throw=False)
    np.testing.assert_allclose(found.states[0], np.eye(3), atol=1e-9)
    assert not found.success or found.cost > 7.148
