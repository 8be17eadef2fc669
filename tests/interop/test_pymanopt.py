"""The door to pymanopt: what goes through agrees with pymanopt's own, and its optimisers reach known optima."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.interop import from_pymanopt, to_pymanopt
from retrax.interop.isolated_import import import_peer, seed_numpy
from retrax.interop.pymanopt import conventions_of, typical_distance
from retrax.manifolds import (
    SO,
    SPD,
    ComplexStiefel,
    CotangentBundle,
    Euclidean,
    Grassmann,
    InvalidInputError,
    Oblique,
    Power,
    Product,
    Sphere,
    Stiefel,
)
from retrax.retractions import BundleRetraction, Cayley, Exponential, Polar, Projection

from tests.support.cases import NESTED
from tests.support.numerics import SEEDS

pymanopt = import_peer("pymanopt")
theirs = import_peer("pymanopt.manifolds")

SPACES = {
    "Euclidean": theirs.Euclidean(2, 3),
    "Sphere": theirs.Sphere(2, 2),
    "SO": theirs.SpecialOrthogonalGroup(3, retraction="polar"),
    "Product": theirs.Product([theirs.Sphere(3), theirs.SpecialOrthogonalGroup(3, retraction="qr")]),
}
on_every_space = pytest.mark.parametrize("name", SPACES)


@cache
def ours(name):
    """Our manifold for a pymanopt space, as a pymanopt space."""
    return to_pymanopt(*from_pymanopt(SPACES[name]))


def draw(name, seed):
    """Two points, a tangent vector at the first, and two ambient vectors there, of pymanopt's own."""
    space = SPACES[name]
    with seed_numpy(seed):
        x, y = space.random_point(), space.random_point()
        v = space.random_tangent_vector(x)
        g, h = (jax.tree.map(lambda leaf: np.random.standard_normal(leaf.shape), list_of(x)) for _ in range(2))  # noqa: NPY002
    return x, y, v, g, h


def list_of(a):
    return list(a) if isinstance(a, list) else a


def check(a, b, tolerance=1e-12):
    for leaf, other in zip(jax.tree.leaves(list_of(a)), jax.tree.leaves(list_of(b)), strict=True):
        np.testing.assert_allclose(leaf, other, atol=tolerance, rtol=0)


@on_every_space
@given(seed=SEEDS)
@pytest.mark.usual(1)
def test_every_method_means_what_that_of_pymanopt_means(name, seed):
    mine, other = ours(name), SPACES[name]
    x, y, v, g, h = draw(name, seed)
    assert (mine.dim, mine.point_layout) == (other.dim, other.point_layout)
    assert mine.typical_dist == pytest.approx(other.typical_dist, abs=1e-14)
    check(mine.projection(x, g), other.projection(x, g))
    check(mine.inner_product(x, v, mine.projection(x, g)), other.inner_product(x, v, other.projection(x, g)))
    check(mine.embedding(x, v), other.embedding(x, v) if name != "Product" else [v[0], x[1] @ v[1]])
    check(mine.retraction(x, v), other.retraction(x, v))
    check(mine.exp(x, v), other.exp(x, v))
    check(mine.log(x, mine.exp(x, v)), v)
    check(mine.dist(x, y), mine.norm(x, mine.log(x, y)))
    check(mine.euclidean_to_riemannian_gradient(x, g), other.euclidean_to_riemannian_gradient(x, g))
    hessian = [space.euclidean_to_riemannian_hessian(x, g, h, v) for space in (mine, other)]
    check(*hessian)


@on_every_space
def test_there_and_back_is_our_own(name):
    counterpart = from_pymanopt(ours(name))
    assert counterpart.manifold == from_pymanopt(SPACES[name]).manifold
    again = from_pymanopt(to_pymanopt(counterpart.manifold)).manifold
    assert again == counterpart.manifold


def test_retractions_keep_their_names():
    assert isinstance(from_pymanopt(SPACES["SO"]).retraction, type(Polar(SO(3))))
    assert isinstance(from_pymanopt(SPACES["Sphere"]).retraction, type(Projection(Sphere(3))))


@pytest.mark.parametrize("optimiser", ["TrustRegions", "ConjugateGradient"])
@pytest.mark.long("TrustRegions")
def test_an_optimiser_solves_wahba_s_problem(optimiser):
    rng = np.random.default_rng(1)
    a = rng.standard_normal((3, 3))
    space = to_pymanopt(SO(3) * Euclidean(3), Cayley(SO(3) * Euclidean(3)))

    @pymanopt.function.jax(space)
    def cost(rotation, shift):
        return -jnp.sum(a * rotation) + jnp.sum((shift - rotation[0]) ** 2)

    u, s, vt = np.linalg.svd(a)
    sign = np.linalg.det(u @ vt)
    best = u @ np.diag([1, 1, sign]) @ vt
    options = {"verbosity": 0, "min_gradient_norm": 1e-8, "min_step_size": 1e-14, "max_iterations": 500}
    result = getattr(pymanopt.optimizers, optimiser)(**options).run(
        pymanopt.Problem(space, cost), initial_point=[np.eye(3), np.zeros(3)]
    )
    assert result.cost == pytest.approx(-(s[0] + s[1] + sign * s[2]), abs=1e-10)
    np.testing.assert_allclose(result.point[0], best, atol=1e-5)
    np.testing.assert_allclose(result.point[1], best[0], atol=1e-5)


