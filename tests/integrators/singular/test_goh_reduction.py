"""Goh's reduction alone: which problem it makes of a small one, and what it refuses."""

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem
from retrax.integrators.singular.strategies import GohReduction
from retrax.manifolds import Euclidean, InvalidInputError


def plane_problem() -> OptimalControlProblem:
    """In the plane, linear-quadratic, with one control that costs and one that does not."""

    def dynamics(q: Array, u: Array) -> Array:
        return jnp.stack([q[1] + u[0], u[1] - q[0] / 2])

    def cost(q: Array, u: Array) -> Array:
        return u[0] ** 2 / 2 + q[0] ** 2 / 2 + q[1] ** 2 + q[0] * q[1] / 3

    return OptimalControlProblem(Euclidean(2), dynamics, cost, 2)


def test_the_reduced_problem_of_one_free_control_of_two():
    """What costs stays a control, and the coordinate that the other one moves becomes one."""
    problem = plane_problem()
    reduction = GohReduction(problem, (1,))
    sign = reduction.complement[0, 0]
    for x, v, s in np.random.default_rng(0).standard_normal((4, 3)):
        q = reduction.point(jnp.array([x]), jnp.array([s]))
        np.testing.assert_allclose(reduction.coordinates(q), ([x], [s]), rtol=1e-13)
        found, u = reduction.reduced, jnp.array([v, s])
        np.testing.assert_allclose(found.velocity(jnp.array([x]), u), [sign * (q[1] + v)], rtol=1e-13)
        np.testing.assert_allclose(
            found.cost_rate(jnp.array([x]), u), problem.cost_rate(q, jnp.array([v, 0.0])), rtol=1e-13
        )
        np.testing.assert_allclose(q, [sign * x, reduction.directions[1, 0] * s], rtol=1e-13)
        moved = problem.velocity(q, reduction.controls(q, jnp.array([v]), jnp.array([0.7])))
        np.testing.assert_allclose(reduction.coordinates(moved)[1], [0.7], rtol=1e-13)


def test_a_reduction_is_checked_at_states_near_the_given_one():
    """These functions are finite where a state is beyond 50."""
    plane = plane_problem()

    def dynamics(q: Array, u: Array) -> Array:
        return plane.dynamics(q, u * jnp.sqrt(q[0] - 50.0) ** 2 / (q[0] - 50.0))

    problem = OptimalControlProblem(plane.manifold, dynamics, plane.running_cost, 2)
    reduction = GohReduction(problem, (1,), near=(jnp.array([90.0, 0.0]), jnp.zeros(2)))
    np.testing.assert_allclose(reduction.directions, [[0.0], [1.0]], atol=1e-13)


def test_a_cost_that_is_too_rough_for_its_potential_is_refused():
    """``cos(w x) u`` of ``x' = u`` has the potential ``sin(w x) / w``, which a quadrature finds up to some ``w``."""

    def problem(rate: float) -> OptimalControlProblem:
        return OptimalControlProblem(
            Euclidean(2),
            lambda q, u: jnp.stack([u[0] + q[1], -q[0]]),
            lambda q, u: q @ q / 2 + jnp.cos(rate * q[0]) * u[0],
            1,
        )

    for rate in (0.1, 1.0):
        reduction = GohReduction(problem(rate), (0,))
        for x in (-1.0, 0.0, 0.5):
            assert reduction.potential(jnp.array([x, 0.3])) == pytest.approx(np.sin(rate * x) / rate, abs=1e-9)
    for rate in (20.0, 40.0):
        with pytest.raises(InvalidInputError, match=r"misses it by .* too rough along their directions"):
            GohReduction(problem(rate), (0,))
