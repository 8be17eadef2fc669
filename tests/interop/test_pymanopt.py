"""The door to pymanopt: what goes through agrees with pymanopt's own, and its optimisers reach known optima."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.interop import from_pymanopt, to_pymanopt
from retrax.interop.peers import import_peer, seeded
from retrax.manifolds import SO, CotangentBundle, Euclidean, Product, Sphere
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
    with seeded(seed):
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
    with seeded(seed):
        x = space.random_point()
        v = space.random_tangent_vector(x)
    assert [part.shape for part in x] == [(3, 3), (3,), (3,)]
    np.testing.assert_allclose(v[0], -v[0].T, atol=1e-15)
    assert space.norm(x, v) == pytest.approx(1, abs=1e-14)
    conventions = from_pymanopt(space).conventions
    check(conventions.coordinates(x, conventions.tangent(x, list(v))), v)
    check(conventions.lift(conventions.point(x)), x)
    check(2 * v - v / 2 + (-v), 0.5 * v)


def test_a_manifold_without_an_exponential_says_so():
    space = to_pymanopt(CotangentBundle(Sphere(2)), BundleRetraction(Exponential(Sphere(2))))
    x = space.random_point()
    assert len(x) == 2
    with pytest.raises(NotImplementedError, match="exponential map"):
        space.exp(x, space.zero_vector(x))


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
