"""Frames, subspaces, unit columns and matrices of one rank: their tangent spaces, and the factorisations below them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from retrax.manifolds import FixedRank, Grassmann, InvalidInputError, Oblique, Sphere, Stiefel
from retrax.manifolds.numerics import frames, matrices

from tests.support.numerics import CENTRAL_NODES, SEEDS, compiled, differences, draw_point, norm

STEP = 2e-3


def orthogonal(rng: np.random.Generator, n: int) -> np.ndarray:
    """A random orthogonal matrix."""
    return np.linalg.qr(rng.standard_normal((n, n)))[0]


@given(seed=SEEDS)
def test_one_column_is_a_point_of_the_sphere(seed):
    x, v, basis = draw_point(Stiefel(3, 1), seed)
    _, _, expected = draw_point(Sphere(2), seed)
    assert Sphere(2).contains(x, 1e-14)
    assert Sphere(2).is_tangent(x, v, 1e-14)
    assert basis.shape == expected.shape


@given(seed=SEEDS)
def test_tangent_vectors_of_a_frame_are_those_with_a_skew_pairing(seed):
    x, v, _ = draw_point(Stiefel(4, 2), seed)
    pairing = x.reshape(4, 2).T @ v.reshape(4, 2)
    np.testing.assert_allclose(pairing, -pairing.T, atol=1e-14)


@given(seed=SEEDS)
def test_tangent_vectors_of_a_projector_are_those_of_its_frames(seed):
    # x = q q' moves by w q' + q w' where q moves by w.
    rng = np.random.default_rng(seed)
    q, w = orthogonal(rng, 4)[:, :2], rng.standard_normal((4, 2))
    v = (w - q @ q.T @ w) @ q.T
    assert Grassmann(4, 2).contains(q @ q.T, 1e-14)
    assert Grassmann(4, 2).is_tangent(q @ q.T, v + v.T, 1e-14)


@given(seed=SEEDS)
def test_tangent_vectors_of_a_product_of_factors_are_its_derivatives(seed):
    rng = np.random.default_rng(seed)
    left, right, dl, dr = (rng.uniform(0.5, 1.5, (k, 2)) for k in (4, 3, 4, 3))
    right[0] += 2  # away from proportional columns
    assert FixedRank(4, 3, 2).is_tangent(left @ right.T, dl @ right.T + left @ dr.T, 1e-9)


def test_points_of_too_low_a_rank_are_none():
    manifold = FixedRank(3, 3, 2)
    assert "singular values that vanish among the first 2 is 1" in manifold.contains(np.diag([1.0, 0.0, 0.0])).reason
    assert "singular value 3 over the first is 0.5" in manifold.contains(np.diag([2.0, 1.5, 1.0])).reason


def test_a_projector_of_another_rank_is_none():
    assert "|tr x - 2|" in Grassmann(4, 2).contains(np.diag([1.0, 0.0, 0.0, 0.0])).reason
    assert "max |x^2 - x|" in Grassmann(2, 1).contains(np.diag([0.5, 0.5])).reason
    assert "max |x - x'|" in Grassmann(2, 1).contains(np.array([[1.0, 0.5], [0.0, 0.0]])).reason


MOMENTUM = {sizes: compiled(Stiefel(*sizes).momentum) for sizes in ((4, 2), (3, 3))}


@pytest.mark.parametrize("sizes", MOMENTUM)
@given(seed=SEEDS)
def test_momentum_of_a_frame_is_the_skew_matrix_of_its_moments(sizes, seed):
    x, p, _ = draw_point(Stiefel(*sizes), seed)
    x, p = x.reshape(sizes), p.reshape(sizes)
    moment = p @ x.T - x @ p.T
    # J_i = <p, e_i x> = <p x', e_i>, each e_i with two entries.
    assert np.linalg.norm(MOMENTUM[sizes](x, p)) == pytest.approx(np.linalg.norm(moment) / np.sqrt(2))


@pytest.mark.parametrize(
    ("make", "sizes", "words"),
    [
        (Stiefel, (2, 3), r"1 <= p <= n; got n = 2, p = 3"),
        (Stiefel, (3, 0), r"1 <= p <= n; got n = 3, p = 0"),
        (Stiefel, (3.0, 2), r"whole numbers 1 <= p <= n; got n = 3.0, p = 2; try Stiefel\(3, 2\)"),
        (Grassmann, (3, 3), r"1 <= p < n; got n = 3, p = 3"),
        (Grassmann, (3, 0), r"1 <= p < n; got n = 3, p = 0"),
        (Grassmann, (3, True), r"whole numbers 1 <= p < n; got n = 3, p = True; try Grassmann\(3, 1\)"),
        (Oblique, (1, 4), r"n >= 2 and m >= 1; got n = 1, m = 4"),
        (Oblique, (3, 0), r"n >= 2 and m >= 1; got n = 3, m = 0"),
        (Oblique, (3, "2"), r"whole numbers n >= 2 and m >= 1; got n = 3, m = '2'; try Oblique\(3, 2\)"),
        (FixedRank, (4, 3, 3), r"1 <= r < min\(m, n\); got .*r = 3\. .*try Euclidean\(\(m, n\)\)"),
        (FixedRank, (4, 3, 0), r"1 <= r < min\(m, n\); got m = 4, n = 3, r = 0"),
        (FixedRank, (4, 3, 1.5), r"whole numbers 1 <= r < min\(m, n\); got m = 4, n = 3, r = 1.5"),
    ],
)
def test_sizes_that_make_no_manifold_are_refused(make, sizes, words):
    with pytest.raises(InvalidInputError, match=words):
        make(*sizes)


COMPLEMENT = compiled(frames.complement)


@given(seed=SEEDS, signs=st.sampled_from([None, 1.0, -1.0]))
def test_the_complement_completes_a_frame_to_an_orthogonal_matrix(seed, signs):
    rng = np.random.default_rng(seed)
    # Columns of the identity, in any order and with either sign, are where reflections could break down.
    q = orthogonal(rng, 6) if signs is None else signs * np.eye(6)[:, rng.permutation(6)]
    whole = np.concatenate([q[:, :4], COMPLEMENT(q[:, :4])], axis=1)
    np.testing.assert_allclose(whole.T @ whole, np.eye(6), atol=5e-15)


@compiled
def _factors(a, c):
    return matrices.symmetric_factor(a, c), matrices.triangular_factor(a, c)


@given(seed=SEEDS, imaginary=st.booleans())
def test_factors_solve_their_equations(seed, imaginary):
    rng = np.random.default_rng(seed)
    a, c = rng.standard_normal((2, 3, 3)) + 1j * imaginary * rng.standard_normal((2, 3, 3))
    a, c = (np.eye(3) + 0.2 * a, c + c.conj().T) if imaginary else (np.eye(3) + 0.2 * a.real, c.real + c.real.T)
    symmetric, triangular = _factors(a, c)
    for t in (symmetric, triangular):
        np.testing.assert_allclose(a @ t + (a @ t).conj().T, c, atol=1e-12)
    np.testing.assert_array_equal(symmetric, symmetric.conj().T)
    np.testing.assert_array_equal(triangular, np.triu(triangular))
    np.testing.assert_array_equal(np.diag(triangular).imag, 0)


@given(seed=SEEDS, imaginary=st.booleans())
def test_the_qr_factor_has_a_positive_triangular_factor(seed, imaginary):
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((4, 3)) + (1j * rng.standard_normal((4, 3)) if imaginary else 0)
    q = QR(a)
    r = q.conj().T @ a
    np.testing.assert_allclose(q.conj().T @ q, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(np.tril(r, -1), 0, atol=1e-14)
    np.testing.assert_allclose(np.diag(r).imag, 0, atol=1e-14)
    assert np.all(np.diag(r).real > 0)


QR = compiled(frames.qr_factor)


def _derivatives(function):
    """A function's value and its derivatives along a line, of orders one and two, the second in two modes."""

    def facts(a, d):
        def along(s):
            return function(a + s * d)

        def slope(s):
            return jax.jvp(along, (s,), (1.0,))[1]

        def height(s):
            return jnp.sum(jnp.cos(jnp.arange(d.size)) * jnp.ravel(along(s))[: d.size])

        return {
            "value": along(0.0),
            "slope": slope(0.0),
            "slopes": jax.vmap(slope)(STEP * CENTRAL_NODES),
            "values": jax.vmap(along)(STEP * CENTRAL_NODES),
            "second": jax.jvp(slope, (0.0,), (1.0,))[1],
            "forward reverse": jax.jvp(jax.grad(height), (0.0,), (1.0,))[1],
            "reverse reverse": jax.grad(jax.grad(height))(0.0),
            "height": jnp.sum(jnp.cos(jnp.arange(d.size)) * jnp.ravel(jax.jvp(slope, (0.0,), (1.0,))[1])[: d.size]),
        }

    return compiled(facts)


