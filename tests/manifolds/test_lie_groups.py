"""Matrix Lie groups: algebra, adjoint action, trivialisations, momenta, left-invariant metrics."""

import re
from functools import lru_cache
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.manifolds import (
    SE,
    SL,
    SO,
    SU,
    Euclidean,
    InvalidInputError,
    LeftInvariantMetric,
    MatrixLieGroup,
    U,
    hat,
    vee,
)
from retrax.manifolds.groups.lie_algebra import lie_algebra
from retrax.manifolds.numerics import ambient as vec

from tests.support.cases import MANIFOLDS, Heisenberg
from tests.support.numerics import CENTRAL_NODES, SEEDS, compiled, differences, draw_point, unflat

GROUPS = ["SO3", "SE3", "SU2", "SL2", "heisenberg"]
STEP = 2e-3

every_group = pytest.mark.parametrize("name", GROUPS)


@final
class Given(MatrixLieGroup):
    """A group by any basis."""

    matrices: tuple

    @property
    def algebra(self) -> np.ndarray:
        return np.array(self.matrices)


def by_algebra(group: MatrixLieGroup) -> Given:
    """The same group, known by its algebra alone."""
    return Given(tuple(tuple(map(tuple, a)) for a in group.algebra.tolist()))


@lru_cache
def _kernel(name: str):
    group, unravel = MANIFOLDS[name], unflat(MANIFOLDS[name])
    metric = LeftInvariantMetric(group, jnp.eye(group.dimension) + 0.1)

    def facts(x, y, v, p, coordinates):
        x, y, v, p = map(unravel, (x, y, v, p))
        a, b, c, mu = coordinates
        curve = jax.vmap(lambda s: group.Ad(jax.scipy.linalg.expm(s * group.hat(a))) @ b)(STEP * CENTRAL_NODES)
        q, w = group.compose(y, x), group.compose(y, v)
        pushed = group.covector(q, group.body(x, p))
        return {
            "Ad": {"x": group.Ad(x), "y": group.Ad(y), "xy": group.Ad(group.compose(x, y)), "curve": curve},
            "ad": {"a": group.ad(a), "b": group.ad(b)},
            "Jacobi": group.ad(group.ad(a) @ b) - group.ad(a) @ group.ad(b) + group.ad(b) @ group.ad(a),
            "commutator": group.hat(group.ad(a) @ b) - (group.hat(a) @ group.hat(b) - group.hat(b) @ group.hat(a)),
            "conjugate": group.hat(group.Ad(x) @ a) - x @ group.hat(a) @ group.inverse(x),
            "inverse": group.compose(group.inverse(x), x) - group.identity,
            "vee": group.vee(group.hat(c)),
            "trivialised": x @ group.left_trivialise(x, v) - v,
            "body": group.body(x, p),
            "spatial": group.spatial(x, p),
            "paired": vec.pairing(p, x @ group.hat(c)),
            "mu": group.body(x, group.covector(x, mu)),
            "covector": group.covector(x, group.body(x, p)) - group.projection(x, p),
            "lengths": (metric.inner_product(x, v, v), metric.inner_product(q, w, w)),
            "energies": (metric.kinetic_energy(x, p), metric.kinetic_energy(q, pushed)),
            "of momentum": metric.kinetic_energy(x, metric.covector(x, v)),
        }

    return compiled(facts)


def facts_at(name: str, seed: int) -> dict:
    """Facts of a group at two random points, for random vectors of the tangent space and coordinates."""
    group, rng = MANIFOLDS[name], np.random.default_rng(seed)
    (x, v, _), (y, _, _) = draw_point(group, seed), draw_point(group, seed + 1)
    coordinates = rng.standard_normal((4, group.dimension))
    p = rng.standard_normal(x.size)
    return {"coordinates": coordinates, **_kernel(name)(x, y, v, p, coordinates)}


@every_group
@given(seed=SEEDS)
@pytest.mark.usual(1)
def test_ad_is_the_derivative_of_the_homomorphism_Ad(name, seed):
    facts = facts_at(name, seed)
    big, (_, b, _, _) = facts["Ad"], facts["coordinates"]
    np.testing.assert_allclose(big["xy"], big["x"] @ big["y"], atol=1e-12)
    np.testing.assert_allclose(facts["conjugate"], 0, atol=1e-13)
    np.testing.assert_allclose(differences(big["curve"], STEP), facts["ad"]["a"] @ b, atol=1e-8)


