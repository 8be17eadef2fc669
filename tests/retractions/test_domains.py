"""Where retractions can be inverted, and what is said where they cannot."""

from functools import lru_cache
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from retrax.manifolds import SE, SO, DomainError, Sphere, hat
from retrax.retractions import Cayley, Exponential, Orthographic, Polar, Projection, Retraction

from tests.support.cases import CURVE, RETRACTIONS
from tests.support.numerics import SEEDS, compiled, draw_point, draw_tangent

NORTH = np.array([0.0, 0.0, 1.0])
HALF_TURN = np.diag([-1.0, -1.0, 1.0])
WORDS = r"outside the image of {} at the base point.*: .* take a nearer point, or a retraction with a larger image"


@final
class GreatCircle(Retraction):
    """Great circles of the sphere, without a closed inverse."""

    manifold: Sphere

    def retract(self, x, v):
        return Exponential(self.manifold)(x, v)


OUTSIDE = {
    "antipode": (Exponential(Sphere(2)), NORTH, -NORTH),
    "equator": (Projection(Sphere(2)), NORTH, np.array([1.0, 0.0, 0.0])),
    "southern hemisphere": (Projection(Sphere(2)), NORTH, np.array([0.6, 0.0, -0.8])),
    "half turn, Cayley": (Cayley(SO(3)), np.eye(3), HALF_TURN),
    "half turn, exponential": (Exponential(SO(3)), np.eye(3), HALF_TURN),
    "half turn, in four dimensions": (Cayley(SO(4)), np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0])),
    "quarter turn, polar": (Polar(SO(2)), np.eye(2), np.array([[0.0, -1.0], [1.0, 0.0]])),
    "far, by Newton": (GreatCircle(Sphere(2)), NORTH, -NORTH),
}


@lru_cache
def _domain(name: str):
    return compiled(RETRACTIONS[name].domain)


@pytest.mark.parametrize("name", OUTSIDE)
@pytest.mark.usual(2)
def test_inverse_says_what_to_do_outside_the_image(name):
    retraction, x, y = OUTSIDE[name]
    with pytest.raises(DomainError, match=WORDS.format(type(retraction).__name__)):
        retraction.inverse(jnp.asarray(x), jnp.asarray(y))


@pytest.mark.parametrize("name", OUTSIDE)
@pytest.mark.usual(2)
def test_under_jit_the_inverse_is_nan_outside_the_image(name):
    retraction, x, y = OUTSIDE[name]
    assert np.all(np.isnan(jax.jit(retraction.inverse)(x, y)))


@given(seed=SEEDS)
def test_no_half_turn_has_a_cayley_inverse(seed):
    x, _, _ = draw_point(SO(3), seed)
    axis, _, _ = draw_point(Sphere(2), seed)
    x = jnp.asarray(x.reshape(3, 3))
    with pytest.raises(DomainError):
        Cayley(SO(3)).inverse(x, x @ (2 * jnp.outer(axis, axis) - jnp.eye(3)))


def test_inverse_is_checked_at_any_part_of_a_product():
    retraction = RETRACTIONS["exponential-(SO3*R3)*S2"]
    x = (jnp.eye(3), jnp.zeros(3)), jnp.asarray(NORTH)
    with pytest.raises(DomainError, match="ProductRetraction"):
        retraction.inverse(x, (x[0], -NORTH))
    np.testing.assert_array_equal(retraction.inverse(x, x)[1], 0)


@given(seed=SEEDS, length=st.floats(0.0, 6.0))
def test_the_domain_of_the_exponential_of_the_sphere_is_the_ball_of_radius_pi(seed, length):
    assume(abs(length - np.pi) > 4 * np.pi * 1.5e-8)  # where rounding leaves half of the digits of the direction
    x, _, basis = draw_point(Sphere(2), seed)
    v = draw_tangent(np.random.default_rng(seed), basis, length)
    assert bool(_domain("exponential-S2")(x, v)) == (length < np.pi)


