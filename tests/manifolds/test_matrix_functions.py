"""Functions of matrices: values beside SciPy's, and derivatives where eigenvalues repeat."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st
from retrax.manifolds.numerics.matrices import determinant, exponential, lu_factors, spd_log, sym_exp, symmetric

from tests.support.numerics import CENTRAL_NODES, SEEDS, compiled, differences

STEP = 5e-3
FUNCTIONS = {"exp": sym_exp, "log": lambda a: spd_log(a + 4 * jnp.eye(3)), "general exp": exponential}
PEERS = {
    "exp": scipy.linalg.expm,
    "log": lambda a: np.real(scipy.linalg.logm(a + 4 * np.eye(3))),
    "general exp": scipy.linalg.expm,
}


def _kernel(function: Callable) -> Callable:
    def facts(a, d, e, c):
        height = jax.grad(lambda a: jnp.sum(c * function(a)))

        def along(a):
            return jax.jvp(function, (a,), (d,))[1]

        line = STEP * CENTRAL_NODES[:, None, None]
        return {
            "value": function(a),
            "values": jax.vmap(function)(a + line * d),
            "forward": along(a),
            "forwards": jax.vmap(along)(a + line * e),
            "gradient": height(a),
            "forward forward": jax.jvp(along, (a,), (e,))[1],
            "forward reverse": jax.jvp(height, (a,), (d,))[1],
            "reverse reverse": jax.grad(lambda a: jnp.sum(height(a) * d))(a),
        }

    return compiled(facts)


KERNELS = {name: _kernel(function) for name, function in FUNCTIONS.items()}
GAPS = st.one_of(st.just(0.0), st.sampled_from([1e-12, 1e-8, 1e-4]), st.floats(0.0, 1.5))


@pytest.mark.parametrize("name", FUNCTIONS)
@given(seed=SEEDS, gap=GAPS)
@pytest.mark.usual(1)
def test_values_and_two_derivatives_in_every_mode(name, seed, gap):
    # Eigenvalues shift, shift + gap and shift - gap/2: repeated at gap = 0.
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    a = turn @ np.diag(rng.uniform(-1, 1) + gap * np.array([0.0, 1.0, -0.5])) @ turn.T
    d, e, c = map(symmetric, rng.standard_normal((3, 3, 3)) / 3)
    facts = KERNELS[name](a, d, e, c)
    np.testing.assert_allclose(facts["value"], PEERS[name](a), atol=1e-13)
    np.testing.assert_allclose(facts["forward"], differences(facts["values"], STEP), atol=1e-11)
    np.testing.assert_allclose(np.sum(facts["gradient"] * d), np.sum(c * facts["forward"]), atol=1e-13)
    np.testing.assert_allclose(facts["forward forward"], differences(facts["forwards"], STEP), atol=1e-11)
    np.testing.assert_allclose(np.sum(facts["forward reverse"] * e), np.sum(c * facts["forward forward"]), atol=1e-12)
    np.testing.assert_allclose(facts["reverse reverse"], facts["forward reverse"], atol=1e-12)


@given(seed=SEEDS, size=st.floats(1e-3, 300.0))
def test_the_exponential_of_large_matrices(seed, size):
    # A skew matrix, whose exponential is a rotation: each squaring of the approximant may double its error.
    a = np.random.default_rng(seed).standard_normal((3, 3))
    a = size * (a - a.T)
    np.testing.assert_allclose(
        KERNELS["general exp"](a, a, a, a)["value"], scipy.linalg.expm(a), atol=1e-14 * (10 + size)
    )


DETERMINANT = compiled(determinant)


@given(seed=SEEDS, first=st.sampled_from([1.0, 1e-12, 0.0]))
def test_the_determinant_is_that_of_lapack_whichever_rows_are_interchanged(seed, first):
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((4, 4)) + 1j * rng.standard_normal((4, 4))
    a[0, 0], a[1, 1] = first * a[0, 0], first * a[1, 1]
    np.testing.assert_allclose(DETERMINANT(a), np.linalg.det(a), rtol=0, atol=1e-12)


def test_the_determinant_of_a_singular_matrix_is_zero():
    for a in (np.zeros((4, 4)), np.ones((4, 4)), np.diag([0.0, 1.0, 2.0, 3.0])):
        assert DETERMINANT(a.astype(complex)) == 0


FACTORS = compiled(lambda a, d: jax.jvp(lu_factors, (a,), (d,)))


@given(seed=SEEDS)
def test_triangular_factors_stay_triangular_factors_along_a_line(seed):
    a, d = np.random.default_rng(seed).uniform(-1, 1, (2, 4, 4)) + 5 * np.eye(4)
    (lower, upper), (slope, rise) = FACTORS(a, d)
    np.testing.assert_allclose(lower @ upper, a, atol=1e-13)
    np.testing.assert_allclose(slope @ upper + lower @ rise, d, atol=1e-13)
    assert not np.any(np.triu(slope))
    assert not np.any(np.tril(rise, -1))
