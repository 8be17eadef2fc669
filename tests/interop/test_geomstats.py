"""The door to geomstats: what goes through agrees with geomstats' own, and its learning algorithms run on our
manifolds."""

import equinox as eqx
import numpy as np
import pytest
from hypothesis import given
from retrax.integrators import GeodesicRetraction
from retrax.interop import from_geomstats, to_geomstats
from retrax.interop.isolated_import import import_peer, seed_numpy
from retrax.interop.metrics import exponential_map, is_symmetric, natural_metric
from retrax.manifolds import (
    SE,
    SL,
    SO,
    SPD,
    SU,
    AffineInvariantMetric,
    CanonicalMetric,
    DomainError,
    EmbeddedMetric,
    Euclidean,
    Grassmann,
    Hyperbolic,
    LeftInvariantMetric,
    LorentzMetric,
    Oblique,
    Power,
    PowerMetric,
    Product,
    ScaledMetric,
    Sphere,
    Stiefel,
    U,
)
from retrax.retractions import (
    Exponential,
    FrobeniusExponential,
    GroupExponential,
    PowerRetraction,
    ProductRetraction,
    SEDecoupled,
    SphereExponential,
    StiefelCanonicalExponential,
)
from scipy.linalg import expm

from tests.support.numerics import SEEDS

Hypersphere = import_peer("geomstats.geometry.hypersphere").Hypersphere
FlatSpace = import_peer("geomstats.geometry.euclidean").Euclidean
SpecialOrthogonal = import_peer("geomstats.geometry.special_orthogonal").SpecialOrthogonal
SpecialEuclidean = import_peer("geomstats.geometry.special_euclidean").SpecialEuclidean
ProductManifold = import_peer("geomstats.geometry.product_manifold").ProductManifold
FrechetMean = import_peer("geomstats.learning.frechet_mean").FrechetMean
TangentPCA = import_peer("geomstats.learning.pca").TangentPCA

SPACES = {
    "Hypersphere": (Hypersphere(3), Sphere(3)),
    "SO": (SpecialOrthogonal(3), SO(3)),
    "SE": (SpecialEuclidean(3), SE(3)),
    "flat product": (ProductManifold([Hypersphere(2), SpecialOrthogonal(3)]), Sphere(2) * SO(3)),
    "stacked product": (ProductManifold([Hypersphere(2), FlatSpace(3)]), Sphere(2) * Euclidean(3)),
}


@pytest.mark.parametrize("name", SPACES)
@given(seed=SEEDS)
@pytest.mark.usual(1)
def test_every_method_means_what_that_of_geomstats_means(name, seed):
    theirs, manifold = SPACES[name]
    counterpart = from_geomstats(theirs)
    assert counterpart.manifold == manifold
    ours = to_geomstats(*counterpart)
    with seed_numpy(seed):
        x, y, z = (theirs.random_point(4) for _ in range(3))
        a = z - y
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
    with seed_numpy(seed):
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


def trajectories(space, seed, deviations):
    """Trajectories in SE(3) along a screw, and the same with given lengths of two deviations that are orthonormal."""
    rng = np.random.default_rng(seed)
    with seed_numpy(seed):
        start = to_geomstats(SE(3)).random_point()
    turn = space.geometry.manifold.factor.hat(np.r_[0.3, -0.2, 0.4, 1.0, 0.5, -0.5])
    centre = np.stack([start @ expm(t * turn) for t in np.linspace(0, 1, space.shape[0])])
    directions = space.to_tangent(rng.standard_normal((2, *space.shape)), centre)
    flat = np.linalg.qr(directions.reshape(2, -1).T)[0].T
    return centre, flat, space.metric.exp((deviations @ flat).reshape(-1, *space.shape), centre)


