"""Every manifold satisfies the facts of the conformance kit; dimensions, and what is said of wrong points."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from retrax.manifolds import Manifold, MatrixLieGroup
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import default_retraction
from retrax.testing import check_lie_group, check_manifold

from tests.support.cases import MANIFOLDS
from tests.support.numerics import draw_point, unflat

DIMENSIONS = {
    "R2x3": 6,
    "S2": 2,
    "S4": 4,
    "SO2": 1,
    "SO3": 3,
    "SO4": 6,
    "SE2": 3,
    "SE3": 6,
    "U2": 4,
    "U3": 9,
    "SU2": 3,
    "SU3": 8,
    "SL2": 3,
    "SL3": 8,
    "heisenberg": 3,
    "ellipsoid": 2,
    "intersection": 2,
    "SO3*R3": 6,
    "(SO3*R3)*S2": 8,
    "T*S2": 4,
    "TSO3": 6,
    "St42": 5,
    "St33": 3,
    "CSt32": 8,
    "CSt11": 1,
    "Gr42": 4,
    "Gr31": 2,
    "oblique32": 4,
    "rank2-4x3": 10,
    "rank1-3x3": 5,
}


@pytest.mark.parametrize(("name", "dimension"), DIMENSIONS.items())
def test_dimension(name: str, dimension: int) -> None:
    assert MANIFOLDS[name].dimension == dimension


@pytest.mark.parametrize("name", MANIFOLDS)
@pytest.mark.usual(4)
def test_is_a_manifold(name, seeds):
    check = check_lie_group if isinstance(MANIFOLDS[name], MatrixLieGroup) else check_manifold
    check(MANIFOLDS[name], seeds=seeds, tolerance=1e-13)


def wrong_points(manifold: Manifold) -> dict[str, tuple[Any, str]]:
    """Points that are no points, each with words that the answer must have."""
    x = unflat(manifold)(draw_point(manifold, 1)[0])
    leaves, structure = jax.tree.flatten(x)
    nan = jax.tree.unflatten(structure, [leaves[0].at[(0,) * leaves[0].ndim].set(jnp.nan), *leaves[1:]])
    short = jax.tree.unflatten(structure, [leaves[0][..., 1:], *leaves[1:]])
    return {
        "shape": (short, f", got {leaves[0][..., 1:].shape}"),
        "structure": ({"x": x}, "has the structure"),
        "nan": (nan, "NaN or infinite"),
        "off": (jax.tree.map(lambda leaf: 1.01 * leaf + 0.1, x), "expected at most"),
    }


@pytest.mark.parametrize("kind", ["shape", "structure", "nan", "off"])
@pytest.mark.parametrize("name", ["S2", "SO3", "ellipsoid", "(SO3*R3)*S2", "T*S2"])
def test_contains_says_in_words_what_is_wrong(name, kind):
    manifold = MANIFOLDS[name]
    point, words = wrong_points(manifold)[kind]
    verdict = manifold.contains(point)
    assert not verdict
    assert words in verdict.reason
    assert str(manifold) in verdict.reason


@pytest.mark.parametrize("name", ["S2", "SO3", "ellipsoid"])
def test_is_tangent_says_in_words_what_is_wrong(name):
    manifold = MANIFOLDS[name]
    x = unflat(manifold)(draw_point(manifold, 1)[0])
    assert "relative normal part" in manifold.is_tangent(x, x + 0.1).reason
    assert not manifold.is_tangent(x, x + 0.1)
    assert ", got float" in manifold.is_tangent(x, 1.0).reason
    assert "NaN" in manifold.is_tangent(x, x * jnp.nan).reason


def test_the_tolerance_of_contains_is_the_one_asked_for():
    x = jnp.array([1.0 + 1e-5, 0.0, 0.0])
    assert not MANIFOLDS["S2"].contains(x)
    assert MANIFOLDS["S2"].contains(x, 1e-4)


@pytest.mark.parametrize("name", MANIFOLDS)
@pytest.mark.usual(2)
def test_the_derivative_of_a_basis_is_the_derivative_of_its_values(name):
    """So dynamics ``u @ basis(q)``, with controls as coordinates, is a function like any other."""
    manifold = MANIFOLDS[name]
    x, retraction = unflat(manifold)(draw_point(manifold, 1)[0]), default_retraction(manifold)
    v = vec.combine(manifold.basis(x), jnp.cos(jnp.arange(manifold.dimension)))
    v = vec.scale(0.3 / vec.size(v), v)

    def frame(s):
        return ravel_pytree(manifold.basis(retraction(x, vec.scale(s, v))))[0]

    at, h = jax.jit(frame), 1e-4
    differences = (8 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h)
    np.testing.assert_allclose(jax.jvp(frame, (0.0,), (1.0,))[1], differences, atol=1e-10)