POLAR = _derivatives(frames.polar_factor)
LEADING = _derivatives(lambda a: frames.leading_projector(a, 2))


@pytest.mark.parametrize("kernel", [POLAR, LEADING], ids=["polar factor", "leading projector"])
@given(seed=SEEDS, repeated=st.booleans())
@example(seed=0, repeated=True)
def test_singular_value_functions_have_their_derivatives_where_singular_values_repeat(kernel, seed, repeated):
    rng = np.random.default_rng(seed)
    singular = [1.0, 1.0, 0.3] if repeated else [2.0, 1.0, 0.3]
    a = orthogonal(rng, 4)[:, :3] @ np.diag(singular) @ orthogonal(rng, 3)
    d = rng.standard_normal((4, 3))
    facts = kernel(a, d / np.linalg.norm(d))
    np.testing.assert_allclose(facts["slope"], differences(facts["values"], STEP), atol=1e-7)
    np.testing.assert_allclose(facts["second"], differences(facts["slopes"], STEP), atol=1e-6)
    np.testing.assert_allclose(facts["forward reverse"], facts["height"], atol=1e-10)
    np.testing.assert_allclose(facts["reverse reverse"], facts["height"], atol=1e-10)


@given(seed=SEEDS)
def test_the_polar_factor_is_that_of_the_singular_value_decomposition_also_for_large_matrices(seed):
    rng = np.random.default_rng(seed)
    a = orthogonal(rng, 4)[:, :3] @ np.diag([1e8, 1e4, 1.0]) @ orthogonal(rng, 3)
    y = POLAR(a, a)["value"]
    np.testing.assert_allclose(y.T @ y, np.eye(3), atol=5e-15)
    assert norm(y.T @ a - a.T @ y) < 1e-6
    assert np.linalg.eigvalsh(y.T @ a)[0] > 0.5


