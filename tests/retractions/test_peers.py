"""Values of retractions and their inverses beside those of geomstats and pymanopt, which are imported in the tests."""

import jax
import numpy as np
import pytest
from retrax.manifolds import SPD, Hyperbolic, Manifold, Simplex, Sphere
from retrax.retractions import Exponential, SPDLogEuclidean, SPDSecondOrder

from tests.support.numerics import compiled

KEYS = jax.random.split(jax.random.key(7), 5)


def draws(manifold: Manifold, length: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Five points with a tangent vector at each, and five other points."""

    @compiled
    def drawn(keys):
        x = jax.vmap(manifold.random_point)(keys)
        return x, jax.vmap(manifold.projection)(x, jax.random.normal(keys[0], x.shape))

    x, v = drawn(KEYS)
    return x, length * v, x[::-1]


@pytest.fixture
def geometry():
    """geomstats, whose import warns of a deprecated importer."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import geomstats.geometry.hyperboloid
        import geomstats.geometry.spd_matrices
    return geomstats.geometry


@pytest.mark.parametrize("make", [Exponential, SPDLogEuclidean], ids=["affine", "log-Euclidean"])
def test_exponentials_of_the_cone_are_those_of_geomstats(make, geometry):
    spd = geometry.spd_matrices
    space = spd.SPDMatrices(3, equip=False)
    space.equip_with_metric(spd.SPDAffineMetric if make is Exponential else spd.SPDLogEuclideanMetric)
    retraction, (x, v, y) = make(SPD(3)), draws(SPD(3), 0.5)
    np.testing.assert_allclose(jax.jit(jax.vmap(retraction))(x, v), space.metric.exp(v, x), atol=1e-11)
    np.testing.assert_allclose(jax.jit(jax.vmap(retraction.inverse))(x, y), space.metric.log(y, x), atol=1e-11)


def test_the_exponential_of_hyperbolic_space_is_that_of_geomstats(geometry):
    space = geometry.hyperboloid.Hyperboloid(2)
    retraction, (x, v, y) = Exponential(Hyperbolic(2)), draws(Hyperbolic(2), 0.5)
    np.testing.assert_allclose(jax.jit(jax.vmap(retraction))(x, v), space.metric.exp(v, x), atol=1e-9)
    np.testing.assert_allclose(
        jax.jit(jax.vmap(retraction.inverse))(x[:2], y[:2]), space.metric.log(y[:2], x[:2]), atol=1e-9
    )


def test_retractions_are_those_of_pymanopt():
    from pymanopt import manifolds

    peers = manifolds.SymmetricPositiveDefinite(3), manifolds.Sphere(3)
    for peer, retraction in zip(peers, (SPDSecondOrder(SPD(3)), Exponential(Sphere(2))), strict=True):
        x, v, _ = draws(retraction.manifold, 0.5)
        theirs = peer.retraction if isinstance(retraction, SPDSecondOrder) else peer.exp
        expected = [theirs(*pair) for pair in zip(x, v, strict=True)]
        np.testing.assert_allclose(jax.jit(jax.vmap(retraction))(x, v), expected, atol=1e-13)


def test_the_simplex_is_multiplicative_weights():
    x, v, _ = draws(Simplex(3), 0.1)
    weights = x * np.exp(v / x)
    np.testing.assert_allclose(
        jax.vmap(Exponential(Simplex(3)))(x, v), weights / weights.sum(1, keepdims=True), atol=1e-14
    )
