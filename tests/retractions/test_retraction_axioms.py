"""Every retraction satisfies the facts of the conformance kit; the acceleration of one that is of first order."""

from functools import lru_cache

import jax
import numpy as np
import pytest
from hypothesis import given
from retrax.manifolds import SO, EmbeddedMetric
from retrax.retractions import QR, acceleration
from retrax.testing import check_retraction

from tests.support.cases import METRICS, QUICK, RETRACTIONS, order, reach
from tests.support.numerics import SEEDS, compiled, draw_point, draw_tangent

TOLERANCES = {"exponential-SL3": 1e-12}  # far out in the group, where det x = 1 is a sum of products of large numbers


@pytest.mark.parametrize("name", RETRACTIONS)
@pytest.mark.usual(*QUICK)
def test_is_a_retraction(name, seeds):
    claims = {"order": order(name), "metric": METRICS.get(name), "reach": reach(name)}
    check_retraction(RETRACTIONS[name], **claims, seeds=seeds, tolerance=TOLERANCES.get(name, 1e-13))


@lru_cache
def _qr_acceleration(n: int):
    retraction = QR(SO(n))

    def tangential(x: jax.Array, w: jax.Array) -> jax.Array:
        return x.T @ acceleration(retraction, EmbeddedMetric(SO(n)), x, w)

    return compiled(tangential)


@pytest.mark.parametrize("n", [2, 3, 4])
@given(seed=SEEDS)
def test_the_qr_retraction_has_a_tangential_acceleration(n, seed):
    # I + t W = q r gives q'' = -2u with u + u' = -W^2, u upper triangular: the skew part of W^2 with its signs below
    # turned.
    x, _, basis = draw_point(SO(n), seed)
    x, w = (a.reshape(n, n) for a in (x, draw_tangent(np.random.default_rng(seed), basis, 1.0)))
    square = x.T @ w @ x.T @ w
    expected = np.triu(square, 1) - np.tril(square, -1)
    np.testing.assert_allclose(_qr_acceleration(n)(x, w), expected, atol=1e-12)
    assert n == 2 or np.max(np.abs(expected)) > 1e-6