C = np.diag([1.0, 2.0, 3.0]) + 0.5
SYMMETRIC = _derivatives(lambda a: matrices.symmetric_factor(a, C))
TRIANGULAR = _derivatives(lambda a: matrices.triangular_factor(a, C))


@pytest.mark.parametrize("kernel", [SYMMETRIC, TRIANGULAR], ids=["symmetric", "triangular"])
@given(seed=SEEDS)
@pytest.mark.usual(1)
def test_factors_have_their_derivatives(kernel, seed):
    rng = np.random.default_rng(seed)
    a, d = np.eye(3) + 0.2 * rng.standard_normal((3, 3)), rng.standard_normal((3, 3))
    facts = kernel(a, 0.2 * d / np.linalg.norm(d))
    np.testing.assert_allclose(facts["slope"], differences(facts["values"], STEP), atol=1e-8)
    np.testing.assert_allclose(facts["second"], differences(facts["slopes"], STEP), atol=1e-8)
    np.testing.assert_allclose(facts["forward reverse"], facts["height"], atol=1e-10)
    np.testing.assert_allclose(facts["reverse reverse"], facts["height"], atol=1e-10)


def test_no_symmetric_factor_is_given_where_an_eigenvalue_is_negative():
    assert np.all(np.isnan(matrices.symmetric_factor(jnp.diag(jnp.array([1.0, -2.0])), jnp.eye(2))))
