"""Cotangent lifts of diffeomorphisms, and the isomorphisms between the bundles."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.manifolds import SO, Sphere
from retrax.manifolds.symplectic import Phi, Phi_inverse, alpha, alpha_inverse
from retrax.retractions import cotangent_lift

from tests.support.numerics import SEEDS, compiled, draw_point

SPHERE = Sphere(2)


def stretched(matrix):
    """The diffeomorphism ``x -> A x / |A x|`` of the sphere."""
    return lambda x: matrix @ x / jnp.linalg.norm(matrix @ x)


def lift(diffeomorphism):
    return cotangent_lift(diffeomorphism, SPHERE, SPHERE)


@compiled
def _sphere(x, p, v, a, b):
    f, g = stretched(a), stretched(b)
    y, q = lift(f)(x, p)
    return {
        "lifted": (y, q),
        "value": f(x),
        "pushed": jax.jvp(f, (x,), (v,))[1],
        "composed": lift(lambda x: f(g(x)))(x, p),
        "one by one": lift(f)(*lift(g)(x, p)),
        "back": lift(stretched(jnp.linalg.inv(a)))(y, q),
        "of a normal covector": lift(f)(x, p + 0.7 * x),
    }


def draw(seed: int) -> tuple:
    """A covector, a tangent vector at the same point, and two invertible matrices."""
    rng = np.random.default_rng(seed)
    x, p, basis = draw_point(SPHERE, seed)
    matrices = np.eye(3) + 0.3 * rng.uniform(-1, 1, (2, 3, 3))
    return x, p, rng.standard_normal(2) @ basis, *matrices


@given(seed=SEEDS)
def test_the_lift_of_a_diffeomorphism_preserves_the_canonical_one_form(seed):
    # theta' = theta says <p', DF v> = <p, v> for every v: the lift moves dq by DF.
    x, p, v, a, b = draw(seed)
    facts = _sphere(x, p, v, a, b)
    y, q = facts["lifted"]
    np.testing.assert_allclose(y, facts["value"], atol=1e-15)
    np.testing.assert_allclose(q @ facts["pushed"], p @ v, atol=1e-13)
    np.testing.assert_allclose(q @ y, 0, atol=1e-14)


@given(seed=SEEDS)
def test_the_lift_is_functorial(seed):
    facts = _sphere(*draw(seed))
    np.testing.assert_allclose(np.stack(facts["composed"]), np.stack(facts["one by one"]), atol=1e-13)


@given(seed=SEEDS)
def test_the_lift_of_the_inverse_is_the_inverse_of_the_lift(seed):
    x, p, *rest = draw(seed)
    np.testing.assert_allclose(np.stack(_sphere(x, p, *rest)["back"]), np.stack([x, p]), atol=1e-13)


@given(seed=SEEDS)
def test_only_the_tangential_part_of_a_covector_counts(seed):
    facts = _sphere(*draw(seed))
    np.testing.assert_allclose(np.stack(facts["of a normal covector"]), np.stack(facts["lifted"]), atol=1e-14)


@compiled
def _rotated(x, p, rotation):
    return lift(lambda x: rotation @ x)(x, p)


@given(seed=SEEDS)
def test_a_rotation_of_the_sphere_rotates_covectors(seed):
    x, p, _ = draw_point(SPHERE, seed)
    rotation = draw_point(SO(3), seed)[0].reshape(3, 3)
    np.testing.assert_allclose(np.stack(_rotated(x, p, rotation)), np.stack([rotation @ x, rotation @ p]), atol=1e-14)


@given(seed=SEEDS)
def test_alpha_and_phi_are_inverted_by_their_inverses(seed):
    a, b, c, d = quadruple = tuple(np.random.default_rng(seed).standard_normal((4, 3)))
    assert alpha(*alpha_inverse(*quadruple)) == quadruple
    assert alpha_inverse(*alpha(*quadruple)) == quadruple
    np.testing.assert_array_equal(np.array(Phi_inverse(*Phi((a, b), (c, d)))), np.array([[a, b], [c, d]]))
    np.testing.assert_array_equal(np.array(Phi(*Phi_inverse((a, b), (c, d)))), np.array([[a, b], [c, d]]))


def test_alpha_and_phi_are_those_of_the_paper():
    assert alpha("q", "v", "p_q", "p_v") == ("q", "p_v", "v", "p_q")
    assert alpha_inverse("q", "p", "qdot", "pdot") == ("q", "qdot", "pdot", "p")
    ends, covector = Phi((jnp.array(1.0), jnp.array(2.0)), (jnp.array(3.0), jnp.array(4.0)))
    assert ends == (1.0, 3.0)
    assert covector == (-2.0, 4.0)


@pytest.mark.parametrize("size", [2, 3])
def test_phi_makes_omega_twelve_of_the_canonical_form(size):
    # Phi is linear: the canonical form of T*(Q x Q) pulled back by it is pr2* omega - pr1* omega.
    def linear(z):
        q0, p0, q1, p1 = jnp.split(z, 4)
        return jnp.concatenate([jnp.ravel(jnp.stack(part)) for part in Phi((q0, p0), (q1, p1))])

    jacobian = np.asarray(jax.jit(jax.jacfwd(linear))(np.zeros(4 * size)))
    half, zero = np.eye(2 * size), np.zeros((2 * size, 2 * size))
    canonical = np.block([[zero, half], [-half, zero]])
    one = np.kron(np.array([[0.0, 1.0], [-1.0, 0.0]]), np.eye(size))
    np.testing.assert_array_equal(jacobian.T @ canonical @ jacobian, np.block([[-one, zero], [zero, one]]))
