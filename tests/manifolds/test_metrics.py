"""Metrics: covectors and vectors, energies, and what leaves them invariant."""

from functools import lru_cache

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.manifolds import (
    SPD,
    AffineInvariantMetric,
    CanonicalMetric,
    EmbeddedMetric,
    Hyperbolic,
    LorentzMetric,
    Metric,
    Sphere,
    Stiefel,
)

from tests.support.numerics import SEEDS, compiled, draw_point, draw_tangent, unflat

METRICS: dict[str, Metric] = {
    "embedded-S2": EmbeddedMetric(Sphere(2)),
    "Lorentz-H3": LorentzMetric(Hyperbolic(3)),
    "affine-SPD3": AffineInvariantMetric(SPD(3)),
    "canonical-St42": CanonicalMetric(Stiefel(4, 2)),
}


@lru_cache
def _kernel(name: str):
    metric = METRICS[name]

    def facts(x, v, w):
        p = metric.covector(x, v)
        return {
            "inner": metric.inner_product(x, v, w),
            "square": metric.inner_product(x, v, v),
            "pairing": jnp.sum(p * w),
            "energy": metric.kinetic_energy(x, p),
            "back": metric.vector(x, p),
            "acted": jnp.stack([metric.inner_product(2.0 * x, 2.0 * v, 2.0 * w)]),
        }

    return compiled(facts)


def facts_at(name: str, seed: int) -> dict:
    """The facts of a metric at a random point, with the two tangent vectors."""
    manifold, rng = METRICS[name].manifold, np.random.default_rng(seed)
    x, _, basis = draw_point(manifold, seed)
    x, v, w = map(unflat(manifold), (x, draw_tangent(rng, basis, 1.0), draw_tangent(rng, basis, 2.0)))
    return {"x": np.asarray(x), "v": np.asarray(v), "w": np.asarray(w), **_kernel(name)(x, v, w)}


@pytest.mark.parametrize("name", METRICS)
@given(seed=SEEDS)
def test_covectors_and_vectors_are_each_other_s_through_the_metric(name, seed):
    facts = facts_at(name, seed)
    np.testing.assert_allclose(facts["pairing"], facts["inner"], rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(facts["back"], facts["v"], atol=1e-11)
    np.testing.assert_allclose(facts["energy"], facts["square"] / 2, rtol=1e-11)
    assert facts["square"] > 0


@given(seed=SEEDS)
def test_the_lorentz_metric_is_the_lorentz_form(seed):
    facts = facts_at("Lorentz-H3", seed)
    form = facts["v"] @ np.diag([-1.0, 1, 1, 1]) @ facts["w"]
    np.testing.assert_allclose(facts["inner"], form, atol=1e-13 * (1 + facts["x"] @ facts["x"]))


@given(seed=SEEDS)
def test_the_affine_invariant_metric_is_its_formula_and_does_not_see_scale(seed):
    facts = facts_at("affine-SPD3", seed)
    inverse = np.linalg.inv(facts["x"])
    np.testing.assert_allclose(facts["inner"], np.trace(inverse @ facts["v"] @ inverse @ facts["w"]), atol=1e-13)
    np.testing.assert_allclose(facts["acted"], [facts["inner"]], atol=1e-13)
