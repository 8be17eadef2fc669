"""Closed forms of the differentiated retraction and of its adjoint, beside automatic differentiation."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.manifolds import Simplex
from retrax.retractions import DifferentiatedRetraction, Exponential
from retrax.testing.checks.derivatives import flat_retraction

from tests.support.cases import RETRACTIONS, reach
from tests.support.numerics import FRACTIONS, SEEDS, compiled, draw_point, draw_tangent, flat, unflat

CLOSED_FORMS = {
    name: retraction for name, retraction in RETRACTIONS.items() if isinstance(retraction, DifferentiatedRetraction)
}


@lru_cache
def _derivatives(name):
    retraction = CLOSED_FORMS[name]
    move, back = flat_retraction(retraction), unflat(retraction.manifold)

    def facts(x, v, w, c):
        _, pull = jax.vjp(lambda v: move(x, v), v)
        by_hand = (
            retraction.fibre_derivative(*map(back, (x, v, w))),
            retraction.differential_adjoint(*map(back, (x, v, c))),
        )
        pulled = retraction.manifold.projection(back(x), back(pull(c)[0]))
        return *map(flat, by_hand), jax.jvp(lambda v: move(x, v), (v,), (w,))[1], flat(pulled)

    return compiled(facts)


@pytest.mark.parametrize("name", CLOSED_FORMS)
@given(seed=SEEDS, fraction=FRACTIONS)
@pytest.mark.usual(2)
def test_closed_forms_are_the_derivatives(name, seed, fraction):
    x, _, frame = draw_point(CLOSED_FORMS[name].manifold, seed)
    rng = np.random.default_rng(seed)
    v, w = draw_tangent(rng, frame, fraction * reach(name)), draw_tangent(rng, frame, 1.0)
    c = rng.standard_normal(x.size)
    pushed, pulled, forward, reverse = _derivatives(name)(x, v, w, c)
    np.testing.assert_allclose(pushed, forward, rtol=0, atol=1e-14 * (1 + np.max(np.abs(forward))))
    np.testing.assert_allclose(pulled, reverse, rtol=0, atol=1e-14 * (1 + np.max(np.abs(reverse))))


def test_derivatives_on_the_simplex_keep_their_digits_however_far_one_entry_prevails():
    # y = 1 / (1 + e^-gap) and 1 - y, by gap = v_1 / x_1 - v_2 / x_2 = 4 c of the vector (c, -c) at (1/2, 1/2).
    retraction, x, gaps = Exponential(Simplex(1)), np.array([0.5, 0.5]), np.linspace(-600.0, 600.0, 241)

    def along(c):
        return retraction(x, jnp.stack([c, -c]))

    first, second = compiled(jax.vmap(lambda c: (jax.jacfwd(along)(c), jax.jacfwd(jax.jacrev(along))(c))))(gaps / 4)
    small = np.exp(-np.abs(gaps))
    slope = 4 * small / (1 + small) ** 2
    curvature = -4 * slope * np.sign(gaps) * (1 - small) / (1 + small)
    for found, expected in ((first, slope), (second, curvature)):
        np.testing.assert_allclose(found, np.stack([expected, -expected], axis=1), rtol=1e-12, atol=1e-300)
