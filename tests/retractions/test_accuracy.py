"""Accuracy of inverses from tiny tangent vectors to the edge of the domain."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from retrax.manifolds import SPD, DomainError, Hyperbolic, Simplex
from retrax.retractions import Exponential, Projection, SPDSecondOrder

from tests.support.numerics import SEEDS, compiled

HYPERBOLIC, CONE, SIMPLEX = Hyperbolic(3), SPD(3), Simplex(3)
APEX = jnp.array([1.0, 0.0, 0.0, 0.0])
LENGTHS = st.one_of(st.sampled_from([1e-12, 1e-9, 1e-4]), st.floats(1e-3, 300.0))
EDGES = st.one_of(st.sampled_from([1e-12, 1e-6, 1 - 1e-8]), st.floats(1e-3, 1 - 1e-8))


@lru_cache
def _hyperbolic(family):
    retraction = family(HYPERBOLIC)

    def facts(x, u):
        v = HYPERBOLIC.from_apex(x, u)
        y = retraction(x, v)
        back = HYPERBOLIC.at_apex(x, retraction.inverse(x, y))
        return {"inside": retraction.domain(x, v), "back": back, "y": y, "distance": HYPERBOLIC.distance(x, y)}

    return compiled(facts)


def vector(seed: int, size: int, length: float) -> np.ndarray:
    """A random vector of this length."""
    u = np.random.default_rng(seed).standard_normal(size)
    return length * u / np.linalg.norm(u)


@given(seed=SEEDS, length=LENGTHS)
def test_the_hyperbolic_logarithm_keeps_every_digit_at_the_apex(seed, length):
    u = vector(seed, 3, length)
    facts = _hyperbolic(Exponential)(APEX, u)
    assert facts["inside"]
    assert HYPERBOLIC.contains(facts["y"], 1e-15)
    np.testing.assert_allclose(facts["back"], u, rtol=0, atol=1e-15 * length)
    np.testing.assert_allclose(facts["distance"], length, rtol=1e-15)


@given(seed=SEEDS, length=LENGTHS, far=st.floats(0.0, 3.0))
def test_the_hyperbolic_logarithm_is_as_exact_as_its_points(seed, length, far):
    # A point at this distance from the apex is known to 1e-16 cosh(far), and to its square where it decides <x, x>_L.
    x = HYPERBOLIC.restore(jnp.concatenate([jnp.ones(1), np.sinh(far) * vector(seed + 1, 3, 1.0)]))
    u = vector(seed, 3, length)
    facts = _hyperbolic(Exponential)(x, u)
    np.testing.assert_allclose(facts["back"], u, rtol=0, atol=2e-15 * np.cosh(far) ** 2 * (1 + length))


@given(seed=SEEDS, length=EDGES, far=st.floats(0.0, 1.0))
def test_the_central_projection_is_inverted_up_to_its_edge(seed, length, far):
    x = HYPERBOLIC.restore(jnp.concatenate([jnp.ones(1), np.sinh(far) * vector(seed + 1, 3, 1.0)]))
    u = vector(seed, 3, length)
    facts = _hyperbolic(Projection)(x, u)
    assert facts["inside"]
    assert HYPERBOLIC.contains(facts["y"], 1e-15)
    np.testing.assert_allclose(facts["back"], u, rtol=0, atol=1e-14)


def test_the_central_projection_ends_at_length_one():
    assert not _hyperbolic(Projection)(APEX, np.array([1.0, 0.0, 0.0]))["inside"]
    assert not _hyperbolic(Exponential)(APEX, np.array([500.0, 0.0, 0.0]))["inside"]


@lru_cache
def _cone(make):
    retraction = make(CONE)

    def facts(x, v):
        y = retraction(x, v)
        return {"inside": retraction.domain(x, v), "back": retraction.inverse(x, y), "y": y}

    return compiled(facts)


@pytest.mark.parametrize("make", [Exponential, SPDSecondOrder], ids=["exponential", "second order"])
@given(
    seed=SEEDS,
    length=st.one_of(st.sampled_from([0.0, 1e-12, 1e-6]), st.floats(0.0, 0.99)),
    spread=st.floats(1.0, 100.0),
)
def test_inverses_on_the_cone_are_as_exact_as_the_condition_of_the_point(make, seed, length, spread):
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    x = (turn * np.array([1.0, spread**0.5, spread])) @ turn.T
    factor, m = np.linalg.cholesky(x), rng.standard_normal((3, 3))
    m = length * (m + m.T) / np.linalg.norm(m + m.T, 2)
    v = factor @ m @ factor.T
    facts = _cone(make)(x, v)
    assert facts["inside"]
    assert CONE.contains(facts["y"], 1e-13)
    np.testing.assert_allclose(facts["back"], v, rtol=0, atol=1e-14 * spread / (1 - length))


def test_the_fold_of_the_second_order_retraction_is_an_edge_without_nan():
    x = jnp.eye(3)
    for depth in (1e-4, 1e-8, 0.0):
        v = -(1 - depth) * x
        np.testing.assert_allclose(_cone(SPDSecondOrder)(x, v)["back"], v, rtol=0, atol=1e-7)
    assert not _cone(SPDSecondOrder)(x, -1.1 * x)["inside"]
    with pytest.raises(DomainError):
        SPDSecondOrder(CONE).inverse(x, 0.4 * x)


@lru_cache
def _simplex():
    retraction = Exponential(SIMPLEX)

    def facts(x, v):
        y = retraction(x, v)
        return {"inside": retraction.domain(x, v), "back": retraction.inverse(x, y), "y": y}

    return compiled(facts)


@given(
    seed=SEEDS, length=st.one_of(st.sampled_from([1e-12, 1e-6]), st.floats(0.0, 300.0)), smallest=st.floats(1e-8, 0.2)
)
def test_inverses_on_the_simplex_up_to_its_corners(seed, length, smallest):
    # In units of x, entry by entry: entries of v/x up to 300 make values down to e^-600.
    x = np.array([smallest, 0.3, 0.2, 0.5 - smallest])
    relative = np.random.default_rng(seed).standard_normal(4)
    relative -= x @ relative
    relative *= length / np.max(np.abs(relative))
    facts = _simplex()(x, x * relative)
    assert facts["inside"]
    assert np.all(facts["y"] > 0)
    np.testing.assert_allclose(facts["back"], x * relative, rtol=0, atol=1e-15 * (1 + length))


def test_the_retraction_of_the_simplex_ends_where_an_entry_underflows():
    x = np.full(4, 0.25)
    facts = _simplex()(x, 400.0 * np.array([1.0, -1.0, 0.0, 0.0]))
    assert not facts["inside"]


def test_the_inverse_on_the_simplex_keeps_its_digits_to_the_last_number_that_has_them():
    # Entries below 2e-308 lose theirs; the domain ends before.
    x, direction, inside = np.full(4, 0.25), np.array([1.0, -1.0, 0.0, 0.0]), []
    for length in np.linspace(87.5, 90.0, 101):
        facts = _simplex()(x, length * direction)
        inside.append(bool(facts["inside"]))
        if facts["inside"]:
            np.testing.assert_allclose(facts["back"], length * direction, rtol=1e-15)
    assert inside[0]
    assert inside == sorted(inside, reverse=True)
    assert not inside[-1]


def test_distances_follow_the_triangle_through_the_apex():
    x, y = (HYPERBOLIC.restore(jnp.array([1.0, s, 0.0, 0.0])) for s in (np.sinh(2.0), -np.sinh(5.0)))
    np.testing.assert_allclose(HYPERBOLIC.distance(x, y), 7.0, rtol=1e-14)


@lru_cache
def _distance_along():
    """Derivatives of the distance of a geodesic's points from its start, and those at the start itself."""
    move, distance = Exponential(HYPERBOLIC), HYPERBOLIC.distance

    def facts(x, u, length):
        def travelled(t):
            return distance(x, move(x, HYPERBOLIC.from_apex(x, t * u)))

        return jax.grad(travelled)(length), jax.jvp(travelled, (length,), (1.0,))[1], jax.grad(distance, (0, 1))(x, x)

    return compiled(facts)


@given(seed=SEEDS, length=st.one_of(st.sampled_from([1e-12, 1e-6]), st.floats(1e-3, 10.0)))
def test_the_distance_grows_at_unit_rate_and_has_a_subgradient_at_zero(seed, length):
    forward, reverse, at_start = _distance_along()(APEX, vector(seed, 3, 1.0), length)
    np.testing.assert_allclose((forward, reverse), 1.0, rtol=1e-14)
    np.testing.assert_array_equal(at_start, 0.0)


def test_the_inverse_at_the_fold_of_definite_matrices_is_a_number_beside_large_eigenvalues():
    """Rounding of a point of size 1e13 puts an eigenvalue that is zero 1e-3 below it."""
    retraction = SPDSecondOrder(CONE)
    for seed in range(20):
        q = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
        v = q @ np.diag([1e-6 - 1, 0.0, 1e7]) @ q.T
        back = retraction.preimage(np.eye(3), retraction(np.eye(3), v))
        np.testing.assert_allclose(back, v, rtol=0, atol=1e-7 * 1e7)
