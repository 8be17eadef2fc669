"""The swing-up of a pendulum on a cart with least effort, from the default guess."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Solution, solve
from retrax.manifolds import Euclidean, Sphere
from retrax.retractions import Exponential, Midpoint

from .problems import half_square

GRAVITY = 9.81
LINE, CIRCLE = Euclidean(4), Sphere(1) * Euclidean(3)


class CartPole(eqx.Module):
    """Masses of the cart and of the bob, and length of the rod; the angle is 0 where the bob hangs."""

    cart: jax.Array
    bob: jax.Array
    length: jax.Array

    def accelerations(self, s: jax.Array, c: jax.Array, w: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Of the cart and of the angle, from its sine and cosine."""
        inertia = self.cart + self.bob * s * s
        pull, weight = self.bob * self.length * w * w * s, (self.cart + self.bob) * GRAVITY * s
        a = (u[0] + pull + self.bob * GRAVITY * s * c) / inertia
        return a, -(u[0] * c + pull * c + weight) / (self.length * inertia)

    def on_the_line(self, q: jax.Array, u: jax.Array) -> jax.Array:
        _, angle, v, w = q
        return jnp.stack([v, w, *self.accelerations(jnp.sin(angle), jnp.cos(angle), w, u)])

    def on_the_circle(self, q: tuple, u: jax.Array) -> tuple:
        (c, s), (_, v, w) = q
        return w * jnp.stack([-s, c]), jnp.stack([v, *self.accelerations(s, c, w, u)])


RIGS = [(1.0, 0.1, 0.5), (1.0, 0.3, 0.5), (1.0, 0.3, 1.0), (2.0, 0.5, 0.5), (0.5, 0.2, 0.3), (1.0, 1.0, 1.0)]
SHORT, LONG = (1.5, 2.0), (2.5, 3.0, 4.0)


def swing_up(rig: tuple[float, ...], horizon: float, steps: int, circle: bool) -> Solution:
    system = CartPole(*map(jnp.asarray, rig))
    if circle:
        problem = OptimalControlProblem(CIRCLE, system.on_the_circle, half_square, 1)
        ends = (np.array([1.0, 0.0]), np.zeros(3)), (np.array([-1.0, 0.0]), np.zeros(3))
    else:
        problem = OptimalControlProblem(LINE, system.on_the_line, half_square, 1)
        ends = np.zeros(4), np.array([0.0, np.pi, 0.0, 0.0])
    return solve(problem, *ends, horizon, method=Midpoint(Exponential(problem.manifold)), steps=steps, throw=False)


@pytest.mark.parametrize(("rig", "horizon"), [*zip(RIGS, itertools.cycle(SHORT)), *zip(RIGS, itertools.cycle(LONG))])
@pytest.mark.usual(2)
def test_a_swing_up_converges_within_the_default_limit(rig, horizon):
    assert swing_up(rig, horizon, 50, circle=False).success


@pytest.mark.slow
@pytest.mark.parametrize("circle", [False, True])
@pytest.mark.parametrize(("rig", "horizon"), list(itertools.product(RIGS, (1.5, 2.0, 2.5, 3.0))))
def test_a_finer_swing_up_converges_within_the_default_limit(rig, horizon, circle):
    assert swing_up(rig, horizon, 80, circle).success
