"""Closed forms of the differentiated retraction and of its adjoint, beside automatic differentiation."""

from functools import lru_cache

import jax
import numpy as np
import pytest
from hypothesis import given
from retrax.retractions import DifferentiatedRetraction
from retrax.testing.checks.derivatives import flat_retraction

from tests.support.cases import RETRACTIONS, reach
from tests.support.numerics import FRACTIONS, SEEDS, compiled, draw_point, draw_tangent, flat, unflat

CLOSED_FORMS = {name: retraction for name, retraction in RETRACTIONS.items() if isinstance(retraction, DifferentiatedRetraction)}


@lru_cache
def _derivatives(name):
    retraction = CLOSED_FORMS[name]
    move, back = flat_retraction(retraction), unflat(retraction.manifold)

    def facts(x, v, w, c):
        _, pull = jax.vjp(lambda v: move(x, v), v)
        by_hand = retraction.fibre_derivative(*map(back, (x, v, w))), retraction.fibre_adjoint(*map(back, (x, v, c)))
        pulled = retraction.manifold.projection(back(x), back(pull(c)[0]))
        return *map(flat, by_hand), jax.jvp(lambda v: move(x, v), (v,), (w,))[1], flat(pulled)

    return compiled(facts)


@pytest.mark.parametrize("name", CLOSED_FORMS)
@given(seed=SEEDS, fraction=FRACTIONS)
def test_closed_forms_are_the_derivatives(name, seed, fraction):
    x, _, frame = draw_point(CLOSED_FORMS[name].manifold, seed)
    rng = np.random.default_rng(seed)
    v, w = draw_tangent(rng, frame, fraction * reach(name)), draw_tangent(rng, frame, 1.0)
    c = rng.standard_normal(x.size)
    pushed, pulled, forward, reverse = _derivatives(name)(x, v, w, c)
    np.testing.assert_allclose(pushed, forward, rtol=0, atol=1e-14 * (1 + np.max(np.abs(forward))))
    np.testing.assert_allclose(pulled, reverse, rtol=0, atol=1e-14 * (1 + np.max(np.abs(reverse))))
