"""The door to geomstats: what goes through agrees with geomstats' own, and its learning algorithms run on our manifolds."""

import numpy as np
import pytest
from hypothesis import given
from retrax.interop import from_geomstats, to_geomstats
from retrax.interop.peers import import_peer, seeded
from retrax.manifolds import SO, Euclidean, Product, Sphere

from tests.support.numerics import SEEDS

Hypersphere = import_peer("geomstats.geometry.hypersphere").Hypersphere
FlatSpace = import_peer("geomstats.geometry.euclidean").Euclidean
SpecialOrthogonal = import_peer("geomstats.geometry.special_orthogonal").SpecialOrthogonal
ProductManifold = import_peer("geomstats.geometry.product_manifold").ProductManifold
FrechetMean = import_peer("geomstats.learning.frechet_mean").FrechetMean
TangentPCA = import_peer("geomstats.learning.pca").TangentPCA

SPACES = {
    "Hypersphere": (Hypersphere(3), Sphere(3)),
    "SO": (SpecialOrthogonal(3), SO(3)),
    "flat product": (ProductManifold([Hypersphere(2), SpecialOrthogonal(3)]), Sphere(2) * SO(3)),
    "stacked product": (ProductManifold([Hypersphere(2), FlatSpace(3)]), Sphere(2) * Euclidean(3)),
}


@pytest.mark.parametrize("name", SPACES)
@given(seed=SEEDS)
def test_every_method_means_what_that_of_geomstats_means(name, seed):
    theirs, manifold = SPACES[name]
    counterpart = from_geomstats(theirs)
    assert counterpart.manifold == manifold
    ours = to_geomstats(*counterpart)
    with seeded(seed):
        x, y, a = (theirs.random_point(4) for _ in range(3))
    assert (ours.dim, ours.shape) == (theirs.dim, theirs.shape)
    assert np.all(ours.belongs(x))
    assert not np.any(ours.belongs(x + np.max(np.abs(x))))
    v = ours.to_tangent(a, x)
    assert np.all(ours.is_tangent(v, x))
    np.testing.assert_allclose(v, theirs.to_tangent(a, x), atol=1e-13)
    np.testing.assert_allclose(ours.metric.exp(v, x), theirs.metric.exp(v, x), atol=1e-12)
    w = ours.metric.log(y, x)
    np.testing.assert_allclose(ours.metric.exp(w, x), y, atol=1e-12)
    np.testing.assert_allclose(ours.metric.exp(w[0], x[0]), y[0], atol=1e-12)
    moved = ours.metric.parallel_transport(v, x, end_point=y)
    np.testing.assert_allclose(ours.metric.norm(moved, y), ours.metric.norm(v, x), atol=1e-11)
    np.testing.assert_allclose(ours.metric.lifting(ours.metric.retraction(0.1 * v, x), x), 0.1 * v, atol=1e-12)


@given(seed=SEEDS)
def test_frechet_mean_of_two_attitudes_is_half_way(seed):
    space = to_geomstats(SO(3))
    with seeded(seed):
        x = space.random_point()
        v = space.to_tangent(np.random.standard_normal((3, 3)), x)  # noqa: NPY002
    v /= np.linalg.norm(v)
    estimator = FrechetMean(space).set(epsilon=1e-20)
    mean = estimator.fit(np.stack([x, space.metric.exp(v, x)])).estimate_
    np.testing.assert_allclose(mean, space.metric.exp(v / 2, x), atol=1e-10)


def test_tangent_pca_finds_the_directions_of_a_cloud():
    space = to_geomstats(Product(SO(3), Euclidean(2)))
    rng = np.random.default_rng(0)
    centre = np.concatenate([np.eye(3).ravel(), np.zeros(2)])
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]]).ravel() / np.sqrt(2)
    directions = np.stack([np.r_[turn, 0, 0], np.r_[np.zeros(9), 0.6, 0.8]])
    weights = rng.standard_normal((200, 2)) * [0.5, 0.1]
    pca = TangentPCA(space, n_components=2).fit(space.metric.exp(weights @ directions, centre), base_point=centre)
    np.testing.assert_allclose(np.abs(pca.components_ @ directions.T), np.eye(2), atol=0.1)
    np.testing.assert_allclose(pca.explained_variance_, np.linalg.eigvalsh(np.cov(weights.T))[::-1], rtol=1e-10)


def test_what_has_no_base_point_is_refused():
    with pytest.raises(ValueError, match="base_point"):
        to_geomstats(SO(3)).to_tangent(np.eye(3))