def test_means_and_principal_components_of_trajectories_of_poses():
    space = to_geomstats(Power(SE(3), 4))
    weights = np.random.default_rng(0).standard_normal((30, 2)) * [0.8, 0.2]
    weights = np.concatenate([weights, -weights])  # symmetric about the centre, which is their mean then
    centre, directions, points = trajectories(space, 0, weights)
    mean = FrechetMean(space).set(epsilon=1e-20).fit(points).estimate_
    np.testing.assert_allclose(mean, centre, atol=1e-10)
    pca = TangentPCA(space, n_components=2).fit(points, base_point=mean)
    variances, axes = np.linalg.eigh(np.cov(weights.T))
    np.testing.assert_allclose(pca.explained_variance_, variances[::-1], rtol=1e-8)
    np.testing.assert_allclose(
        np.abs(pca.components_.reshape(2, -1) @ (axes[:, ::-1].T @ directions).T), np.eye(2), atol=1e-8
    )


@pytest.mark.parametrize("manifold", [SE(3), U(2)], ids=str)
@pytest.mark.usual(1)
def test_the_mean_of_two_points_of_a_group_is_half_way(manifold):
    space = to_geomstats(manifold)
    with seed_numpy(2):
        x, y = space.random_point(2)
    v = space.metric.log(y, x)
    mean = FrechetMean(space).set(epsilon=1e-20).fit(np.stack([x, y])).estimate_
    np.testing.assert_allclose(mean, space.metric.exp(v / 2, x), atol=1e-10)


COUNTERPARTS = {
    "positive definite": ("spd_matrices", "SPDMatrices", (2,), AffineInvariantMetric(SPD(2))),
    "frames": ("stiefel", "Stiefel", (3, 2), CanonicalMetric(Stiefel(3, 2))),
    "subspaces": ("grassmannian", "Grassmannian", (4, 2), EmbeddedMetric(Grassmann(4, 2))),
    "hyperboloid": ("hyperboloid", "Hyperboloid", (2,), LorentzMetric(Hyperbolic(2))),
    "copies": ("nfold_manifold", "NFoldManifold", (Hypersphere(2), 3), PowerMetric(EmbeddedMetric(Sphere(2)), 3)),
}


@pytest.mark.parametrize("name", COUNTERPARTS)
def test_spaces_with_the_metric_of_geomstats_are_our_own(name):
    module, kind, arguments, metric = COUNTERPARTS[name]
    space = getattr(import_peer(f"geomstats.geometry.{module}"), kind)(*arguments)
    found = from_geomstats(space)
    assert eqx.tree_equal(found.metric, metric)
    assert found.manifold == metric.manifold
    assert found.manifold.dimension == space.dim
    assert from_geomstats(to_geomstats(*found)).retraction == found.retraction


BODY = LeftInvariantMetric(SO(3), [1.0, 2.0, 3.0])
MAPS = {
    "scaled": (ScaledMetric(EmbeddedMetric(U(2)), 0.5), GroupExponential(U(2))),
    "special unitary": (EmbeddedMetric(SU(3)), GroupExponential(SU(3))),
    "decoupled": (EmbeddedMetric(SE(3)), SEDecoupled(SE(3))),
    "split": (EmbeddedMetric(SE(3) * Sphere(2)), ProductRetraction(SEDecoupled(SE(3)), SphereExponential(Sphere(2)))),
    "special linear": (natural_metric(SL(2)), FrobeniusExponential(SL(2))),
    "round body": (LeftInvariantMetric(SO(3), [2.0, 2.0, 2.0]), GroupExponential(SO(3))),
    "power": (EmbeddedMetric(Power(SE(2), 3)), PowerRetraction(SEDecoupled(SE(2)), 3)),
    "natural": (
        natural_metric(SPD(2) * Power(Hyperbolic(2), 2)),
        ProductRetraction(Exponential(SPD(2)), PowerRetraction(Exponential(Hyperbolic(2)), 2)),
    ),
    "frames": (CanonicalMetric(Stiefel(3, 2)), StiefelCanonicalExponential(Stiefel(3, 2))),
}


@pytest.mark.parametrize("name", MAPS)
def test_metrics_have_the_exponential_maps_that_are_known(name):
    metric, expected = MAPS[name]
    assert eqx.tree_equal(exponential_map(metric), expected)


