"""Manifolds that are made from a constraint function."""

from functools import lru_cache
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.manifolds import Euclidean, InvalidInputError, LevelSet, Sphere, Submanifold
from retrax.retractions import Projection

from tests.support.cases import MANIFOLDS
from tests.support.numerics import SEEDS, compiled, draw_point, flat, unflat


@final
class RoundSphere(LevelSet):
    """The unit sphere as a level set."""

    def constraint(self, x):
        return x @ x - 1


@final
class Cone(LevelSet):
    """``x^2 + y^2 = z^2``, no manifold at its apex."""

    def constraint(self, x):
        return x[0] ** 2 + x[1] ** 2 - x[2] ** 2


@final
class Nowhere(LevelSet):
    """``|x|^2 = -1``."""

    def constraint(self, x):
        return x @ x + 1


SAME = compiled(lambda x, a: (RoundSphere(3).projection(x, a), Sphere(2).projection(x, a)))


@lru_cache
def _jacobian(name: str):
    return compiled(lambda x: MANIFOLDS[name].jacobian(unflat(MANIFOLDS[name])(x)))


@given(seed=SEEDS)
def test_the_sphere_as_a_level_set_has_the_tangent_spaces_of_the_sphere(seed):
    x, _, _ = draw_point(Sphere(2), seed)
    a = np.random.default_rng(seed).standard_normal(3)
    np.testing.assert_allclose(*SAME(x, a), atol=1e-14)
    assert RoundSphere(3).contains(x, 1e-14)


@pytest.mark.parametrize("name", ["ellipsoid", "intersection"])
@given(seed=SEEDS)
def test_the_jacobian_annihilates_the_tangent_space(name, seed):
    manifold = MANIFOLDS[name]
    x, v, _ = draw_point(manifold, seed)
    j = _jacobian(name)(x)
    assert j.shape == (x.size - manifold.dimension, x.size)
    np.testing.assert_allclose(j @ v, 0, atol=1e-13)
    assert np.linalg.matrix_rank(j) == len(j)


def test_the_apex_of_a_cone_is_not_a_point_of_a_manifold():
    assert Cone(3).contains(jnp.array([3.0, 4.0, 5.0]))
    verdict = Cone(3).contains(jnp.zeros(3))
    assert not verdict
    assert "rank lost by the constraint's Jacobian is 1" in verdict.reason
    assert verdict.reason.endswith("and take c instead of c**2")


def test_a_level_set_without_points_says_so():
    with pytest.raises(
        InvalidInputError, match=r"no point of Nowhere.* was found from 20 random starts; check its equations"
    ):
        jax.block_until_ready(Nowhere(2).random_point(jax.random.key(0)))


@final
class Two(LevelSet):
    """Equations that are not one array."""

    def constraint(self, x):
        return x[0], x[1]


@final
class TooMany(LevelSet):
    """More equations than numbers."""

    def constraint(self, x):
        return jnp.concatenate([x, x])


@final
class Inside(LevelSet):
    """What is true or false."""

    def constraint(self, x):
        return x @ x < 1


@final
class Alone(LevelSet):
    """A function without self."""

    def constraint(x):
        return x @ x - 1


class Round(LevelSet):
    """A class with a shape of its own, and a number beside it."""

    shape = (3,)
    radius: float

    def constraint(self, x):
        return x @ x - self.radius**2


@final
class Rounder(Round):
    """Its shape is that of the class that it is made of."""


def test_a_class_may_have_the_shape_of_its_points():
    for made in (Round(2.0), Rounder(radius=2.0), Round(2.0, shape=3)):
        assert (made.shape, made.dimension) == ((3,), 2)
        assert made.contains(np.array([0.0, 2.0, 0.0]))
        assert jax.tree.leaves(made) == [2.0]
    assert Round(2.0, shape=(4,)).dimension == 3
    for wrong in (-1, 0.5, "3"):
        with pytest.raises(InvalidInputError, match="a shape is one length or a tuple"):
            Round(2.0, shape=wrong)


def test_equations_that_are_none_are_refused_in_words():
    with pytest.raises(InvalidInputError, match=r"Inside returns real numbers .* got bool; try x @ x - 1"):
        Inside(3)
    with pytest.raises(InvalidInputError, match=r"constraint of Alone must be .*\(self, x\), got .*arguments \(x\)"):
        Alone(3)
    with pytest.raises(InvalidInputError, match=r"the constraint of Two returns an array, got .*try jnp.stack"):
        Two(3)
    with pytest.raises(InvalidInputError, match=r"the constraint of TooMany has 6 equations for points of 3 numbers"):
        TooMany(3)
    with pytest.raises(
        InvalidInputError, match=r"return a vector, one entry an equation, got .*try x\[2:\] instead of x\[2\]"
    ):
        Submanifold(Sphere(2), lambda x: x[2])


@final
class Numpy(LevelSet):
    """A sphere by a function that JAX cannot trace."""

    def constraint(self, x):
        return np.sum(np.square(np.asarray(x))) - 1


def test_equations_written_with_numpy_are_refused_in_words():
    words = r"cannot be traced by JAX \(Tracer.*\); try functions written in jax.numpy"
    with pytest.raises(InvalidInputError, match=f"the constraint of Numpy {words}"):
        Numpy(3)
    with pytest.raises(InvalidInputError, match=f"equations {words}"):
        Submanifold(Sphere(2), lambda x: x[2:] if x[0] > 0 else x[1:2])


