"""Inverses of the retractions of matrix manifolds, from short tangent vectors to the edges of their domains and beyond."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.manifolds import DomainError, FixedRank, Grassmann, Oblique, Stiefel
from retrax.retractions import QR, Cayley, Columnwise, Exponential, FixedRankOrthographic, Polar, Projection

from tests.support.matrices import draw, kernel, round_trip

LENGTHS = [0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.1, 1.0, 2.0, 3.0, 3.1, np.pi - 1e-4]


@pytest.mark.parametrize("length", LENGTHS)
def test_the_logarithm_of_frames_is_exact_below_the_injectivity_radius(length):
    # Where the exponential is nearly singular, near pi, the rounding of the point is magnified by 1 / sin.
    for seed in range(3):
        x, v = draw(Stiefel(3, 2), seed, length)
        y, back, there = round_trip(Exponential(Stiefel(3, 2)), x, v)
        np.testing.assert_allclose(back, v, atol=2e-14)
        np.testing.assert_allclose(there, y, atol=1e-14)


def test_the_logarithm_of_frames_reaches_the_edge_of_its_domain():
    # One column turns by almost a half turn, the shortest way to a conjugate point.
    for gap in (1e-2, 1e-5, 1e-8):
        x, v = np.eye(3)[:, :2], np.zeros((3, 2))
        v[2, 0] = np.pi - gap
        y, back, there = round_trip(Exponential(Stiefel(3, 2)), x, v)
        np.testing.assert_allclose(there, y, atol=1e-13)
        assert np.linalg.norm(back) == pytest.approx(np.pi - gap, abs=1e-13)
        np.testing.assert_allclose(back, v, atol=1e-14 / gap)


# The rational retractions send tangent vectors of any length t into their images, with edges at t = infinity: a rounding of
# v by eps t is one of y by eps t, and a rounding of y by eps is magnified to eps t^2.
SIZES = [1e-12, 1e-6, 1.0, 1e2, 1e4, 1e8]
GRADED = {"polar": Polar(Stiefel(4, 2)), "QR": QR(Stiefel(4, 2)), "Cayley": Cayley(Stiefel(4, 2))}


@pytest.mark.parametrize("name", GRADED)
@pytest.mark.parametrize("size", SIZES)
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
    inverse = kernel(retraction)(x, np.zeros_like(x), y)[3]
    # The other column has an inverse of its own.
    assert np.all(np.isnan(inverse[:, 0] if isinstance(retraction, Columnwise) else inverse))


@pytest.mark.parametrize("name", ["QR, a half turn", "the same, polar", "an orthogonal column"])
def test_outside_the_image_the_inverse_says_so(name):
    retraction, x, y = OUTSIDE[name]
    with pytest.raises(DomainError, match=rf"outside the image of {type(retraction).__name__} .* take a nearer point"):
        retraction.inverse(jnp.asarray(x), jnp.asarray(y))