def test_other_metrics_have_integrated_geodesics():
    assert exponential_map(BODY).metric == BODY
    # No bi-invariant metric, no closed form.
    assert isinstance(exponential_map(EmbeddedMetric(SL(2))), GeodesicRetraction)
    assert not is_symmetric(BODY)
    assert is_symmetric(EmbeddedMetric(SO(3)))
    assert is_symmetric(natural_metric(SPD(2) * Power(Hyperbolic(2), 2)))
    assert not is_symmetric(natural_metric(SPD(2) * SL(2)))


@pytest.mark.slow
def test_geodesics_of_a_rigid_body_about_its_principal_axes_are_rotations():
    space = to_geomstats(SO(3), metric=BODY)
    x, turn = np.eye(3), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]])
    y = space.metric.exp(0.8 * turn, x)
    np.testing.assert_allclose(y, expm(0.8 * turn), atol=1e-11)
    np.testing.assert_allclose(space.metric.log(y, x), 0.8 * turn, atol=1e-11)
    assert space.metric.dist(x, y) == pytest.approx(0.8 * np.sqrt(3), abs=1e-11)


HALF_TURN = np.diag([1.0, -1.0, -1.0])
FARTHEST = {
    "sphere": (Sphere(2), lambda x: -x, np.pi),
    "rotations": (SO(3), lambda x: x @ HALF_TURN, np.sqrt(2) * np.pi),
    "poses": (SE(3), lambda x: x @ np.diag([1.0, -1.0, -1.0, 1.0]), np.sqrt(2) * np.pi),
    "unitary": (U(2), lambda x: -x, np.sqrt(2) * np.pi),
    "special unitary": (SU(2), lambda x: -x, np.sqrt(2) * np.pi),
    "subspaces": (Grassmann(4, 2), lambda x: np.eye(4) - x, np.pi),
    "oblique": (Oblique(3, 2), lambda x: -x, np.sqrt(2) * np.pi),
    "power": (Power(Sphere(2), 3), lambda x: -x, np.sqrt(3) * np.pi),
    "product": (Sphere(2) * Sphere(1), lambda x: -x, np.sqrt(2) * np.pi),
}


@pytest.mark.parametrize("name", FARTHEST)
@pytest.mark.usual(1)
def test_distances_are_known_on_the_cut_locus_and_are_lengths_of_logarithms_elsewhere(name):
    manifold, farthest, expected = FARTHEST[name]
    space = to_geomstats(manifold, metric=ScaledMetric(EmbeddedMetric(manifold), 4.0))
    with seed_numpy(1):
        x, y = space.random_point(2)
    assert space.metric.dist(x, farthest(x)) == pytest.approx(2 * expected, abs=1e-12)
    assert space.metric.dist(x, y) == pytest.approx(float(space.metric.norm(space.metric.log(y, x), x)), abs=1e-12)
    assert space.metric.dist(x, x) == pytest.approx(0, abs=1e-12)


def test_a_logarithm_without_a_value_is_refused():
    space = to_geomstats(Sphere(2))
    x = np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0]])
    for call in (space.metric.log, space.metric.lifting):
        with pytest.raises(DomainError, match="no one shortest geodesic"):
            call(np.stack([x[1], -x[1]]), x)


@pytest.mark.slow
def test_the_mean_of_matrices_of_determinant_one():
    space, x = to_geomstats(SL(2)), np.array([[1.0, 0.5], [0.2, 1.1]])
    v = space.to_tangent(np.array([[0.7, -0.6], [0.3, 0.2]]), x)
    points = space.metric.exp(np.array([1.0, -1.0, 0.3])[:, None, None] * v, x)
    mean = FrechetMean(space).set(epsilon=1e-20).fit(points).estimate_
    np.testing.assert_allclose(mean, space.metric.exp(0.1 * v, x), atol=1e-12)


def test_what_has_no_base_point_is_refused():
    with pytest.raises(ValueError, match="base_point"):
        to_geomstats(SO(3)).to_tangent(np.eye(3))