def test_the_point_nearby_is_differentiated_in_both_modes():
    curve, rng = MANIFOLDS["curve"], np.random.default_rng(0)
    x, d = np.array([0.6, 0.0, 0.8]), rng.standard_normal(3)
    slope = compiled(lambda x, d: jax.jvp(curve.nearby, (x,), (d,))[1])(x, d)
    pulled = compiled(lambda x, w: jax.vjp(curve.nearby, x)[1](w)[0])(x, np.ones(3))
    difference = (curve.nearby(x + 1e-5 * d) - curve.nearby(x - 1e-5 * d)) / 2e-5
    np.testing.assert_allclose(slope, difference, atol=1e-8)
    np.testing.assert_allclose(pulled @ d, np.sum(slope), atol=1e-13)


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.usual(1)
def test_the_derivative_of_a_basis_is_right_where_gradients_are_unit_vectors(count):
    """Through zero, where they are: that of the projector, in both modes; three equations in space leave no basis."""

    def equations(x):
        return jnp.stack([x[2] - x[0] * x[1], x[1] + jnp.sin(x[0]) ** 2, x[0] + x[1] ** 2])[:count]

    def projected(x):
        frame = Submanifold(Euclidean(3), equations).basis(x)
        return frame.T @ frame

    def exact(x):
        rows = jax.jacfwd(equations)(x)
        return jnp.eye(3) - rows.T @ jnp.linalg.solve(rows @ rows.T, rows)

    slopes = compiled(lambda x: tuple(mode(f)(x) for f in (projected, exact) for mode in (jax.jacfwd, jax.jacrev)))
    for along in (0.0, 1e-300, 1e-20, 1e-9, 1e-3, 0.1):
        forward, backward, expected, _ = slopes(along * np.array([0.6, -0.8, 1.0]))
        np.testing.assert_allclose(forward, expected, atol=1e-13, err_msg=str(along))
        np.testing.assert_allclose(backward, expected, atol=1e-13, err_msg=str(along))


def test_what_no_point_is_near_is_refused_in_words():
    curve = MANIFOLDS["curve"]
    with pytest.raises(InvalidInputError, match=r"of Submanifold\(Sphere\(2\), 1 equation\) has entries that are NaN"):
        curve.nearby(np.array([0.6, np.nan, 0.8]))
    with pytest.raises(InvalidInputError, match=r"shape \(3,\), got \(2,\)"):
        curve.nearby(np.zeros(2))


def test_random_points_differ():
    points = [draw_point(MANIFOLDS["ellipsoid"], seed)[0] for seed in range(4)]
    assert min(np.max(np.abs(flat(a - b))) for i, a in enumerate(points) for b in points[:i]) > 1e-3


@final
class Circle(LevelSet):
    """A great circle of the unit sphere by two equations in units of their own."""

    first: jax.Array
    second: jax.Array

    def constraint(self, x):
        return jnp.stack([self.first * (x @ x - 1.0), self.second * (x[0] + x[1])])


@compiled
def _at_a_point(manifold, x, w, v):
    """A basis of the tangent space, a projection to it, and a point with the way back."""
    moved = Projection(manifold)(x, v)
    return manifold.basis(x), manifold.projection(x, w), moved, Projection(manifold).preimage(x, moved)


@pytest.mark.parametrize(
    "units", [(1e-14, 1e-14), (1e-12, 1e6), (1e-9, 1.0), (1.0, 1.0), (1.0, 1e9), (1e12, 1e-3), (1e14, 1e14)]
)
@pytest.mark.usual(1)
def test_points_are_judged_by_their_distance_in_whatever_units_the_equations_are(units):
    manifold = Circle((3,), *map(jnp.asarray, units))
    x = jnp.array([0.48, -0.48, np.sqrt(1 - 2 * 0.48**2)])
    along = jnp.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    for away in (x, along):
        for distance in (0.0, 1e-12, 1e-10, 1e-9, 1.4e-8, 1.6e-8, 1e-7, 1e-4, 0.3):
            assert bool(manifold.contains(x + distance * away)) == (distance < 1.5e-8)
    expected, w = np.cross(along, x), np.array([0.3, 0.2, -0.7])
    basis, projected, moved, back = _at_a_point(manifold, x, w, 0.2 * expected)
    assert np.abs(np.abs(basis[0] @ expected) - 1) < 1e-12
    assert np.abs(projected - expected * (expected @ w)).max() < 1e-12
    assert np.abs(moved - (x + 0.2 * expected) / np.sqrt(1.04)).max() < 1e-12
    assert np.abs(back - 0.2 * expected).max() < 1e-12


@pytest.mark.parametrize("unit", [1e-14, 1e-9, 1.0, 1e9])
def test_points_of_a_submanifold_are_judged_by_their_distance(unit):
    manifold = Submanifold(Euclidean(3), lambda x: unit * jnp.stack([x @ x - 1.0]))
    for distance in (0.0, 1e-10, 1.4e-8, 1.6e-8, 1e-4, 0.3):
        assert bool(manifold.contains(jnp.array([0.6, 0.8, 0.0]) * (1 + distance))) == (distance < 1.5e-8)
