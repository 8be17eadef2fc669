"""Metrics: covectors and vectors, energies, and what leaves them invariant."""

from functools import lru_cache

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.manifolds import (
    SL,
    SO,
    SPD,
    AffineInvariantMetric,
    CanonicalMetric,
    EmbeddedMetric,
    Hyperbolic,
    LeftInvariantMetric,
    LorentzMetric,
    Metric,
    PowerMetric,
    ProductMetric,
    ScaledMetric,
    Sphere,
    Stiefel,
)
from retrax.testing import check_metric

from tests.support.numerics import SEEDS, compiled, draw_point, draw_tangent, unflat


def translated(x):
    """A rotation from the left."""
    return jnp.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]) @ x


def congruent(x):
    """A congruence ``a x a'``."""
    a = jnp.array([[1.0, 0.5, 0.0], [0.0, 2.0, -0.3], [0.1, 0.0, 0.7]])
    return a @ x @ a.T


def boosted(x):
    """A Lorentz transformation in the plane of the first two axes."""
    c, s = 1.25, 0.75
    return jnp.stack([c * x[0] + s * x[1], s * x[0] + c * x[1], x[2], x[3]])


# Each with an isometry, and the checks that it has all that a metric has.
METRICS: dict[str, tuple[Metric, dict]] = {
    "embedded-S2": (EmbeddedMetric(Sphere(2)), {"rotation": translated}),
    "Lorentz-H3": (LorentzMetric(Hyperbolic(3)), {"boost": boosted}),
    "affine-SPD3": (AffineInvariantMetric(SPD(3)), {"congruence": congruent}),
    "canonical-St32": (CanonicalMetric(Stiefel(3, 2)), {"rotation": translated}),
    "left-invariant-SO3": (LeftInvariantMetric(SO(3), [1.0, 2.0, 3.0]), {"left translation": translated}),
    "left-invariant-SL2": (LeftInvariantMetric(SL(2), np.diag([1.0, 2.0, 3.0]) + 0.1), {}),
    "sum-SO3*S2": (
        ProductMetric(LeftInvariantMetric(SO(3), [1.0, 2.0, 3.0]), ScaledMetric(EmbeddedMetric(Sphere(2)), 1e-6)),
        {},
    ),
    "power-S2": (PowerMetric(EmbeddedMetric(Sphere(2)), 2), {}),
}


QUICK = ("Lorentz-H3", "affine-SPD3")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK)) for name in METRICS]
)
def test_is_a_metric(name, seeds):
    metric, isometries = METRICS[name]
    check_metric(metric, isometries=isometries, seeds=seeds, tolerance=1e-13)


@lru_cache
def _kernel(name: str):
    metric = METRICS[name][0]

    def facts(x, v, w):
        inner = metric.inner_product(x, v, w)
        return {"inner": inner, "acted": jnp.stack([metric.inner_product(2.0 * x, 2.0 * v, 2.0 * w)])}

    return compiled(facts)


def facts_at(name: str, seed: int) -> dict:
    """The facts of a metric at a random point, with the two tangent vectors."""
    manifold, rng = METRICS[name][0].manifold, np.random.default_rng(seed)
    x, _, basis = draw_point(manifold, seed)
    x, v, w = map(unflat(manifold), (x, draw_tangent(rng, basis, 1.0), draw_tangent(rng, basis, 2.0)))
    return {"x": np.asarray(x), "v": np.asarray(v), "w": np.asarray(w), **_kernel(name)(x, v, w)}


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
