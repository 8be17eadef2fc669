"""``solve`` with four arguments, what it chooses for the others, and its former order of arguments."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, solve
from retrax.manifolds import Euclidean, InvalidInputError, Sphere
from retrax.retractions import Addition, Gauss, Midpoint, default_retraction

from .problems import half_square

PLANE = Euclidean(2)
METHOD = Midpoint(Addition(PLANE))
CART = OptimalControlProblem(PLANE, lambda q, u: jnp.stack([q[1], u[0]]), half_square, 1)
BOUNDED = OptimalControlProblem(
    PLANE, lambda q, u: jnp.stack([q[1], u[0]]), lambda q, u: 1.0, 1, control_bounds=(-1.0, 1.0)
)


def test_four_arguments_are_enough():
    """A cart from rest to rest in unit time: 6 exactly, by the method of order 6."""
    found = solve(CART, [0.0, 0.0], [1.0, 0.0], 1.0)
    assert found.status == "minimum"
    assert found.cost == pytest.approx(6.0, rel=1e-12)
    assert len(found.stage_times) == 3 * found.steps
    assert "3 stages a step, retraction Addition(manifold=Euclidean(shape=(2,)))" in str(found)


@pytest.mark.parametrize("distance", [0.1, 1.0, 3.0])
@pytest.mark.usual(1)
def test_the_mesh_is_refined_where_no_steps_are_given(distance):
    """Least time between two points at rest is ``2 sqrt(distance)``."""
    found = solve(BOUNDED, [0.0, 0.0], [distance, 0.0], Free(1.0))
    assert found.checks.error <= 1e-6
    assert found.horizon == pytest.approx(2 * np.sqrt(distance), rel=1e-6)


def test_the_default_method_is_that_of_the_default_retraction():
    sphere = Sphere(2)
    turned = OptimalControlProblem(sphere, lambda q, u: jnp.cross(u, q), half_square, 3)
    start, end = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.6, 0.8])
    own = solve(turned, start, end, 1.0, steps=6)
    method = Gauss(3, default_retraction(sphere))
    assert own.cost == solve(turned, start, end, 1.0, method=method, steps=6).cost
    assert own.cost == pytest.approx((np.pi / 2) ** 2 / 2, rel=1e-9)


@pytest.mark.parametrize(
    ("arguments", "options"),
    [
        ((CART, METHOD, np.zeros(2), np.ones(2), 1.0, 5), {}),
        ((CART, METHOD), {"start": np.zeros(2), "end": np.ones(2), "horizon": 1.0, "steps": 5}),
        ((CART,), {"discretization": METHOD, "start": np.zeros(2), "end": np.ones(2), "horizon": 1.0, "steps": 5}),
        ((CART, METHOD, np.zeros(2), np.ones(2), 1.0, 5, None, 1e-10), {"max_iterations": 50}),
    ],
)
def test_the_former_order_works_with_a_warning(arguments, options):
    with pytest.warns(DeprecationWarning, match="write solve") as caught:
        found = solve(*arguments, **options)
    assert caught[0].filename == __file__
    assert found.cost == solve(CART, np.zeros(2), np.ones(2), 1.0, method=METHOD, steps=5).cost


def test_an_argument_twice_is_refused_in_the_former_order_too():
    with pytest.raises(InvalidInputError, match="was given an argument twice"):
        solve(CART, METHOD, np.zeros(2), np.ones(2), 1.0, 5, steps=6)