@every_group
@given(seed=SEEDS)
def test_the_algebra_satisfies_the_identities_of_its_bracket(name, seed):
    facts = facts_at(name, seed)
    a, b, _, _ = facts["coordinates"]
    np.testing.assert_allclose(facts["ad"]["a"] @ b, -facts["ad"]["b"] @ a, atol=1e-13)
    np.testing.assert_allclose(facts["commutator"], 0, atol=1e-13)
    np.testing.assert_allclose(facts["Jacobi"], 0, atol=1e-12)


@every_group
@given(seed=SEEDS)
def test_inverse_trivialisation_and_coordinates(name, seed):
    facts = facts_at(name, seed)
    for zero in ("inverse", "trivialised"):
        np.testing.assert_allclose(facts[zero], 0, atol=2e-13)
    np.testing.assert_allclose(facts["vee"], facts["coordinates"][2], atol=1e-14)


@every_group
@given(seed=SEEDS)
def test_the_spatial_covector_is_the_body_covector_moved_by_the_coadjoint_action(name, seed):
    facts = facts_at(name, seed)
    np.testing.assert_allclose(facts["Ad"]["x"].T @ facts["spatial"], facts["body"], atol=1e-12)
    np.testing.assert_allclose(facts["paired"], facts["body"] @ facts["coordinates"][2], atol=1e-12)


@every_group
@given(seed=SEEDS)
def test_covectors_are_known_by_their_body_covectors(name, seed):
    facts = facts_at(name, seed)
    np.testing.assert_allclose(facts["mu"], facts["coordinates"][3], atol=1e-12)
    np.testing.assert_allclose(facts["covector"], 0, atol=1e-12)


@every_group
@given(seed=SEEDS)
def test_a_left_invariant_metric_is_one_and_its_energies_belong_together(name, seed):
    facts = facts_at(name, seed)
    np.testing.assert_allclose(*facts["lengths"], rtol=1e-11)
    np.testing.assert_allclose(*facts["energies"], rtol=1e-11)
    np.testing.assert_allclose(facts["of momentum"], facts["lengths"][0] / 2, rtol=1e-11)


@pytest.mark.parametrize(
    ("group", "fast", "cubes"),
    [
        (SO(4), True, True),
        (SE(3), True, True),
        (U(3), True, True),
        (SU(2), True, True),
        (SU(3), True, False),
        (SL(2), False, True),
        (SL(3), False, False),
        (Heisenberg(), False, True),
    ],
    ids=str,
)
def test_what_is_read_off_the_algebra(group, fast, cubes):
    assert group.lie_algebra.acts_unitarily == fast
    assert group.lie_algebra.closed_under_cubes == cubes
    rows = group.lie_algebra.orthonormal.reshape(group.dimension, -1)
    np.testing.assert_allclose((rows.conj() @ rows.T).real, np.eye(group.dimension), atol=1e-15)


def test_coordinates_of_twists_are_angular_then_linear():
    twist = jnp.array([0.1, -0.2, 0.3, 1.0, 2.0, -3.0])
    expected = np.zeros((4, 4))
    expected[:3, :3], expected[:3, 3] = hat(twist[:3]), twist[3:]
    np.testing.assert_array_equal(SE(3).hat(twist), expected)
    np.testing.assert_array_equal(SE(2).hat(jnp.array([0.5, 1.0, 2.0])), [[0, -0.5, 1], [0.5, 0, 2], [0, 0, 0]])
    np.testing.assert_array_equal(SO(3).hat(twist[:3]), hat(twist[:3]))
    np.testing.assert_allclose(SO(3).vee(SO(3).hat(twist[:3])), vee(hat(twist[:3])), atol=1e-16)


def test_the_adjoint_of_a_motion_is_the_published_matrix():
    # [Lynch, Park 2017, (3.20)]: [Ad_T] = [[R, 0], [hat(p) R, R]] on twists (omega, v).
    x = SE(3).random_point(jax.random.key(3))
    rotation, p = SE(3).parts(x)
    expected = np.block([[np.asarray(rotation), np.zeros((3, 3))], [hat(p) @ rotation, np.asarray(rotation)]])
    np.testing.assert_allclose(SE(3).Ad(x), expected, atol=1e-14)


