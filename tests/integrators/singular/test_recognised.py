"""Whether a problem is regular is seen at its functions, at every scale."""

import jax
import jax.numpy as jnp
import pytest
from retrax.integrators import OptimalControlProblem
from retrax.integrators.problem.initial_controls import resting_control
from retrax.integrators.problem_checks.inspection import Inspection
from retrax.manifolds import Euclidean
from retrax.problems import SINGULAR


@pytest.mark.parametrize("name", ["academic", "aly-chan", "sphere", "free actuator", "brown", "dummy control"])
def test_singular_problems_are_recognised(name):
    problem = SINGULAR[name]().problem
    q = problem.manifold.random_point(jax.random.key(1))
    assert not Inspection(problem, q, resting_control(problem.controls)).is_regular


@pytest.mark.parametrize(
    "cost",
    [
        lambda u: 1e-9 * u @ u,
        lambda u: 1e9 * u[0] ** 2 + u[1] ** 2,
        lambda u: jnp.sum(u**4),
        lambda u: jnp.sum(jnp.cosh(u)),
    ],
    ids=["weak", "unequal", "quartic", "not quadratic"],
)
def test_regular_problems_are_recognised_at_every_scale(cost):
    problem = OptimalControlProblem(Euclidean(2), lambda q, u: u, lambda q, u: q @ q + cost(u), 2)
    assert Inspection(problem, jnp.ones(2), jnp.zeros(2)).is_regular