@given(seed=SEEDS, angle=st.floats(0.0, 6.0))
def test_the_domain_of_the_exponential_of_rotations_is_all_angles_below_pi(seed, angle):
    assume(abs(angle - np.pi) > 1e-12)
    x = draw_point(SO(3), seed)[0].reshape(3, 3)
    axis, _, _ = draw_point(Sphere(2), seed)
    v = x @ np.asarray(hat(angle * jnp.asarray(axis)))
    assert bool(_domain("exponential-SO3")(x, v)) == (angle < np.pi)


@pytest.mark.parametrize("name", ["projection-S2", "cayley-SO3", "polar-SO3", "qr-SO3"])
@given(seed=SEEDS, length=st.floats(0.0, 1e3))
def test_the_domain_is_the_whole_tangent_space(name, seed, length):
    manifold = RETRACTIONS[name].manifold
    x, _, basis = draw_point(manifold, seed)
    x, v = (a.reshape(manifold.ambient.shape) for a in (x, draw_tangent(np.random.default_rng(seed), basis, length)))
    assert _domain(name)(x, v)
    assert not _domain(name)(x, np.nan * v)


def test_the_domain_without_a_closed_form_is_where_the_inverse_comes_back():
    retraction = GreatCircle(Sphere(2))
    domain = jax.jit(retraction.domain)
    assert domain(NORTH, np.array([1.0, 0.0, 0.0]))
    assert not domain(NORTH, jnp.array([5.0, 0.0, 0.0]))
    # Not a tangent vector: the inverse finds a tangent one.
    assert not domain(NORTH, jnp.array([0.3, 0.0, 0.3]))


@pytest.mark.parametrize(
    ("retraction", "written"),
    [
        (GreatCircle(Sphere(2)), set()),
        (Exponential(Sphere(2)), {"preimage", "domain"}),
        (Exponential(SE(3)), {"preimage", "domain", "frame", "chart", "both_ways"}),
        (Polar(SO(3)), {"preimage", "domain", "frame", "chart", "both_ways"}),
        (Orthographic(CURVE, Projection(Sphere(2))), {"preimage"}),
    ],
    ids=lambda case: type(case).__name__,
)
def test_a_retraction_says_which_defaults_its_class_has_closed_forms_for(retraction, written):
    assert retraction.closed_forms == written


@lru_cache
def _logarithm():
    return compiled(Exponential(Sphere(2)).inverse)


ANGLES = st.one_of(st.floats(1e-9, np.pi - 1e-9), st.sampled_from([1e-9, 1e-4, 0.1, np.pi / 2, 3.14, np.pi - 1e-9]))


@given(angle=ANGLES, direction=st.floats(0.0, 6.28))
def test_the_logarithm_of_the_sphere_from_the_pole_is_exact(angle, direction):
    # From a pole a point keeps the relative accuracy of its small coordinates.
    u = np.array([np.cos(direction), np.sin(direction), 0.0])
    y = np.sin(angle) * u + np.array([0.0, 0.0, np.cos(angle)])
    np.testing.assert_allclose(_logarithm()(np.asarray(NORTH), y), angle * u, rtol=0, atol=3e-15 * angle)


@given(angle=ANGLES, seed=SEEDS)
def test_the_logarithm_of_the_sphere_is_as_exact_as_its_points(angle, seed):
    # Rounding of the points by 1e-16 turns the vector by 1e-16 / sin(angle), and changes its length by 1e-16.
    x, _, basis = draw_point(Sphere(2), seed)
    u = draw_tangent(np.random.default_rng(seed), basis, 1.0)
    v = _logarithm()(x, np.cos(angle) * x + np.sin(angle) * u)
    np.testing.assert_allclose(np.linalg.norm(v), angle, rtol=0, atol=2e-15)
    np.testing.assert_allclose(v, angle * u, rtol=0, atol=1e-15 * (1 + angle / np.sin(angle)))


@pytest.mark.parametrize("seed", range(10))
def test_no_direction_leads_to_the_antipode_of_any_point(seed):
    # Rounding leaves the antipode a normal part, along which the exponential would seem to arrive.
    x = Sphere(2).random_point(jax.random.key(seed))
    with pytest.raises(DomainError):
        Exponential(Sphere(2)).inverse(x, -x)
