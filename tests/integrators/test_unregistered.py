"""A manifold that no family of retractions knows: states, controls and guesses on it."""

from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem, solve
from retrax.manifolds import Euclidean, Manifold, Sphere
from retrax.retractions import Addition, Exponential, Midpoint, ProjectionByNewton, Retraction, default_retraction
from retrax.testing import check_retraction

from tests.support.numerics import norm

SPHERE, SPACE = Sphere(2), Euclidean(3)


@final
class Directions(Manifold):
    """The unit vectors of space, in a class of its own."""

    dimension = 2

    @property
    def ambient(self) -> Any:
        return SPHERE.ambient

    def projection(self, x: Array, a: Array) -> Array:
        return SPHERE.projection(x, a)

    def basis(self, x: Array) -> Array:
        return SPHERE.basis(x)

    def restore(self, x: Array) -> Array:
        return SPHERE.restore(x)

    def violations(self, x: Array) -> dict[str, Array]:
        return SPHERE.violations(x)

    def random_point(self, key: Array) -> Array:
        return SPHERE.random_point(key)


@final
class Rescaling(Retraction):
    manifold: Directions

    def retract(self, x: Array, v: Array) -> Array:
        return (x + v) / jnp.linalg.norm(x + v)


DIRECTIONS = Directions()


def test_newton_steps_of_a_manifold_make_a_retraction():
    assert check_retraction(ProjectionByNewton(DIRECTIONS))
    assert isinstance(default_retraction(DIRECTIONS), ProjectionByNewton)
    x = DIRECTIONS.random_point(jax.random.key(0))
    assert np.all(np.isnan(ProjectionByNewton(DIRECTIONS)(x, -x)))  # from the centre they lead nowhere


@pytest.mark.slow
def test_the_default_guess_follows_the_retraction_that_was_given():
    """Through a quarter turn, where the plane of the rescaling ends, to half a turn."""
    turning = OptimalControlProblem(DIRECTIONS, DIRECTIONS.projection, lambda q, u: u @ u / 2, 3)
    for degrees in (1, 89.9, 90.1, 180):
        a = np.deg2rad(degrees)
        end = np.array([np.cos(a), np.sin(a), 0.0])
        solution = solve(turning, np.array([1.0, 0.0, 0.0]), end, 1.0, method=Midpoint(Rescaling(DIRECTIONS)), steps=10)
        assert solution.cost == pytest.approx(a * a / 2, rel=0.02)


@pytest.mark.slow
def test_controls_on_it_are_steered():
    """``H = p . u - (u - e)^2 / 2 - q^2 / 2`` is largest at the unit vector along ``p + e``."""
    e = jnp.array([0.0, 0.0, 1.0])
    aimed = OptimalControlProblem(SPACE, lambda q, u: u, lambda q, u: (u - e) @ (u - e) / 2 + q @ q / 2, DIRECTIONS)
    solution = solve(aimed, np.array([1.0, 0.0, 0.0]), None, 1.0, method=Midpoint(Addition(SPACE)), steps=10)
    along = solution.stage_costates + e
    assert norm(solution.controls - along / np.linalg.norm(along, axis=1, keepdims=True)) < 1e-9


def test_a_family_that_knows_a_manifold_comes_first():
    assert default_retraction(SPHERE) == Exponential(SPHERE)
