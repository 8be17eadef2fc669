"""Every discretization map satisfies the facts of the conformance kit; adjoints, inverses, wrong arguments."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.manifolds import SO, DomainError, Euclidean, InvalidInputError, Sphere
from retrax.retractions import (
    Addition,
    Adjoint,
    Cayley,
    Euler,
    Exponential,
    Midpoint,
    ProductRetraction,
    Projection,
    Theta,
)
from retrax.retractions.discretization import newton_preimage
from retrax.testing import check_discretization_map
from retrax.testing.checks.discretization import flat_ends

from tests.support.cases import MAPS, reach
from tests.support.numerics import SEEDS, compiled, draw_point, flat, unflat

NORTH = jnp.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.usual("theta=0.3, exponential-S2")
def test_is_a_discretization_map(name, seeds):
    discretization = MAPS[name]
    symmetric = isinstance(discretization, Theta) and discretization.theta == 0.5 and discretization.other is None
    reach_ = min(1.0, reach(name))
    check_discretization_map(discretization, symmetric=symmetric, reach=reach_, seeds=seeds, tolerance=1e-13)


@given(seed=SEEDS)
def test_an_adjoint_undoes_an_adjoint(seed):
    discretization = Theta(Exponential(Sphere(2)), 0.3, Projection(Sphere(2)))
    x, v, _ = draw_point(Sphere(2), seed)
    np.testing.assert_array_equal(flat(Adjoint(Adjoint(discretization))(x, v)), flat(discretization(x, v)))


@given(seed=SEEDS)
def test_the_adjoint_of_theta_is_one_minus_theta_with_the_retractions_exchanged(seed):
    first, second = Exponential(Sphere(2)), Projection(Sphere(2))
    adjoint, exchanged = Adjoint(Theta(first, 0.3, second)), Theta(second, 0.7, first)
    x, v, _ = draw_point(Sphere(2), seed)
    assert adjoint.theta == pytest.approx(exchanged.theta)
    np.testing.assert_allclose(flat(adjoint(x, v)), flat(exchanged(x, v)), atol=1e-15)
    unit = v / np.linalg.norm(v)  # what is exchanged shows in the third power of a vector's length
    assert np.max(np.abs(flat(adjoint(x, unit)) - flat(Theta(first, 0.7, second)(x, unit)))) > 1e-3


@pytest.mark.parametrize("theta", [0.0, 0.5, 1.0])
def test_the_inverse_of_an_adjoint_returns(theta):
    adjoint, z = (
        Adjoint(Theta(Exponential(Sphere(2)), theta)),
        (jnp.array([0.6, 0.0, 0.8]), jnp.array([0.4, 1.0, -0.3])),
    )
    np.testing.assert_allclose(flat(adjoint.preimage(*adjoint(*z))), flat(z), atol=1e-14)


@compiled
def _both_inverses(w):
    discretization = Midpoint(Exponential(Sphere(2)))
    ends = jnp.split(flat_ends(discretization)(w), 2)
    return flat(discretization.inverse(*ends)), flat(newton_preimage(discretization, *ends))


@given(seed=SEEDS)
def test_newtons_method_finds_the_closed_inverse_of_the_midpoint_map(seed):
    x, v, _ = draw_point(Sphere(2), seed)
    closed, newton = _both_inverses(np.concatenate([x, v / (1 + np.linalg.norm(v))]))
    np.testing.assert_allclose(newton, closed, atol=1e-13)


def test_euler_and_midpoint_are_thetas():
    retraction = Cayley(SO(3))
    assert Euler(retraction) == Theta(retraction, 0.0)
    assert Midpoint(retraction) == Theta(retraction, 0.5)
    assert Theta(retraction, 0.3).manifold == SO(3)
    assert Adjoint(Euler(retraction)).theta == 1.0


@pytest.mark.parametrize("theta", [0.0, 0.3, 0.5, 1.0])
def test_inverse_says_what_to_do_outside_the_image(theta):
    discretization = Theta(Exponential(Sphere(2)), theta)
    with pytest.raises(DomainError, match=r"outside the image of Theta: .* take points nearer to each other"):
        discretization.inverse(NORTH, -NORTH)
    if theta in (0.0, 0.5):
        assert np.all(np.isnan(jax.jit(discretization.inverse)(NORTH, -NORTH)[1]))


@pytest.mark.parametrize("theta", [-0.1, 1.1, float("nan"), float("inf")])
def test_theta_outside_the_unit_interval_is_refused(theta):
    with pytest.raises(InvalidInputError, match=r"theta must lie in \[0, 1\], got"):
        Theta(Cayley(SO(3)), theta)


@pytest.mark.parametrize("given_", [Sphere(2), Exponential, None, "cayley"], ids=["manifold", "family", "None", "name"])
def test_a_map_of_something_else_than_a_retraction_is_refused(given_):
    with pytest.raises(InvalidInputError, match=r"made from retractions, got .*; try default_retraction\(manifold\)"):
        Midpoint(given_)


def test_a_second_retraction_that_is_none_is_refused():
    with pytest.raises(InvalidInputError, match="made from retractions"):
        Theta(Cayley(SO(3)), 0.5, Sphere(2))


@pytest.mark.parametrize("other", [Sphere(2), SO(4)], ids=["another kind", "another size"])
def test_two_retractions_of_two_manifolds_are_refused(other):
    with pytest.raises(InvalidInputError, match="both retractions must act on one manifold, got"):
        Theta(Exponential(SO(3)), 0.5, Exponential(other))


@given(seed=SEEDS)
def test_a_map_of_a_product_is_the_product_of_maps(seed):
    product = Theta(Exponential(SO(3) * Sphere(2)), 0.3)
    x, v, _ = draw_point(product.manifold, seed)
    x, v = map(unflat(product.manifold), (x, v))
    ends, sphere = product(x, v), Theta(Exponential(Sphere(2)), 0.3)(x[1], v[1])
    np.testing.assert_allclose(np.stack(sphere), np.stack([ends[0][1], ends[1][1]]), atol=1e-15)


def test_the_inverse_of_a_map_of_a_product_returns_with_two_retractions():
    space, plane = Sphere(2) * Euclidean(1), Addition(Euclidean(1))
    first, second = (ProductRetraction(own, plane) for own in (Exponential(Sphere(2)), Projection(Sphere(2))))
    x, v, _ = draw_point(space, 0)
    z = tuple(map(unflat(space), (x, 0.3 * v)))
    discretization = Theta(first, 0.3, second)
    np.testing.assert_allclose(flat(discretization.preimage(*discretization(*z))), flat(z), atol=1e-12)
