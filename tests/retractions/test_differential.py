"""Differentiated retractions and their adjoints, closed forms against automatic differentiation."""

from collections.abc import Callable
from functools import lru_cache

import jax
import numpy as np
import pytest
from hypothesis import example, given
from retrax.retractions import adjoint, differentiated

from tests.support.cases import RETRACTIONS, reach
from tests.support.numerics import FRACTIONS, SEEDS, compiled, draw_point, draw_tangent, flat, unflat
from tests.support.retractions import flat_retraction

NAMES = (
    "projection-S2",
    "cayley-SO3",
    "exponential-(SO3*R3)*S2",
    "quadratic-SPD2",
    "projection-S2x3",
    "polar-St42",
    "qr-St42",
    "cayley-St42",
)


@lru_cache
def _kernel(name: str) -> Callable:
    retraction = RETRACTIONS[name]
    move, unravel = flat_retraction(retraction), unflat(retraction.manifold)

    def facts(x: jax.Array, v: jax.Array, w: jax.Array, xi: jax.Array) -> dict:
        given = unravel(x), unravel(v)
        return {
            "push": flat(differentiated(retraction, *given, unravel(w))),
            "jvp": jax.jvp(lambda u: move(x, u), (v,), (w,))[1],
            "pull": flat(adjoint(retraction, *given, unravel(xi))),
        }

    return compiled(facts)


@pytest.mark.parametrize("name", NAMES)
@given(seed=SEEDS, fraction=FRACTIONS)
@example(seed=0, fraction=0.0)
def test_the_adjoint_pairs_as_the_derivative_does(name, seed, fraction):
    manifold, rng = RETRACTIONS[name].manifold, np.random.default_rng(seed)
    x, _, basis = draw_point(manifold, seed)
    v, w = draw_tangent(rng, basis, fraction * min(1.0, reach(name))), draw_tangent(rng, basis, 1.0)
    xi = rng.standard_normal(x.size)
    facts = _kernel(name)(x, v, w, xi)
    scale = 1 + np.linalg.norm(facts["push"])
    np.testing.assert_allclose(facts["push"], facts["jvp"], atol=1e-12 * scale)
    np.testing.assert_allclose(facts["push"] @ xi, w @ facts["pull"], atol=1e-12 * scale)
    np.testing.assert_allclose(basis.T @ (basis @ facts["pull"]), facts["pull"], atol=1e-12 * scale)
