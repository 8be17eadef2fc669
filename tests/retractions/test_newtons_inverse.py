"""Inverses of retractions by Newton's method, and their derivatives."""

from collections.abc import Callable
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.retractions.retraction import newton_preimage
from retrax.testing.checks.derivatives import flat_retraction

from tests.support.cases import REPRESENTATIVES, RETRACTIONS, reach
from tests.support.numerics import (
    CENTRAL_NODES,
    FRACTIONS,
    SEEDS,
    compiled,
    differences,
    draw_point,
    draw_tangent,
    flat,
    unflat,
)

# Spacing of the differences: the error of order 6 and the rounding divided by it are both below 1e-10.
STEP = 2e-3

Vector = jax.Array


@lru_cache
def _newton(name: str) -> Callable:
    retraction = RETRACTIONS[name]
    move, unravel = flat_retraction(retraction), unflat(retraction.manifold)

    def facts(x: Vector, v: Vector) -> tuple:
        y = move(x, v)
        return flat(newton_preimage(retraction, unravel(x), unravel(y)))

    return compiled(facts)


def newton_inverse(name: str, seed: int, length: float) -> tuple[np.ndarray, np.ndarray]:
    """A random tangent vector of this length, and what Newton's method finds from its value."""
    x, _, frame = draw_point(RETRACTIONS[name].manifold, seed)
    v = draw_tangent(np.random.default_rng(seed), frame, length)
    return v, _newton(name)(x, v)


@lru_cache
def _newton_derivatives(name: str) -> Callable:
    retraction = RETRACTIONS[name]
    move, unravel = flat_retraction(retraction), unflat(retraction.manifold)

    def facts(x: Vector, v: Vector, a: Vector, c: Vector) -> dict:
        y = move(x, v)
        # The velocity of a curve through y: any tangent vector there.
        b = jax.jvp(lambda v: move(x, v), (v,), (a,))[1]

        def between(s: Vector) -> Vector:
            """The inverse between the points ``R(x, s_0 a)`` and ``R(y, s_1 b)``."""
            return flat(newton_preimage(retraction, unravel(move(x, s[0] * a)), unravel(move(y, s[1] * b))))

        lines = jnp.eye(2)[:, None, :] * (STEP * CENTRAL_NODES)[None, :, None]
        return {
            "forward": jax.jacfwd(between)(jnp.zeros(2)),
            "reverse": jax.grad(lambda s: c @ between(s))(jnp.zeros(2)),
            "values": jax.vmap(jax.vmap(between))(lines),
        }

    return compiled(facts)


def newton_derivatives(name: str, seed: int, length: float) -> dict:
    """Derivatives of Newton's inverse along curves of both points, and its values on them."""
    x, _, frame = draw_point(RETRACTIONS[name].manifold, seed)
    rng = np.random.default_rng(seed)
    v, a, c = draw_tangent(rng, frame, length), draw_tangent(rng, frame, 1.0), rng.standard_normal(x.size)
    return {"c": c, **_newton_derivatives(name)(x, v, a, c)}


@pytest.mark.parametrize("name", REPRESENTATIVES)
@pytest.mark.usual("exponential-S2", "qr-SO4")
@given(seed=SEEDS, fraction=FRACTIONS)
def test_newtons_method_finds_the_inverse_too(name, seed, fraction):
    v, found = newton_inverse(name, seed, fraction * min(1.0, reach(name)))
    np.testing.assert_allclose(found, v, atol=1e-13)


@pytest.mark.parametrize("name", ["exponential-S2", pytest.param("qr-SO3", marks=pytest.mark.slow)])
@given(seed=SEEDS, fraction=FRACTIONS)
def test_newtons_inverse_is_differentiated_by_the_implicit_function_theorem(name, seed, fraction):
    facts = newton_derivatives(name, seed, 0.2 * fraction)
    by_differences = np.stack([differences(line, STEP) for line in facts["values"]])
    np.testing.assert_allclose(facts["forward"].T, by_differences, atol=1e-8)
    np.testing.assert_allclose(facts["reverse"], facts["c"] @ facts["forward"], atol=1e-12)