@given(seed=SEEDS)
def test_a_nested_product_is_a_flat_list(seed):
    space = to_pymanopt(NESTED)
    with seed_numpy(seed):
        x = space.random_point()
        v = space.random_tangent_vector(x)
    assert [part.shape for part in x] == [(3, 3), (3,), (3,)]
    np.testing.assert_allclose(v[0], -v[0].T, atol=1e-15)
    assert space.norm(x, v) == pytest.approx(1, abs=1e-14)
    conventions = from_pymanopt(space).conventions
    check(conventions.coordinates(x, conventions.tangent(x, list(v))), v)
    check(conventions.lift(conventions.point(x)), x)
    check(2 * v - v / 2 + (-v), 0.5 * v)


def test_a_bundle_has_points_of_two_arrays():
    space = to_pymanopt(CotangentBundle(Sphere(2)), BundleRetraction(Exponential(Sphere(2))))
    x = space.random_point()
    assert len(x) == 2
    check(space.retraction(x, space.zero_vector(x)), x)


def test_a_logarithm_without_a_value_is_refused_and_the_distance_known():
    space, x = to_pymanopt(Sphere(2)), np.array([0.6, 0.0, 0.8])
    assert space.dist(x, -x) == pytest.approx(np.pi, abs=1e-15)
    with pytest.raises(ValueError, match="no one shortest geodesic"):
        space.log(x, -x)


@pytest.mark.parametrize("given", [{"retraction": Cayley}, {"retraction": Sphere(2)}, {"metric": Cayley}], ids=str)
def test_what_is_no_retraction_or_metric_is_refused_in_words(given):
    with pytest.raises(InvalidInputError, match=r"expected a (retraction|metric) of SO\(3\), got .*; (a family|try)"):
        to_pymanopt(SO(3), **given)


@pytest.mark.slow
def test_a_manifold_without_an_exponential_gets_that_of_its_geodesics():
    space = to_pymanopt(*from_pymanopt(theirs.SphereSubspaceIntersection(np.eye(3))))
    x, v = np.eye(3)[0], np.array([0.0, 0.3, 0.4])
    np.testing.assert_allclose(space.exp(x, v), np.cos(0.5) * x + np.sin(0.5) * v / 0.5, atol=1e-12)


@given(seed=SEEDS)
def test_unitary_matrices_have_skew_hermitian_factors_as_tangent_vectors(seed):
    other = theirs.UnitaryGroup(2, retraction="polar")
    mine = unitary()
    with seed_numpy(seed):
        x = other.random_point()
        v = other.random_tangent_vector(x)
        g = np.random.standard_normal((2, 2)) + 1j * np.random.standard_normal((2, 2))  # noqa: NPY002
    assert (mine.dim, mine.point_layout) == (other.dim, other.point_layout)
    assert mine.typical_dist == pytest.approx(other.typical_dist, abs=1e-14)
    check(mine.embedding(x, v), other.embedding(x, v))
    check(mine.retraction(x, v), other.retraction(x, v))
    check(mine.exp(x, v), other.exp(x, v))
    # Not pymanopt's own projection, which forgets the conjugation.
    factor = x.conj().T @ g
    check(mine.projection(x, g), (factor - factor.conj().T) / 2)
    check(mine.euclidean_to_riemannian_gradient(x, g), (factor - factor.conj().T) / 2)
    assert mine.inner_product(x, v, v) == pytest.approx(1, abs=1e-14)


@cache
def unitary():
    return to_pymanopt(*from_pymanopt(theirs.UnitaryGroup(2, retraction="polar")))


@pytest.mark.parametrize("make", [unitary, lambda: to_pymanopt(ComplexStiefel(3, 2))], ids=["U(2)", "frames"])
@pytest.mark.usual(1)
def test_an_optimiser_finds_the_nearest_unitary_matrix_or_complex_frame(make):
    rng, space = np.random.default_rng(1), make()
    shape = space.random_point().shape
    a = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)

    @pymanopt.function.jax(space)
    def cost(x):
        return -jnp.real(jnp.sum(jnp.conj(a) * x))

    options = {"verbosity": 0, "min_gradient_norm": 1e-9, "min_step_size": 1e-14}
    start = np.eye(*shape, dtype=complex)
    result = pymanopt.optimizers.TrustRegions(**options).run(pymanopt.Problem(space, cost), initial_point=start)
    u, s, vh = np.linalg.svd(a, full_matrices=False)
    assert result.cost == pytest.approx(-np.sum(s), abs=1e-12)
    np.testing.assert_allclose(result.point, u @ vh, atol=1e-8)


FACTORED = theirs.FixedRankEmbedded(5, 4, 2)


@cache
def factored():
    return to_pymanopt(*from_pymanopt(FACTORED))


