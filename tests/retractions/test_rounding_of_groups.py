"""The exponential of groups far out, where rounding decides whether a matrix satisfies the group's equations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from retrax.manifolds import SL
from retrax.retractions import Exponential

from tests.support.numerics import compiled

ORIGIN = jnp.eye(3)
EXPONENTIAL = Exponential(SL(3))
LENGTHS = np.linspace(5.0, 30.0, 500)


def direction(seed):
    """A symmetric element of the algebra: there is a logarithm however far it leads."""
    v = SL(3).random_tangent(jax.random.key(seed), ORIGIN)
    return np.asarray(v + v.T) / np.linalg.norm(v + v.T)


def roundings(most):
    """Factors that are a few units in the last place from one."""
    return 1 + np.finfo(float).eps * np.arange(-most, most + 1)


def _defined(v, ways):
    """Whether the exponential is, of each of these multiples."""
    return jax.vmap(lambda way: jnp.all(jnp.isfinite(EXPONENTIAL(ORIGIN, way * v))))(ways)


@compiled
def _claims(vs, ways):
    return jax.vmap(lambda v: (EXPONENTIAL.domain(ORIGIN, v), _defined(v, ways)))(vs)


@compiled
def _inverses(ys, ways):
    vs = jax.vmap(lambda y: EXPONENTIAL.preimage(ORIGIN, y))(ys)
    return vs, jax.vmap(lambda v: _defined(v, ways))(vs)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.usual(1)
def test_the_exponential_is_defined_wherever_its_domain_says_so_however_it_is_rounded(seed):
    claimed, defined = _claims(LENGTHS[:, None, None] * direction(seed), roundings(16))
    defined = defined.all(axis=1)
    assert claimed[0]
    assert not defined.all()
    np.testing.assert_array_equal(defined | ~claimed, True)
    assert LENGTHS[claimed][-1] > 0.6 * LENGTHS[~defined][0]  # not much is given away


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.slow
def test_where_there_is_a_logarithm_the_exponential_leads_back(seed):
    ys = np.stack([scipy.linalg.expm(length * direction(seed)) for length in LENGTHS])
    logarithms, defined = _inverses(ys, roundings(4))
    found = np.isfinite(logarithms).all(axis=(1, 2))
    assert found[0]
    assert not found.all()
    np.testing.assert_array_equal(defined.any(axis=1) | ~found, True)
    expected = LENGTHS[:, None, None] * direction(seed)
    np.testing.assert_allclose(logarithms[found], expected[found], atol=1e-5)
