"""The axioms of discretization maps, their adjoints and their inverses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given
from retrax.manifolds import SO, DomainError, InvalidInputError, Sphere
from retrax.retractions import Adjoint, Cayley, Euler, Exponential, Midpoint, Projection, Theta
from retrax.retractions.discretization import newton_preimage

from tests.support.cases import INVERTED, RETRACTIONS, discretization_maps, inverted_maps, reach
from tests.support.maps import flat_map, map_facts, map_inverses
from tests.support.numerics import FRACTIONS, SEEDS, compiled, draw_point, flat, unflat

every_retraction = pytest.mark.parametrize("name", RETRACTIONS)
NORTH = jnp.array([0.0, 0.0, 1.0])


@every_retraction
@given(seed=SEEDS)
def test_zero_goes_to_the_base_point_twice(name, seed):
    facts = map_facts(name, seed, 0.0)
    for key in discretization_maps(name):
        np.testing.assert_allclose(facts[key]["value"], np.tile(facts["x"], 2), atol=1e-15, err_msg=key)


@every_retraction
@given(seed=SEEDS)
def test_the_derivatives_of_the_two_ends_at_zero_differ_by_the_identity(name, seed):
    facts = map_facts(name, seed, 0.0)
    for key in discretization_maps(name):
        first, second = np.split(facts[key]["push"], 2, axis=1)
        np.testing.assert_allclose(second - first, facts["basis"], atol=1e-12, err_msg=key)


@every_retraction
@given(seed=SEEDS)
def test_theta_says_where_the_base_point_sits(name, seed):
    # To first order the ends are x - theta v and x + (1 - theta) v.
    facts = map_facts(name, seed, 0.0)
    for key, discretization in discretization_maps(name).items():
        first, second = np.split(facts[key]["push"], 2, axis=1)
        np.testing.assert_allclose(first, -discretization.theta * facts["basis"], atol=1e-12, err_msg=key)
        np.testing.assert_allclose(second, (1 - discretization.theta) * facts["basis"], atol=1e-12, err_msg=key)


@every_retraction
@given(seed=SEEDS, fraction=FRACTIONS)
def test_the_midpoint_map_is_symmetric_and_an_adjoint_undoes_an_adjoint(name, seed, fraction):
    facts = map_facts(name, seed, fraction * reach(name))
    np.testing.assert_allclose(facts["adjoint of the midpoint"], facts["midpoint"], atol=1e-15)
    np.testing.assert_array_equal(facts["midpoint"], facts["theta=0.5"]["value"])
    for key in discretization_maps(name):
        np.testing.assert_array_equal(facts[f"adjoint of the adjoint of {key}"], facts[key]["value"])


@given(seed=SEEDS)
def test_the_adjoint_of_theta_is_one_minus_theta_with_the_retractions_exchanged(seed):
    first, second = Exponential(Sphere(2)), Projection(Sphere(2))
    adjoint, exchanged = Adjoint(Theta(first, 0.3, second)), Theta(second, 0.7, first)
    x, v, _ = draw_point(Sphere(2), seed)
    assert adjoint.theta == pytest.approx(exchanged.theta)
    np.testing.assert_allclose(flat(adjoint(x, v)), flat(exchanged(x, v)), atol=1e-15)
    assert np.max(np.abs(flat(adjoint(x, v)) - flat(Theta(first, 0.7, second)(x, v)))) > 1e-6


@pytest.mark.parametrize("name", INVERTED)
@given(seed=SEEDS, fraction=FRACTIONS)
@example(seed=0, fraction=0.0)
@example(seed=0, fraction=1.0)
def test_inverse_finds_the_tangent_vector(name, seed, fraction):
    facts = map_inverses(name, seed, fraction * min(1.0, reach(name)))
    for key in inverted_maps(name):
        np.testing.assert_allclose(facts[key]["back"], facts["w"], atol=1e-12, err_msg=key)


@pytest.mark.parametrize("name", INVERTED)
@given(seed=SEEDS)
def test_a_map_inverts_its_inverse(name, seed):
    facts = map_inverses(name, seed, 0.0)
    for key in inverted_maps(name):
        np.testing.assert_allclose(facts[key]["there"], facts["ends"], atol=1e-13, err_msg=key)


@compiled
def _both_inverses(w):
    discretization = Midpoint(Exponential(Sphere(2)))
    ends = jnp.split(flat_map(discretization)(w), 2)
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
    with pytest.raises(InvalidInputError, match=r"made from retractions, got .*; try Cayley\(manifold\)"):
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
    name = "exponential-(SO3*R3)*S2"
    facts = map_facts(name, seed, 1.0)
    unravel, sphere = unflat(RETRACTIONS[name].manifold), Theta(Exponential(Sphere(2)), 0.3)
    x, v = unravel(facts["x"]), unravel(facts["v"])
    first, second = (unravel(end)[1] for end in np.split(facts["theta=0.3"]["value"], 2))
    np.testing.assert_allclose(np.stack(sphere(x[1], v[1])), np.stack([first, second]), atol=1e-15)
