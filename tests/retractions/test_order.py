"""The order of retractions, measured, and the constructions that change it or keep it."""

from functools import lru_cache
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.manifolds import SO, Hyperbolic, LorentzMetric, Simplex, Sphere
from retrax.retractions import (
    QR,
    Cayley,
    Exponential,
    ProductRetraction,
    Projection,
    RestoredAfter,
    Retraction,
    SecondOrder,
    measured_order,
)

from tests.support.cases import METRICS, RETRACTIONS
from tests.support.numerics import SEEDS, compiled, draw_point, draw_tangent


@final
class Scaled(Retraction):
    """``R(x, 1.01 v)``, which is no retraction."""

    manifold: Sphere

    def retract(self, x, v):
        return Exponential(self.manifold)(x, 1.01 * v)


@final
class Moved(Retraction):
    """A map that does not take zero to the base point."""

    manifold: Sphere

    def retract(self, x, v):
        return Exponential(self.manifold)(x, v + self.manifold.projection(x, jnp.array([0.1, 0.0, 0.0])))


@final
class Upright(Retraction):
    """``x + v`` moved to hyperbolic space along the time axis."""

    manifold: Hyperbolic

    def retract(self, x, v):
        return self.manifold.restore(x + v)


SOFTMAX = Exponential(Simplex(2))
ORDERS = {
    "qr": (QR(SO(3)), 1),
    "corrected qr": (SecondOrder(QR(SO(3))), 2),
    "stabilized Cayley": (RestoredAfter(Cayley(SO(3))), 2),
    "softmax and projection": (ProductRetraction(SOFTMAX, Projection(Sphere(2))), 1),
    "corrected softmax and projection": (ProductRetraction(SecondOrder(SOFTMAX), Projection(Sphere(2))), 2),
    "correction of a product": (SecondOrder(ProductRetraction(SOFTMAX, Projection(Sphere(2)))), 2),
    "scaled": (Scaled(Sphere(2)), 0),
    "moved": (Moved(Sphere(2)), 0),
}


@pytest.mark.parametrize("name", ORDERS)
@pytest.mark.usual(1)
def test_the_order_is_measured(name):
    retraction, expected = ORDERS[name]
    measured = measured_order(retraction)
    assert measured.order == expected, measured
    assert expected == 0 or abs(measured.slope - expected - 1) < 0.1
    assert expected < 2 or measured.acceleration < 1e-12


@pytest.mark.parametrize("name", ["projection-H2", "quadratic-SPD2", "cayley-St42"])
@pytest.mark.usual("projection-H2")
def test_order_two_belongs_to_a_metric(name):
    assert measured_order(RETRACTIONS[name]).order == 1
    measured = measured_order(RETRACTIONS[name], METRICS[name])
    assert measured.order == 2, measured


@pytest.mark.slow
def test_a_retraction_is_corrected_for_any_metric():
    retraction, lorentz = Upright(Hyperbolic(2)), LorentzMetric(Hyperbolic(2))
    assert measured_order(retraction, lorentz).order == 1
    assert measured_order(SecondOrder(retraction, lorentz), lorentz).order == 2


def test_the_order_at_a_point_is_the_order_there():
    # For entries 1/3 and v = (1, -1, 0) the acceleration of x exp(v/x) is 3 (1, 1, -2)/3; for two entries of 1/2 it is
    # none.
    measured = measured_order(SOFTMAX, at=(jnp.full(3, 1 / 3), jnp.array([1.0, -1.0, 0.0])))
    assert measured.order == 1
    np.testing.assert_allclose(measured.acceleration, 1.0, rtol=1e-12)
    assert measured_order(Exponential(Simplex(1)), at=(jnp.full(2, 0.5), jnp.array([1.0, -1.0]))).order == 2


def test_the_correction_takes_half_the_acceleration():
    # As above, a = (1, 1, -2).
    x, v = jnp.full(3, 1 / 3), jnp.array([1.0, -1.0, 0.0])
    np.testing.assert_allclose(compiled(SecondOrder(SOFTMAX).bent)(x, v), v - np.array([1, 1, -2]) / 2, atol=1e-14)


@lru_cache
def _corrected():
    retraction = SecondOrder(QR(SO(3)))
    return compiled(lambda x, v: (retraction(x, v), retraction.inverse(x, retraction(x, v))))


@given(seed=SEEDS)
def test_the_correction_is_inverted(seed):
    x, _, basis = draw_point(SO(3), seed)
    v = draw_tangent(np.random.default_rng(seed), basis, 0.5).reshape(3, 3)
    y, back = _corrected()(x.reshape(3, 3), v)
    assert SO(3).contains(y, 1e-13)
    np.testing.assert_allclose(back, v, atol=1e-13)


def test_long_products_stay_on_the_manifold():
    # A thousand steps: unstabilised products lose a digit or two, stabilised ones none.
    plain = Exponential(SO(4))
    v = jnp.asarray(np.triu(np.ones((4, 4)), 1) - np.tril(np.ones((4, 4)), -1))

    def defects(retraction):
        x = jax.lax.fori_loop(0, 1000, lambda _, x: retraction(x, x @ v), jnp.eye(4))
        return jnp.max(jnp.abs(x.T @ x - jnp.eye(4)))

    wandering, kept = compiled(lambda _: (defects(plain), defects(RestoredAfter(plain))))(0)
    assert kept < 3e-15
    assert wandering > 10 * kept
