"""The Cayley transform of SU(n), n > 2, with the phase that makes its determinant one; square roots in SU(n)."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from retrax.manifolds import SU, DomainError
from retrax.retractions import Cayley, Exponential
from retrax.tape import Tape

from tests.support.numerics import SEEDS, compiled, slope

SIZES = [3, pytest.param(4, marks=pytest.mark.slow), pytest.param(5, marks=pytest.mark.slow)]
LENGTHS = st.one_of(st.floats(0.0, 10.0), st.sampled_from([0.0, 1e-12, 1e-8, 1e-4, 1e2, 1e4]))


@lru_cache
def _cayley(n: int):
    group, retraction = SU(n), Cayley(SU(n))

    def facts(a):
        y, identity = retraction(group.identity, a), group.identity
        return {
            "value": y,
            "back": retraction.preimage(identity, y),
            "inside": retraction.domain(identity, a),
            "pair": retraction.both_ways(identity, a),
            "violations": group.violations(y),
        }

    return compiled(facts)


def drawn(n: int, seed: int, length: float) -> np.ndarray:
    """A random element of the algebra of this Frobenius norm."""
    a = np.tensordot(np.random.default_rng(seed).standard_normal(n * n - 1), SU(n).algebra, 1)
    return length * a / np.linalg.norm(a)


def by_eigenvalues(a: np.ndarray) -> np.ndarray:
    """``R_I(A)`` with the eigenvalues ``i t`` of ``A``: those of the value have the angles ``2 arctan(t/2)`` less their
    mean."""
    t, vectors = np.linalg.eigh(-1j * a)
    angles = 2 * np.arctan(t / 2)
    return (vectors * np.exp(1j * (angles - np.mean(angles)))) @ vectors.conj().T


@pytest.mark.parametrize("n", SIZES)
@given(seed=SEEDS, length=LENGTHS)
def test_the_angles_of_the_cayley_transform_are_less_their_mean(n, seed, length):
    a = drawn(n, seed, length)
    facts = _cayley(n)(a)
    np.testing.assert_allclose(facts["value"], by_eigenvalues(a), rtol=0, atol=1e-15 * (20 + length))
    assert max(facts["violations"].values()) < 5e-15
    assert facts["inside"]
    np.testing.assert_allclose(facts["back"], a, rtol=0, atol=1e-14 * (1 + length**2))


@pytest.mark.parametrize("n", SIZES)
@given(seed=SEEDS, length=LENGTHS)
def test_the_cayley_transform_of_the_negative_is_the_inverse(n, seed, length):
    a = drawn(n, seed, length)
    forwards, backwards = (np.asarray(_cayley(n)(sign * a)["value"]) for sign in (1, -1))
    np.testing.assert_allclose(backwards, forwards.conj().T, rtol=0, atol=1e-15 * (20 + length))
    np.testing.assert_allclose(_cayley(n)(a)["pair"], [forwards.conj().T, forwards], rtol=0, atol=1e-15)


@pytest.mark.parametrize("seed", range(3))
def test_the_cayley_transform_is_of_second_order_and_its_third_is_known(seed):
    """``log R_I(t A) = t A + t^3 (A^3 - tr(A^3)/n I) / 12 + O(t^5)``."""
    group, a = SU(3), drawn(3, seed, 1.0)
    cube = np.asarray(group.algebra_part(a @ a @ a)) / 12
    times = 2.0 ** -np.arange(1, 7)
    log = compiled(lambda a: Exponential(group).preimage(group.identity, Cayley(group)(group.identity, a)))
    errors = [np.linalg.norm(log(t * a) - t * a) for t in times]
    assert abs(slope(times, np.array(errors), 1e-14) - 3) < 0.05
    errors = [np.linalg.norm(log(t * a) - t * a - t**3 * cube) for t in times]
    assert abs(slope(times, np.array(errors), 1e-14) - 5) < 0.1


@lru_cache
def _inverse(n: int):
    return compiled(lambda y: Cayley(SU(n)).preimage(SU(n).identity, y))


@pytest.mark.parametrize("angles", [(2.0, 2.0, -4.0), (2.3, 2.3, -1.0, -3.6), (4.0, 0.5, -2.0, -2.5)], ids=str)
@pytest.mark.usual(1)
def test_the_inverse_reaches_angles_beyond_a_half_turn(angles):
    """All matrices but those with two angles, of the sum 0, a full turn apart have one."""
    n, angles = len(angles), np.array(angles)
    angles = angles - np.mean(angles)
    a = _inverse(n)(np.diag(np.exp(1j * angles)))
    np.testing.assert_allclose(by_eigenvalues(a), np.diag(np.exp(1j * angles)), rtol=0, atol=1e-13)
    np.testing.assert_allclose(np.trace(a), 0, atol=1e-13 * np.max(np.abs(a)))


ROOTS = {"centre of SU(3)": np.exp(2j * np.pi / 3) * np.eye(3), "centre of SU(4)": -np.eye(4, dtype=complex)}


@pytest.mark.usual("centre of SU(3)")
@pytest.mark.parametrize("name", ROOTS)
def test_two_angles_a_full_turn_apart_have_no_inverse(name):
    y = jnp.asarray(ROOTS[name])
    retraction = Cayley(SU(len(y)))
    assert retraction.manifold.contains(y)
    with pytest.raises(DomainError, match="outside the image of GroupCayley"):
        retraction.inverse(retraction.manifold.identity, y)


@compiled
def _frame(seed):
    return SU(3).random_point(jax.random.key(seed))


@compiled
def _root(y):
    return Cayley(SU(3)).square_root(y)


@given(seed=SEEDS)
def test_square_roots_are_in_the_group_or_nan(seed):
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-np.pi, np.pi, 2)
    angles = np.append(angles, -np.sum(angles))
    q = np.asarray(_frame(seed))
    y = (q * np.exp(1j * angles)) @ q.conj().T
    root = np.asarray(_root(y))
    if abs(angles[2]) < np.pi - 1e-3:
        np.testing.assert_allclose(root @ root, y, rtol=0, atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(root), 1, rtol=0, atol=1e-12)
    elif abs(angles[2]) > np.pi + 1e-3:
        assert np.all(np.isnan(root))


def test_the_cayley_transform_of_su4_is_a_tape_with_its_derivatives():
    group, retraction = SU(4), Cayley(SU(4))
    c = np.linspace(-1.0, 1.2, 15)

    def value(c):
        y = retraction(group.identity, group.hat(c))
        return jnp.sum(jnp.arange(16.0) * jnp.cos(jnp.ravel(y.real) + 2 * jnp.ravel(y.imag)))

    tape = Tape.trace(value, c)
    expected = compiled(lambda c: (value(c), jax.grad(value)(c), jax.hessian(value)(c)))(c)
    for found, known in zip((tape, tape.gradient(), tape.hessian()), expected, strict=True):
        np.testing.assert_allclose(found(c[:, None])[..., 0], known, rtol=0, atol=2e-12)
