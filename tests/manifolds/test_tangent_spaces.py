"""Points, tangent spaces, projections and bases of every manifold."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.manifolds import Manifold
from retrax.manifolds.numerics import ambient as vec

from tests.support.cases import MANIFOLDS
from tests.support.numerics import SEEDS, ambient_size, compiled, draw_point, flat, unflat

DIMENSIONS = {
    "R2x3": 6,
    "S2": 2,
    "S4": 4,
    "SO2": 1,
    "SO3": 3,
    "SO4": 6,
    "SE3": 6,
    "U2": 4,
    "SU2": 3,
    "SL2": 3,
    "heisenberg": 3,
    "ellipsoid": 2,
    "intersection": 2,
    "SO3*R3": 6,
    "(SO3*R3)*S2": 8,
    "T*S2": 4,
    "TSO3": 6,
    "St42": 5,
    "St33": 3,
    "Gr42": 4,
    "Gr31": 2,
    "oblique32": 4,
    "rank2-4x3": 10,
    "rank1-3x3": 5,
}
DISTANCES = 2.0 ** -np.arange(5, 15)

every_manifold = pytest.mark.parametrize("name", MANIFOLDS)


def max_violation(manifold: Manifold, x: Any) -> jax.Array:
    """Largest violation of the manifold's equations; 0 where there are none."""
    return jnp.max(jnp.stack([jnp.zeros(()), *map(jnp.asarray, manifold.violations(x).values())]))


@lru_cache
def _kernel(name: str) -> Callable:
    """One compiled function a manifold, from which each test reads the numbers it is about."""
    manifold, unravel = MANIFOLDS[name], unflat(MANIFOLDS[name])

    def facts(x: jax.Array, a: jax.Array) -> dict[str, jax.Array]:
        point = unravel(x)
        projected = jax.vmap(lambda e: flat(manifold.projection(point, unravel(e))))
        projector = projected(jnp.eye(a.size)).T
        normal = a - projector @ a
        unit = normal / jnp.linalg.norm(normal)

        def after_restoring(distance: jax.Array) -> jax.Array:
            return max_violation(manifold, manifold.restore(unravel(x + distance * a)))

        return {
            "projector": projector,
            "basis": vec.flatten_frame(manifold.basis(point)),
            "restored": flat(manifold.restore(point)) - x,
            "off": jax.vmap(lambda d: max_violation(manifold, unravel(x + d * unit)))(jnp.array([0.0, 0.01, 0.1])),
            "after restoring": jax.vmap(after_restoring)(DISTANCES),
        }

    return compiled(facts)


def facts_at(name: str, seed: int) -> dict[str, np.ndarray]:
    """The facts of a manifold at a random point and for a random ambient unit vector."""
    x, _, _ = draw_point(MANIFOLDS[name], seed)
    a = np.random.default_rng(seed).standard_normal(x.size)
    return _kernel(name)(x, a / np.linalg.norm(a))


@pytest.mark.parametrize(("name", "dimension"), DIMENSIONS.items())
def test_dimension(name: str, dimension: int) -> None:
    assert MANIFOLDS[name].dimension == dimension


@every_manifold
@given(seed=SEEDS)
def test_random_points_are_on_the_manifold_and_random_tangents_are_tangent(name, seed):
    manifold = MANIFOLDS[name]
    x, v, _ = draw_point(manifold, seed)
    point, tangent = map(unflat(manifold), (x, v))
    where = manifold.contains(point, 1e-12)
    assert where, where.reason
    tangent = manifold.is_tangent(point, tangent, 1e-12)
    assert tangent, tangent.reason


@every_manifold
@given(seed=SEEDS)
def test_projection_is_an_orthogonal_projector_of_rank_n(name, seed):
    p = facts_at(name, seed)["projector"]
    np.testing.assert_allclose(p @ p, p, atol=1e-13)
    np.testing.assert_allclose(p, p.T, atol=1e-13)
    assert np.linalg.matrix_rank(p, tol=1e-8) == MANIFOLDS[name].dimension


@every_manifold
@given(seed=SEEDS)
def test_basis_is_orthonormal_and_spans_the_image_of_the_projection(name, seed):
    facts = facts_at(name, seed)
    e = facts["basis"]
    assert e.shape == (MANIFOLDS[name].dimension, ambient_size(MANIFOLDS[name]))
    np.testing.assert_allclose(e @ e.T, np.eye(len(e)), atol=1e-13)
    np.testing.assert_allclose(e.T @ e, facts["projector"], atol=1e-13)


@every_manifold
@given(seed=SEEDS)
def test_restore_is_the_identity_on_the_manifold(name, seed):
    np.testing.assert_allclose(facts_at(name, seed)["restored"], 0, atol=1e-14)


@every_manifold
@given(seed=SEEDS)
def test_restore_makes_an_error_of_first_order_one_of_second(name, seed):
    # A bound in place of a slope: along some directions the error changes sign, which no power of the distance does.
    violations = facts_at(name, seed)["after restoring"]
    np.testing.assert_array_less(violations, 10 * DISTANCES**2)


@pytest.mark.parametrize("name", [name for name in MANIFOLDS if name != "R2x3"])
@given(seed=SEEDS)
def test_violations_grow_off_the_manifold(name, seed):
    on, near, far = facts_at(name, seed)["off"]
    assert on < 1e-12
    assert near > 1e-4
    assert far > 5 * near


def wrong_points(manifold: Manifold) -> dict[str, tuple[Any, str]]:
    """Points that are no points, each with words that the answer must have."""
    x = unflat(manifold)(draw_point(manifold, 1)[0])
    leaves, structure = jax.tree.flatten(x)
    nan = jax.tree.unflatten(structure, [leaves[0].at[(0,) * leaves[0].ndim].set(jnp.nan), *leaves[1:]])
    short = jax.tree.unflatten(structure, [leaves[0][..., 1:], *leaves[1:]])
    return {
        "shape": (short, f"where {leaves[0][..., 1:].shape} came"),
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
    assert "where () came" in manifold.is_tangent(x, 1.0).reason
    assert "NaN" in manifold.is_tangent(x, x * jnp.nan).reason


def test_the_tolerance_of_contains_is_the_one_asked_for():
    x = jnp.array([1.0 + 1e-5, 0.0, 0.0])
    assert not MANIFOLDS["S2"].contains(x)
    assert MANIFOLDS["S2"].contains(x, 1e-4)