@given(seed=SEEDS)
def test_matrices_of_fixed_rank_are_written_by_their_singular_value_decompositions(seed):
    mine = factored()
    with seed_numpy(seed):
        x, y = FACTORED.random_point(), FACTORED.random_point()
        v, z = FACTORED.random_tangent_vector(x), np.random.standard_normal((5, 4))  # noqa: NPY002
        g = [np.random.standard_normal(leaf.shape) for leaf in x]  # noqa: NPY002
    assert (mine.dim, mine.point_layout, mine.typical_dist) == (
        FACTORED.dim,
        FACTORED.point_layout,
        FACTORED.typical_dist,
    )
    check(mine.projection(x, z), FACTORED.projection(x, z))
    check(mine.projection(x, mine.embedding(x, v)), v)
    check(mine.inner_product(x, v, v), 1)
    check(mine.transport(x, y, v), FACTORED.transport(x, y, v))
    there, other = mine.retraction(x, v), FACTORED.retraction(x, v)  # equal up to signs of singular vectors
    check((there.u * there.s) @ there.vt, (other.u * other.s) @ other.vt)
    assert np.all(np.sum(there.u * x.u, axis=0) >= 0)
    # Of the singular values: the derivative divides by it.
    gap = 1e-12 / min(abs(x.s[0] ** 2 - x.s[1] ** 2), x.s[1], 1) ** 2
    check(mine.euclidean_to_riemannian_gradient(x, g), FACTORED.euclidean_to_riemannian_gradient(x, g), gap)


def test_an_optimiser_finds_the_nearest_matrix_of_a_rank():
    a = np.random.default_rng(0).standard_normal((5, 4))
    space = factored()

    @pymanopt.function.jax(space)
    def cost(u, s, vt):
        return jnp.sum(((u * s) @ vt - a) ** 2)

    with seed_numpy(0):
        start = space.random_point()
    options = {"verbosity": 0, "min_gradient_norm": 1e-7, "min_step_size": 1e-14, "max_iterations": 500}
    result = pymanopt.optimizers.ConjugateGradient(**options).run(pymanopt.Problem(space, cost), initial_point=start)
    u, s, vt = np.linalg.svd(a)
    assert result.cost == pytest.approx(np.sum(s[2:] ** 2), abs=1e-12)
    np.testing.assert_allclose(
        (result.point.u * result.point.s) @ result.point.vt, (u[:, :2] * s[:2]) @ vt[:2], atol=1e-6
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("SO3",), "expected a manifold of retrax"),
        ((SO(3), Exponential(SO(4))), "the retraction acts on SO"),
        ((Product(SO(3)), Exponential(SO(3))), "the retraction acts on SO"),
    ],
)
def test_what_is_no_pair_of_manifold_and_retraction_is_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        to_pymanopt(*arguments)


@pytest.mark.parametrize("manifold", [Grassmann(4, 2), Power(Stiefel(3, 2), 2), Power(Grassmann(3, 1), 2)], ids=str)
@pytest.mark.usual(1)
def test_points_and_tangent_vectors_return_from_the_writing_of_pymanopt(manifold):
    """However a representative is chosen, also near another one; coordinates mean the vector that they are of."""
    conventions = conventions_of(manifold)

    @jax.jit
    def facts(seeds):
        q, other = (manifold.random_point(jax.random.key(seed)) for seed in seeds)
        w = manifold.random_tangent(jax.random.key(2), q)
        x = conventions.lift(q)
        near = conventions.lift(q, conventions.lift(other))
        back = [conventions.point(each) - q for each in (x, near)]
        meant = [conventions.tangent(each, conventions.coordinates(each, w)) - w for each in (x, near)]
        moved = conventions.elsewhere(x, x, conventions.coordinates(x, w))
        return back, meant, conventions.push(x, moved) - w, w

    *left, w = facts(jnp.arange(2))
    assert max(np.max(np.abs(a)) for a in jax.tree.leaves(left)) < 1e-12
    assert np.max(np.abs(w)) > 0.1


OTHERS = {
    "positive definite": (theirs.SymmetricPositiveDefinite(2), SPD(2)),
    "copies": (theirs.SymmetricPositiveDefinite(2, k=3), Power(SPD(2), 3)),
    "frames": (theirs.Stiefel(4, 2), Stiefel(4, 2)),
    "subspaces": (theirs.Grassmann(4, 2), Grassmann(4, 2)),
    "oblique": (theirs.Oblique(3, 2), Oblique(3, 2)),
    "product": (theirs.Product([theirs.Sphere(3), theirs.Grassmann(3, 1)]), Product(Sphere(2), Grassmann(3, 1))),
}


@pytest.mark.parametrize("name", OTHERS)
def test_spaces_of_pymanopt_have_our_manifolds_of_their_dimension_and_size(name):
    space, manifold = OTHERS[name]
    found = from_pymanopt(space)
    assert found.manifold == manifold
    assert manifold.dimension == space.dim
    assert typical_distance(manifold) == pytest.approx(space.typical_dist, rel=1e-15)
