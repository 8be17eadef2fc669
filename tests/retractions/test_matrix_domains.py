"""Inverses of the retractions of matrix manifolds, from short tangent vectors to the edges of their domains and
beyond."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.manifolds import ComplexStiefel, DomainError, FixedRank, Grassmann, Oblique, Stiefel
from retrax.manifolds.numerics import ambient as vec
from retrax.manifolds.numerics.frames import qr_factor
from retrax.retractions import (
    QR,
    Cayley,
    Columnwise,
    Exponential,
    FixedRankOrthographic,
    Midpoint,
    Polar,
    Projection,
    Retraction,
    StiefelCanonicalExponential,
)
from scipy.optimize import brentq

from tests.support.matrices import draw, inverse, round_trip
from tests.support.numerics import SEEDS, compiled

LENGTHS = [0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.1, 1.0, 2.0, 3.0, 3.1, np.pi - 1e-4]


@pytest.mark.parametrize("manifold", [Stiefel(3, 2), ComplexStiefel(3, 2)], ids=str)
@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.usual(2)
def test_the_logarithm_of_frames_is_exact_below_the_injectivity_radius(manifold, length):
    # Where the exponential is nearly singular, near pi, the rounding of the point is magnified by 1 / sin.
    for seed in range(3):
        x, v = draw(manifold, seed, length)
        y, back, there = round_trip(Exponential(manifold), x, v)
        np.testing.assert_allclose(back, v, atol=2e-14)
        np.testing.assert_allclose(there, y, atol=1e-14)


@pytest.mark.parametrize("size", [(5, 2), (3, 2), pytest.param((6, 3), marks=pytest.mark.slow)])
@pytest.mark.parametrize("length", [0.0, 1e-12, 1e-6, 1e-3, 1.0, 2.0, np.sqrt(0.8) * np.pi - 1e-8])
@pytest.mark.usual(2)
def test_the_canonical_logarithm_of_frames_is_exact_in_its_domain(size, length):
    for seed in range(3):
        x, v = draw(Stiefel(*size), seed, 1.0)
        v = v * length / np.sqrt(np.sum(v * v) - np.sum((x.T @ v) ** 2) / 2)
        y, back, there = round_trip(StiefelCanonicalExponential(Stiefel(*size)), x, v)
        np.testing.assert_allclose(back, v, atol=2e-14)
        np.testing.assert_allclose(there, y, atol=1e-14)


@pytest.mark.parametrize("family", [Polar, QR])
def test_inverses_on_many_columns(family):
    x, v = draw(Stiefel(40, 30), 0, 5.0)
    _, back, _ = round_trip(family(Stiefel(40, 30)), x, v)
    np.testing.assert_allclose(back, v, atol=1e-13)


@pytest.mark.parametrize(
    ("manifold", "place", "unit"), [(Stiefel(3, 2), 2, 1), (ComplexStiefel(3, 2), 2, 1j), (ComplexStiefel(3, 2), 0, 1j)]
)
def test_the_logarithm_of_frames_reaches_the_edge_of_its_domain(manifold, place, unit):
    # One column turns by almost a half turn, the shortest way to a conjugate point, or in its phase, to a cut point.
    for gap in (1e-2, 1e-5, 1e-8):
        x, v = np.eye(3, 2, dtype=manifold.ambient.dtype), np.zeros((3, 2), manifold.ambient.dtype)
        v[place, 0] = (np.pi - gap) * unit
        y, back, there = round_trip(Exponential(manifold), x, v)
        np.testing.assert_allclose(there, y, atol=1e-13)
        assert np.linalg.norm(back) == pytest.approx(np.pi - gap, abs=1e-13)
        np.testing.assert_allclose(back, v, atol=1e-14 / gap)


# The rational retractions send tangent vectors of any length t into their images, with edges at t = infinity: a
# rounding of v by eps t is one of y by eps t, and a rounding of y by eps is magnified to eps t^2.
SIZES = [1e-12, 1e-6, 1.0, 1e2, 1e4, 1e8]
GRADED = {"polar": Polar(Stiefel(4, 2)), "QR": QR(Stiefel(4, 2)), "Cayley": Cayley(Stiefel(4, 2))}


@pytest.mark.parametrize("name", GRADED)
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.usual(2)
def test_inverses_on_frames_are_exact_up_to_the_edge_of_the_image(name, size):
    retraction = GRADED[name]
    for seed in range(3):
        rng = np.random.default_rng(seed)
        q, turn = (np.linalg.qr(rng.standard_normal((k, k)))[0] for k in (4, 2))
        second = 0.4 * min(size, 1.0)
        x = q[:, :2] @ turn
        v = (q[:, :2] @ np.array([[0.0, -second], [second, 0.0]]) + q[:, 2:] @ np.diag([size, second])) @ turn
        y, back, there = round_trip(retraction, x, v)
        np.testing.assert_allclose(y.T @ y, np.eye(2), atol=2e-15 * (1 + size))
        np.testing.assert_allclose(there, y, atol=1e-14 * (1 + size**2 * (name == "Cayley")) + 2e-15 * size)
        np.testing.assert_allclose(back, v, atol=2e-15 + 1e-15 * size**2 * (1 + size * (name == "Cayley")))


EDGES = {
    "Grassmann exponential": (Exponential(Grassmann(4, 2)), np.pi / 2),
    "Grassmann Cayley": (Cayley(Grassmann(4, 2)), 2.0),
}


@pytest.mark.parametrize("name", EDGES)
@pytest.mark.parametrize("gap", [1e-8, 1e-6, 1e-3, 1.0])
@pytest.mark.usual(2)
def test_inverses_on_subspaces_are_exact_up_to_the_edge_of_the_domain(name, gap):
    retraction, edge = EDGES[name]
    for seed, second in enumerate((1e-12, 0.3, 1.2)):
        q = np.linalg.qr(np.random.default_rng(seed).standard_normal((4, 4)))[0]
        x, b = q[:, :2] @ q[:, :2].T, q[:, 2:] @ np.diag([edge - gap, second]) @ q[:, :2].T
        y, back, there = round_trip(retraction, x, b + b.T)
        assert retraction.domain(x, b + b.T)
        assert not retraction.domain(x, (b + b.T) * (edge + 1e-8) / (edge - gap))
        np.testing.assert_allclose(back, b + b.T, atol=1e-14)
        np.testing.assert_allclose(there, y, atol=1e-14)


BOUNDS = {
    # The longest v, in units of the smallest singular value of x, that the perturbation bounds keep in the domain.
    "projection": (Projection(FixedRank(4, 3, 2)), 0.5),
    "orthographic": (FixedRankOrthographic(FixedRank(4, 3, 2)), 1.0),
}


@pytest.mark.parametrize("name", BOUNDS)
@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e6])
@given(seed=SEEDS)
@pytest.mark.usual(2)
def test_vectors_shorter_than_the_rank_allows_are_in_the_domain_in_any_unit(name, unit, seed):
    retraction, bound = BOUNDS[name]
    x, v = draw(retraction.manifold, seed, 1.0)
    x = unit * x
    v = v * (1 - 1e-3) * bound * np.linalg.svd(x)[1][1] / np.linalg.norm(v, 2)
    inside, back = fixed_rank_facts(name)(x, v)
    assert inside
    np.testing.assert_allclose(back, v, atol=1e-13 * unit)


@lru_cache
def fixed_rank_facts(name):
    retraction = BOUNDS[name][0]
    return compiled(lambda x, v: (retraction.domain(x, v), retraction.preimage(x, retraction(x, v))))


FIRST_TWO = np.eye(4, 3) @ np.diag([1.0, 1.0, 0.0])


def shrinking(t):
    """A tangent vector at ``FIRST_TWO``: the second singular value shrinks, columns and rows turn from the first
    axis."""
    v = np.zeros((4, 3))
    v[1, 1], v[0, 2], v[2, 0] = -t, 0.8 * t, 0.7 * t
    return v


def gap(t):
    """Second singular value of ``FIRST_TWO + shrinking(t)`` less the third: zero where 1 - t is that of the other
    block."""
    other = np.linalg.svd(np.array([[1.0, 0.8 * t], [0.7 * t, 0.0]]))[1][1]
    return 1 - t - other


def test_the_domain_of_the_projection_ends_where_the_nearest_matrix_changes():
    # Beyond the edge the nearest matrix has columns and rows orthogonal to the second ones of x.
    edge = brentq(gap, 0.0, 1.0, xtol=1e-15)
    facts = fixed_rank_facts("projection")
    inside, back = facts(FIRST_TWO, shrinking(edge - 1e-8))
    assert inside
    np.testing.assert_allclose(back, shrinking(edge - 1e-8), atol=1e-13)
    for t in (edge + 1e-8, 1.0, 2.0):
        inside, back = facts(FIRST_TWO, shrinking(t))
        assert not inside
        assert np.all(np.isnan(back))


def test_the_domain_of_the_orthographic_retraction_lacks_isolated_multiples_of_a_vector():
    v = np.array([[0.0, 0.3, 0.8], [-0.2, -0.5, 0.4], [0.7, 0.1, 0.0], [0.2, 0.6, 0.0]])
    multiples = -1 / np.linalg.eigvals(v[:2, :2])
    assert np.all(np.isreal(multiples))
    facts = fixed_rank_facts("orthographic")
    for t in multiples.real:
        assert not facts(FIRST_TWO, t * v)[0]
        for near in (t * (1 - 1e-6), t * (1 + 1e-6)):
            inside, back = facts(FIRST_TWO, near * v)
            assert inside
            # The value is of the size of 1e6.
            np.testing.assert_allclose(back, near * v, atol=1e-8)
    assert facts(FIRST_TWO, 1e3 * v)[0]


HALF = np.diag([-1.0, 1.0, 1.0, 1.0])[:, :2]
OUTSIDE = {
    "polar, beyond a right angle": (
        Polar(Stiefel(4, 2)),
        np.eye(4)[:, :2],
        np.array([[-0.6, 0.0], [0.0, 1.0], [0.8, 0.0], [0.0, 0.0]]),
    ),
    "polar, a half turn": (Polar(Stiefel(4, 2)), np.eye(4)[:, :2], HALF),
    "QR, a half turn": (QR(Stiefel(4, 2)), np.eye(4)[:, :2], HALF),
    "QR, a right angle": (QR(Stiefel(4, 2)), np.eye(4)[:, :2], np.eye(4)[:, 1:3]),
    "Cayley, a half turn": (Cayley(Stiefel(4, 2)), np.eye(4)[:, :2], HALF),
    "complex polar, a right angle": (Polar(ComplexStiefel(2, 1)), np.eye(2, 1) + 0j, 1j * np.eye(2, 1)),
    "complex QR, a right angle": (QR(ComplexStiefel(2, 1)), np.eye(2, 1) + 0j, 1j * np.eye(2, 1)),
    "complex Cayley, a half turn": (Cayley(ComplexStiefel(2, 1)), np.eye(2, 1) + 0j, -np.eye(2, 1) + 0j),
    "exponential, the antipodal frame": (Exponential(Stiefel(3, 2)), np.eye(3)[:, :2], -np.eye(3)[:, :2]),
    "subspaces with a right angle": (Exponential(Grassmann(4, 2)), np.diag([1.0, 1, 0, 0]), np.diag([0.0, 1, 1, 0])),
    "the same, Cayley": (Cayley(Grassmann(4, 2)), np.diag([1.0, 1, 0, 0]), np.diag([0.0, 1, 1, 0])),
    "the same, polar": (Polar(Grassmann(4, 2)), np.diag([1.0, 1, 0, 0]), np.diag([0.0, 1, 1, 0])),
    "an orthogonal column": (
        Projection(Oblique(3, 2)),
        np.eye(3)[:, :2],
        np.eye(3)[:, 1:],
    ),
    "a matrix with other columns": (
        FixedRankOrthographic(FixedRank(4, 3, 2)),
        np.eye(4, 3) @ np.diag([1.0, 1, 0]),
        np.eye(4, 3) @ np.diag([0.0, 1, 1]),
    ),
    "the same, projection": (
        Projection(FixedRank(4, 3, 2)),
        np.eye(4, 3) @ np.diag([1.0, 1, 0]),
        np.eye(4, 3) @ np.diag([0.0, 1, 1]),
    ),
    # x + v has then a singular value larger than those of y, beyond them.
    "a matrix turned too far": (
        Projection(FixedRank(4, 3, 2)),
        np.eye(4, 3) @ np.diag([1.0, 1, 0]),
        np.eye(4, 3) @ (np.diag([1.0, 0, 0]) + np.outer([0, 0.6, 0.8], [0, 0.6, -0.8])),
    ),
}


@pytest.mark.parametrize("name", OUTSIDE)
def test_outside_the_image_the_inverse_is_nan(name):
    retraction, x, y = OUTSIDE[name]
    found = inverse(retraction, x, y)
    # The other column has an inverse of its own.
    assert np.all(np.isnan(found[:, 0] if isinstance(retraction, Columnwise) else found))


@pytest.mark.parametrize("name", ["QR, a half turn", "the same, polar", "an orthogonal column"])
@pytest.mark.usual(1)
def test_outside_the_image_the_inverse_says_so(name):
    retraction, x, y = OUTSIDE[name]
    with pytest.raises(DomainError, match=rf"outside the image of {type(retraction).__name__} .* take a nearer point"):
        retraction.inverse(jnp.asarray(x), jnp.asarray(y))


@lru_cache
def _midpoint_of_subspaces(retraction: Retraction):
    """Midpoints of subspaces with given principal angles: how far the inverse's values are from the points, and its
    vector."""
    midpoint = Midpoint(retraction)

    def facts(key: jax.Array, angles: jax.Array) -> tuple[jax.Array, ...]:
        q = qr_factor(jax.random.normal(key, (4, 4)))
        frame = q[:, :2] * jnp.cos(angles) + q[:, 2:] * jnp.sin(angles)
        ends = q[:, :2] @ q[:, :2].T, frame @ frame.T
        x, v = midpoint.preimage(*ends)
        return vec.size(vec.subtract(midpoint(x, v), ends)), jnp.linalg.svd(v, compute_uv=False)[0]

    return compiled(jax.vmap(jax.vmap(facts, (0, None)), (None, 0)))


@pytest.mark.parametrize("double", [True, False], ids=["double", "single"])
@pytest.mark.parametrize("family", [Cayley, pytest.param(Polar, marks=pytest.mark.slow)])
@pytest.mark.usual(1)
def test_the_midpoint_of_subspaces_is_nan_where_the_cosine_of_an_angle_is_rounding(family, double):
    # Through the right angle at all distances: an angle beyond it is that of nearer points, as subspaces have no
    # orientation.
    with jax.enable_x64(double):
        eps = float(jnp.finfo(jnp.zeros(()).dtype).eps)
        gaps = np.geomspace(eps, 1.0, 30)
        first = np.concatenate([np.pi / 2 - gaps, np.pi / 2 + gaps])
        angles = jnp.asarray(np.stack([first, np.full(60, 0.3)], axis=1))
        missed, length = _midpoint_of_subspaces(family(Grassmann(4, 2)))(
            jax.random.split(jax.random.key(0), 10), angles
        )
    gaps, known = np.tile(gaps, 2), np.isfinite(length)
    assert np.all(known[gaps > 5 * eps**0.5])
    assert not np.any(known[gaps < 3 * eps**0.5])
    assert np.max(missed[known]) < eps**0.5
    turned = np.broadcast_to(np.minimum(first, np.pi - first)[:, None], length.shape)
    expected = {Cayley: 4 * np.tan(turned / 4), Polar: 2 * np.tan(turned / 2)}[family]
    assert np.max(np.abs(length - expected)[known]) < 4 * eps**0.5
