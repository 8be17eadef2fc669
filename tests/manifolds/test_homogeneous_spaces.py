"""Rotations in three coordinates, group actions and their momenta."""

import re
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.manifolds import SO, Euclidean, HomogeneousSpace, InvalidInputError, Product, Sphere, hat, vee
from retrax.manifolds.numerics import ambient as vec
from retrax.manifolds.product import homogeneous_factors

from tests.support.cases import MANIFOLDS, NESTED
from tests.support.numerics import SEEDS, compiled, draw_point, unflat

SPACES = [name for name, manifold in MANIFOLDS.items() if isinstance(manifold, HomogeneousSpace)]
ROTATIONS = ["SO2", "SO3", "SO4"]
EULER = compiled(lambda w, y: (hat(w) @ y, vee(hat(w)), hat(w)))


@lru_cache
def _generators(name: str):
    space, unravel = MANIFOLDS[name], unflat(MANIFOLDS[name])

    def facts(x, p):
        q = unravel(x)
        return vec.flatten_frame(space.generators(q)), space.momentum(q, unravel(p)), space.basis(q)

    return compiled(facts)


@lru_cache
def _trivialisations(name: str):
    space = MANIFOLDS[name]

    def facts(x, p, mu):
        eye = jnp.eye(space.n)
        return space.body(x, p), space.spatial(x, p), space.body(x, space.covector(x, mu)), space.generators(eye)

    return compiled(facts)


@given(seed=SEEDS)
def test_hat_is_the_cross_product_and_vee_its_inverse(seed):
    w, y = np.random.default_rng(seed).standard_normal((2, 3))
    turned, back, matrix = EULER(w, y)
    np.testing.assert_allclose(turned, np.cross(w, y), atol=1e-14)
    np.testing.assert_array_equal(back, w)
    np.testing.assert_array_equal(matrix, -matrix.T)


@given(seed=SEEDS)
def test_vee_takes_the_skew_part(seed):
    a = np.random.default_rng(seed).standard_normal((3, 3))
    np.testing.assert_allclose(EULER(np.asarray(vee(jnp.asarray(a))), np.zeros(3))[2], (a - a.T) / 2, atol=1e-15)


@pytest.mark.long("R2x3", "U2", "SL2", "heisenberg", "SPD2", "Gr42", "oblique32")
@pytest.mark.parametrize("name", SPACES)
@given(seed=SEEDS)
@pytest.mark.usual(
    "R2x3", "S2", "SO3", "SE3", "SU2", "U2", "SL2", "heisenberg", "H2", "SPD2", "St42", "Gr42", "oblique32"
)
def test_momentum_pairs_the_covector_with_the_generators(name, seed):
    x, p, _ = draw_point(MANIFOLDS[name], seed)
    xi, momentum, _ = _generators(name)(x, p)
    np.testing.assert_allclose(momentum, xi @ p, atol=1e-14)


@given(seed=SEEDS)
def test_momentum_of_a_rotation_of_space_is_the_angular_momentum(seed):
    x, p, _ = draw_point(Sphere(2), seed)
    np.testing.assert_allclose(_generators("S2")(x, p)[1], np.cross(x, p), atol=1e-14)


@pytest.mark.parametrize("name", ROTATIONS)
@given(seed=SEEDS)
def test_covector_inverts_body(name, seed):
    space = MANIFOLDS[name]
    x, p, _ = draw_point(space, seed)
    mu = np.random.default_rng(seed).standard_normal(space.dimension)
    shape = (space.n, space.n)
    _, _, back, _ = _trivialisations(name)(x.reshape(shape), p.reshape(shape), mu)
    np.testing.assert_allclose(back, mu, atol=1e-14)


@pytest.mark.parametrize("name", ROTATIONS)
@given(seed=SEEDS)
def test_spatial_covector_is_the_body_covector_moved_by_the_point(name, seed):
    space = MANIFOLDS[name]
    x, p, _ = draw_point(space, seed)
    x, p = x.reshape(space.n, space.n), p.reshape(space.n, space.n)
    body, spatial, _, e = _trivialisations(name)(x, p, np.zeros(space.dimension))
    np.testing.assert_allclose(np.tensordot(spatial, e, 1), x @ np.tensordot(body, e, 1) @ x.T, atol=1e-13)
    if space.n == 3:
        np.testing.assert_allclose(spatial, x @ body, atol=1e-14)
        w = np.random.default_rng(seed).standard_normal(3)
        np.testing.assert_allclose(np.sum(p * (x @ EULER(w, w)[2])), body @ w, atol=1e-13)


def test_the_star_flattens_and_product_nests():
    flat = SO(3) * Euclidean(3) * Sphere(2)
    assert flat.factors == (SO(3), Euclidean(3), Sphere(2))
    assert (SO(3) * (Euclidean(3) * Sphere(2))).factors == flat.factors
    assert NESTED.factors == (SO(3) * Euclidean(3), Sphere(2))
    assert jax.tree.map(lambda leaf: leaf.shape, NESTED.ambient) == (((3, 3), (3,)), (3,))


def test_homogeneous_factors_are_named_by_their_path():
    point = unflat(NESTED)(draw_point(NESTED, 0)[0])
    found = list(homogeneous_factors(NESTED, point))
    words = ["factor 0, factor 0, SO(3)", "factor 0, factor 1, R^3", "factor 1, Sphere(2)"]
    assert [name for name, _, _ in found] == words
    assert [space for _, space, _ in found] == [SO(3), Euclidean(3), Sphere(2)]
    assert found[0][2] is point[0][0]
    assert list(homogeneous_factors(MANIFOLDS["ellipsoid"], point)) == []


@pytest.mark.parametrize("factors", [(), (Sphere(2), "S2"), (Sphere,)], ids=["none", "a string", "a class"])
def test_a_product_of_other_things_is_refused(factors):
    with pytest.raises(ValueError, match="Product takes one or more manifolds, got"):
        Product(*factors)


@pytest.mark.parametrize("product", [lambda m: m * 3, lambda m: 3 * m, lambda m: m**3], ids=["m 3", "3 m", "m^3"])
def test_a_number_of_copies_is_a_power(product):
    with pytest.raises(InvalidInputError, match=r"got SO\(3\) and 3; try M \* N for two of them, or Power\(M, 3\) for"):
        product(SO(3))


def test_other_forms_of_attitudes_are_answered():
    for form, words in (
        (np.array([0, 0, 0, 1.0]), r'; for a quaternion try retrax\.interop\.from_quaternions\(q, "last"\)'),
        (np.zeros(3), r"; for a rotation vector try scipy's Rotation\.from_rotvec\(v\)\.as_matrix\(\)$"),
        (np.zeros(2), r"has shape \(3, 3\), got \(2,\)$"),
    ):
        assert re.search(words, SO(3).contains(form).reason)
        for role, said in (
            ("a tangent vector", "; for a body rate w try R @ hat(w)"),
            ("a covector", "; for a body momentum m try SO(3).covector(R, m)"),
        ):
            hint = said if form.shape == (3,) else ""
            assert SO(3).describe_mismatch(form, role).endswith(f", got {np.shape(form)}{hint}")


def test_one_rotation_of_a_batch_is_orthogonal():
    one = jax.jit(lambda seeds: jax.vmap(lambda seed: SO(3).random_point(jax.random.key(seed)))(seeds)[0])
    for seed in range(12):
        x = np.asarray(one(np.array([seed])))
        np.testing.assert_allclose(x.T @ x, np.eye(3), atol=1e-14)