def test_the_gell_mann_basis_is_the_published_one():
    # Structure constants f_123 = 1, f_147 = 1/2, f_458 = sqrt(3)/2 in [lambda_a/2, lambda_b/2] = i f_abc lambda_c/2.
    ad, small = (compiled(jax.vmap(group.ad))(np.eye(group.dimension)) for group in (SU(3), SU(2)))
    np.testing.assert_allclose([ad[0, 2, 1], ad[0, 6, 3], ad[3, 7, 4]], [1, 0.5, np.sqrt(3) / 2], atol=1e-15)
    np.testing.assert_allclose(small, np.stack([hat(e) for e in jnp.eye(3)]), atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("group", [SE(2), SU(2)], ids=str)
def test_a_group_known_by_its_algebra_alone_is_the_same_set(group):
    twin, x = by_algebra(group), group.random_point(jax.random.key(1))
    assert twin.contains(x, 1e-13)
    assert group.contains(twin.random_point(jax.random.key(2)), 1e-13)
    near = x + 1e-4 * vec.normal(jax.random.key(3), group.ambient)
    assert not twin.contains(near)
    assert group.contains(twin.restore(near), 1e-6)


def test_outsiders_are_not_in_the_group():
    assert not SO(3).contains(-jnp.eye(3))
    assert not SU(2).contains(1j * jnp.eye(2))
    assert not SE(2).contains(jnp.eye(3).at[2, 0].set(1e-3))
    assert not SL(2).contains(1.01 * jnp.eye(2))
    assert U(2).contains(1j * jnp.eye(2))


UNIT = np.eye(4).reshape(4, 2, 2)
WRONG = {
    "no shape": (UNIT[0], r"has shape \(d, n, n\) with d > 0, got \(2, 2\)"),
    "not square": (UNIT[:, :, :1], "has shape"),
    "none": (np.zeros((0, 2, 2)), "with d > 0"),
    "dependent": (UNIT[[1, 1]], "must be independent"),
    "not closed": (UNIT[[1, 2]], "holds the commutators"),
    "NaN": (UNIT * np.nan, "NaN or infinite"),
}


@pytest.mark.parametrize("kind", WRONG)
def test_a_wrong_algebra_is_refused(kind):
    matrices, words = WRONG[kind]
    with pytest.raises(InvalidInputError, match=words):
        Given(tuple(matrices.tolist()))


def test_a_group_that_needs_equations_says_so():
    # Scalings and one shear: the same tensors of low degree are fixed by a larger group.
    with pytest.raises(InvalidInputError, match=r"write equations\(x\), zero on the group"):
        Given(tuple(np.array([UNIT[0] + 2 * UNIT[3]]).tolist()))


INERTIAS = {
    "shape": (jnp.ones(2), r"has shape \(3,\) or \(3, 3\), got \(2,\)"),
    "sign": (jnp.array([1.0, -1.0, 2.0]), "symmetric and positive definite"),
    "symmetry": (jnp.eye(3).at[0, 1].set(0.5), "symmetric and positive definite"),
    "NaN": (jnp.full(3, jnp.nan), "positive definite"),
}


@pytest.mark.parametrize("kind", INERTIAS)
def test_a_wrong_inertia_is_refused(kind):
    inertia, words = INERTIAS[kind]
    with pytest.raises(InvalidInputError, match=words):
        LeftInvariantMetric(SO(3), inertia)


def test_a_left_invariant_metric_of_no_group_is_refused():
    with pytest.raises(InvalidInputError, match=r"takes a MatrixLieGroup, got .*try SO\(3\)"):
        LeftInvariantMetric(Euclidean(3), jnp.ones(3))


def test_hat_and_vee_take_whole_numbers_lists_and_leading_axes_and_refuse_other_shapes():
    np.testing.assert_array_equal(vee(hat([1, 2, 3])), [1, 2, 3])
    batch = jnp.arange(6.0).reshape(2, 3)
    np.testing.assert_array_equal(vee(hat(batch)), batch)
    np.testing.assert_array_equal(hat(batch)[1], hat(batch[1]))
    with pytest.raises(TypeError, match=r"hat takes an array whose last axes are \(3,\), got one of shape \(4,\)"):
        hat(jnp.zeros(4))
    with pytest.raises(TypeError, match=r"vee takes an array whose last axes are \(3, 3\)"):
        vee(jnp.zeros((2, 2)))


@pytest.mark.parametrize("wrong", range(6))
def test_a_wrong_sign_in_a_basis_is_told_by_the_pair_whose_commutator_is_missing(wrong):
    """Each matrix of the motions of space in turn with the sign of one entry changed."""
    basis = np.array(SE(3).algebra)
    row, column = np.argwhere(basis[wrong])[0]
    basis[wrong, row, column] *= -1
    if np.count_nonzero(basis[wrong]) == 1:  # a translation, which spans the same
        lie_algebra(basis)
        return
    with pytest.raises(InvalidInputError, match=r"span that of A = basis\[\d\] and B = basis\[\d\]; check") as info:
        lie_algebra(basis)
    i, j = map(int, re.findall(r"basis\[(\d)\]", str(info.value)))
    missing = basis[i] @ basis[j] - basis[j] @ basis[i]
    assert np.linalg.matrix_rank(np.vstack([basis.reshape(6, -1), missing.ravel()])) == 7
