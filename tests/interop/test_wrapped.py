"""Spaces of the peers that we do not have: derivatives by differences, good enough for symplectic steps; and those
refused."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.integrators import SymplecticIntegrator
from retrax.integrators.initial_value.step import lifted_step
from retrax.interop import from_geomstats, from_pymanopt
from retrax.interop.isolated_import import import_peer
from retrax.interop.wrapped import WrappedManifold, wrap
from retrax.interop.wrapped.differences import HOST_NODES as DIFFERENCE_NODES
from retrax.interop.wrapped.differences import host_function
from retrax.retractions import CotangentLift, Midpoint
from retrax.testing import check_cotangent_lift, check_manifold, check_retraction

from tests.support.numerics import CENTRAL_NODES, SEEDS, compiled, differences

theirs = import_peer("pymanopt.manifolds")
SPACING = 1e-2


def geomstats_space(module, name, *arguments, **options):
    """A space of ``geomstats.geometry``."""
    return getattr(import_peer(f"geomstats.geometry.{module}"), name)(*arguments, **options)


BALL = from_geomstats(geomstats_space("poincare_ball", "PoincareBall", 2))


# Spaces without a counterpart of ours, and one with it that is wrapped all the same; points well inside the balls and
# the cone.
WRAPPED = {
    "geomstats ball": (lambda: BALL[:2], [0.3, -0.2]),
    "geomstats half-plane": (
        lambda: from_geomstats(geomstats_space("poincare_half_space", "PoincareHalfSpace", 2))[:2],
        [0.4, 1.2],
    ),
    "geomstats sphere": (
        lambda: forced("geomstats", geomstats_space("hypersphere", "Hypersphere", 2)),
        [0.6, 0.0, -0.8],
    ),
    "pymanopt ball": (lambda: from_pymanopt(theirs.PoincareBall(2))[:2], [0.3, -0.2]),
    "geomstats shapes": (
        lambda: from_geomstats(geomstats_space("pre_shape", "PreShapeSpace", 3, 2))[:2],
        np.array([[1.0, 0.2], [-0.7, 0.5], [-0.3, -0.7]]) / np.sqrt(2.36),
    ),
    "pymanopt cone": (lambda: from_pymanopt(theirs.Positive(2, 1))[:2], [[0.9], [1.3]]),
}


def forced(library, space):
    """A space that we have, through its own functions all the same."""
    return wrap(
        getattr(import_peer(f"retrax.interop.{library}.spaces"), f"{library.capitalize()}Host")(space), str(space)
    )


def energy(q, p):
    """Kinetic energy that depends on the point, with a potential and a magnetic term."""
    q, p = jnp.ravel(q), jnp.ravel(p)
    return (1 + q[0] ** 2) * (p @ p) / 2 + jnp.sum(jnp.sin(q + jnp.arange(q.size))) + q[-1] ** 2 * p[0]


def midpoint_steps(name):
    """Points on curves through a point of T*Q along a frame of its tangent space, and where a midpoint step takes
    them."""
    (manifold, retraction), q = WRAPPED[name][0](), jnp.array(WRAPPED[name][1])
    stage = SymplecticIntegrator(CotangentLift(Midpoint(retraction))).stage(energy, 0.1)

    def step(q, p):
        result = lifted_step(stage, q, p, (q, p, p))
        return (result.q, result.p), result.converged

    def around(p, s):
        def horizontal(e):
            there = retraction(q, s * e)
            return there, manifold.projection(there, p)

        parts = jax.vmap(horizontal)(manifold.basis(q)), jax.vmap(lambda e: (q, p + s * e))(manifold.basis(q))
        return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)

    def facts(p):
        starts = jax.vmap(lambda s: around(manifold.projection(q, p), s))(SPACING * CENTRAL_NODES)
        return starts, *jax.vmap(jax.vmap(step))(*starts)

    return compiled(facts)(np.random.default_rng(0).standard_normal(q.shape))


def canonical_form(curves):
    """Matrix of ``dq ^ dp`` on the velocities of curves in T*Q."""
    dq, dp = (differences(part.reshape(*part.shape[:2], -1), SPACING) for part in curves)
    return dq @ dp.T - dp @ dq.T


@pytest.mark.slow
@pytest.mark.parametrize("name", WRAPPED)
def test_the_midpoint_step_of_a_wrapped_space_is_symplectic(name):
    starts, ends, converged = midpoint_steps(name)
    assert np.all(converged)
    form = canonical_form(starts)
    assert np.linalg.matrix_rank(form) == len(form)
    np.testing.assert_allclose(canonical_form(ends), form, rtol=0, atol=1e-10)


@pytest.mark.slow
@given(seed=SEEDS)
def test_derivatives_of_a_wrapped_retraction_are_those_of_its_formula(seed):
    x, v, w, dx = derivatives()[0](seed)
    wrapped, exact = derivatives()[1](x, v, w, dx)
    for order, tolerance in ((0, 1e-15), (1, 1e-11), (2, 1e-9)):
        np.testing.assert_allclose(wrapped[order], exact[order], atol=tolerance, rtol=tolerance)


@cache
def derivatives():
    """Random vectors on a sphere, and derivatives of order 0, 1, 2 of pymanopt's projection retraction there, and of
    ours."""
    space = theirs.SphereSubspaceIntersection(np.eye(3))
    manifold, retraction, _, _ = from_pymanopt(space)

    def drawn(seed):
        keys = jax.random.split(jax.random.key(seed), 4)
        x = manifold.random_point(keys[0])
        return x, *(0.7 * manifold.random_tangent(key, x) for key in keys[1:])

    def formula(x, v):
        y = x + v
        return y / jnp.linalg.norm(y)

    def facts(x, v, w, dx):
        def values(function):
            curve = lambda t, s: function(formula(x, s * dx), tangential(formula(x, s * dx), v + t * w))  # noqa: E731
            first = jax.grad(lambda t: jnp.sum(jnp.sin(curve(t, 0.0))))(0.3)
            second = jax.jacfwd(jax.jacrev(curve, argnums=1), argnums=0)(0.3, 0.2)
            return curve(0.3, 0.2), first, second

        return values(retraction), values(formula)

    def tangential(x, a):
        return a - (x @ a) * x

    return compiled(drawn), compiled(facts)


def mobius(x, v):
    """The exponential map of the ball of curvature -1, from its formula."""

    def plus(a, b):
        ab, aa, bb = a @ b, a @ a, b @ b
        return ((1 + 2 * ab + bb) * a + (1 - aa) * b) / (1 + 2 * ab + aa * bb)

    length = jnp.sqrt(v @ v)
    return plus(x, jnp.tanh(length / (1 - x @ x)) * v / length)


@pytest.mark.slow
@pytest.mark.parametrize("radius", [0.9, 0.97, 0.99, 0.999])
def test_derivatives_are_right_where_a_space_changes_fast(radius):
    retraction = from_pymanopt(theirs.PoincareBall(2)).retraction
    x, v = radius * np.array([0.6, 0.8]), np.array([0.01, 0.005])
    for order in (jax.jacfwd, lambda f, **options: jax.jacfwd(jax.jacfwd(f, **options), **options)):
        wrapped, exact = (order(function, argnums=(0, 1))(x, v) for function in (retraction, mobius))
        wrapped, exact = jax.tree.leaves(wrapped), jax.tree.leaves(exact)
        size = max(np.max(np.abs(part)) for part in exact)
        for part, other in zip(wrapped, exact, strict=True):
            np.testing.assert_allclose(part, other, rtol=0, atol=1e-7 * size)


def test_a_derivative_that_differences_do_not_give_is_nan():
    def moved(x, step):
        return x[:, None, None] + step * DIFFERENCE_NODES[:, None]

    def jumps_at_zero(x):
        return np.abs(x - 1e-3) + np.sign(x)

    function = host_function(jumps_at_zero, moved, (1,))
    slope = jax.vmap(jax.grad(lambda x: function(x)[0]))(np.array([[0.02], [2e-3], [0.0], [-1e-3]]))
    np.testing.assert_allclose(slope, [[1.0], [1.0], [np.nan], [-1.0]], atol=1e-11)


RANDOM = {
    "pymanopt ball": lambda: from_pymanopt(theirs.PoincareBall(2)),
    "geomstats ball": lambda: BALL,
    "half-plane": lambda: from_geomstats(geomstats_space("poincare_half_space", "PoincareHalfSpace", 2)),
    "pymanopt cone": lambda: from_pymanopt(theirs.Positive(2, 1)),
    "rotation vectors": lambda: from_geomstats(geomstats_space("special_orthogonal", "SpecialOrthogonal", 3, "vector")),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RANDOM)
def test_lifted_midpoint_maps_are_symplectic_at_random_points(name):
    lift = CotangentLift(Midpoint(RANDOM[name]().retraction))
    check_cotangent_lift(lift, only="lift_is_symplectic", seeds=range(2), tolerance=1e-7)


def test_a_wrapped_space_keeps_the_promises_of_a_manifold():
    check_manifold(BALL.manifold, tolerance=1e-9)


@pytest.mark.slow
def test_a_wrapped_retraction_keeps_the_promises_of_one():
    lost = "geomstats takes vectors shorter than about 1e-8 for zero"
    check_retraction(
        BALL.retraction,
        reach=0.2,
        seeds=(0, 1),
        tolerance=1e-9,
        skip={"inverse_keeps_the_accuracy_of_short_vectors": lost},
    )


@pytest.mark.slow
def test_a_wrapped_space_of_pymanopt_keeps_the_promises_too():
    manifold, retraction = WRAPPED["pymanopt cone"][0]()
    check_manifold(manifold, seeds=(0, 1), tolerance=1e-9)
    check_retraction(retraction, reach=0.05, seeds=(0, 1), tolerance=1e-9)


REFUSED = {
    "quotient": (lambda: from_pymanopt(theirs.PSDFixedRank(4, 2)), "stand for classes"),
    "another quotient": (lambda: from_pymanopt(theirs.Elliptope(4, 2)), "span 4 dimensions where it says 3"),
    "complex": (lambda: from_pymanopt(theirs.ComplexCircle(3)), "points are complex"),
    "coordinates": (
        lambda: from_geomstats(geomstats_space("hypersphere", "Hypersphere", 2, intrinsic=True)),
        "in angles",
    ),
    "no metric": (
        lambda: from_geomstats(geomstats_space("poincare_ball", "PoincareBall", 2, equip=False)),
        "no metric",
    ),
    "angles": (
        lambda: from_geomstats(geomstats_space("special_orthogonal", "SpecialOrthogonal", 2, "vector")),
        "its own functions fail .* try the same space by matrices",
    ),
    "no manifold": (lambda: from_pymanopt("S2"), "takes a pymanopt manifold"),
    "no space": (lambda: from_geomstats("S2"), "takes a real manifold of geomstats"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_used_is_refused_in_words(name):
    make, words = REFUSED[name]
    with pytest.raises(ValueError, match=words):
        make()


def test_copies_with_a_metric_of_their_own_are_wrapped():
    hyperboloids = geomstats_space("poincare_polydisk", "PoincarePolydisk", 2)
    landmarks = geomstats_space("landmarks", "Landmarks", geomstats_space("hypersphere", "Hypersphere", 2), 2)
    for space in (hyperboloids, landmarks):
        manifold, retraction, _, conventions = from_geomstats(space)
        assert isinstance(manifold, WrappedManifold)
        x = manifold.random_point(jax.random.key(0))
        v = 0.1 * manifold.random_tangent(jax.random.key(1), x)
        np.testing.assert_allclose(retraction(x, v), space.metric.exp(np.asarray(v), np.asarray(x)), atol=1e-13)
        assert manifold.contains(x)
        np.testing.assert_array_equal(conventions.point(x), x)


GEOMSTATS_NAMES = {
    "correlations": ("full_rank_correlation_matrices", "FullRankCorrelationMatrices", 2),
    "hemisphere": ("open_hemisphere", "OpenHemisphere", 2),
    "positive reals": ("positive_reals", "PositiveReals"),
    "half-plane": ("poincare_half_space", "PoincareHalfSpace", 2),
    "rotation vectors": ("special_orthogonal", "SpecialOrthogonal", 3, "vector"),
    "pose vectors": ("special_euclidean", "SpecialEuclidean", 3, "vector"),
}


@pytest.mark.parametrize("name", GEOMSTATS_NAMES)
@pytest.mark.usual(2)
def test_spaces_of_geomstats_are_wrapped_with_their_exponential_maps(name):
    space = geomstats_space(*GEOMSTATS_NAMES[name])
    manifold, retraction, _, _ = from_geomstats(space)
    x = manifold.random_point(jax.random.key(0))
    v = 0.1 * manifold.random_tangent(jax.random.key(1), x)
    assert isinstance(manifold, WrappedManifold)
    assert manifold.contains(x)
    np.testing.assert_allclose(retraction(x, v), space.metric.exp(np.asarray(v), np.asarray(x)), atol=1e-13)


PYMANOPT_SPACES = {
    "symmetric": lambda: theirs.Symmetric(3),
    "skew": lambda: theirs.SkewSymmetric(3),
    "complement": lambda: theirs.SphereSubspaceComplementIntersection(np.eye(3)[:, :1]),
    "positive": lambda: theirs.Positive(2, 2),
}


@pytest.mark.parametrize("name", PYMANOPT_SPACES)
def test_spaces_of_pymanopt_are_wrapped_with_their_retractions(name):
    space = PYMANOPT_SPACES[name]()
    manifold, retraction, _, _ = from_pymanopt(space)
    x = manifold.random_point(jax.random.key(0))
    v = 0.1 * manifold.random_tangent(jax.random.key(1), x)
    assert isinstance(manifold, WrappedManifold)
    np.testing.assert_allclose(retraction(x, v), space.retraction(np.asarray(x), np.asarray(v)), atol=1e-13)


def test_points_that_the_library_takes_for_none_are_refused():
    assert BALL.manifold.contains(np.array([0.3, 0.4]))
    assert "the library" in BALL.manifold.contains(np.array([3.0, 4.0])).reason
