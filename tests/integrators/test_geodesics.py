"""Exponential maps by symplectic integration, beside closed forms."""

from functools import lru_cache
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from retrax.integrators import KAHAN_LI_8, Composition, GeodesicRetraction, SymplecticIntegrator
from retrax.manifolds import (
    SO,
    SPD,
    AffineInvariantMetric,
    EmbeddedMetric,
    InvalidInputError,
    LeftInvariantMetric,
    Metric,
    Sphere,
    hat,
    vee,
)
from retrax.retractions import Cayley, CotangentLift, Exponential, Midpoint, Projection, Retraction, SPDSecondOrder
from retrax.testing import check_retraction
from scipy.linalg import expm

from tests.support.cases import Ellipsoid
from tests.support.numerics import CENTRAL_NODES, SEEDS, compiled, differences, draw_point, draw_tangent, unflat

LENGTHS = 2.0 ** -np.arange(3)


@final
class Central(Retraction):
    """``x + v`` scaled to the ellipsoid: cheap to compile."""

    manifold: Ellipsoid

    def retract(self, x, v):
        y = x + v
        return y / jnp.sqrt(1 + self.manifold.constraint(y))


def geodesics(retraction: Retraction, metric: Metric | None = None) -> GeodesicRetraction:
    """Geodesics in four steps of order 4, by the lifted midpoint method with a retraction."""
    integrator = Composition(SymplecticIntegrator(CotangentLift(Midpoint(retraction))))
    metric = EmbeddedMetric(retraction.manifold) if metric is None else metric
    return GeodesicRetraction(metric, steps=4, integrator=integrator)


TOP = np.array([1.0, 1.0, 2.0])
GEODESICS = {
    "sphere": geodesics(Projection(Sphere(2))),
    "rotations": geodesics(Cayley(SO(3))),
    "symmetric top": geodesics(Cayley(SO(3)), LeftInvariantMetric(SO(3), TOP)),
    "cone": geodesics(SPDSecondOrder(SPD(2)), AffineInvariantMetric(SPD(2))),
    "ellipsoid": geodesics(Central(Ellipsoid())),
}


@lru_cache
def _kernel(name: str):
    exponential = GEODESICS[name]
    metric, unravel = exponential.metric, unflat(exponential.manifold)

    def facts(x, v):
        def ended(length):
            w = unravel(length * v)
            end = exponential.flow(unravel(x), metric.covector(unravel(x), w))
            energy = metric.kinetic_energy(end.q, end.p) - metric.inner_product(unravel(x), w, w) / 2
            violations = exponential.manifold.violations(end.q)
            return {"end": end.q, "energy": energy, "solved": end.converged, "violations": violations}

        return jax.vmap(ended)(LENGTHS)

    return compiled(facts)


def facts_at(name: str, seed: int) -> dict:
    """Ends of geodesics of lengths 1, 1/2 and 1/4 from a random point, and the exact ends where they are known."""
    manifold = GEODESICS[name].manifold
    x, _, basis = draw_point(manifold, seed)
    v = draw_tangent(np.random.default_rng(seed), basis, 1.0)
    facts = _kernel(name)(x, v)
    if name != "ellipsoid":
        x, v = unflat(manifold)(x), unflat(manifold)(v)
        exact = spun if name == "symmetric top" else Exponential(manifold)
        facts["exact"] = np.stack([exact(x, length * v) for length in LENGTHS])
    return facts


def spun(x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Attitude of a free symmetric top after unit time: it turns with its angular momentum, and spins back about its
    axis."""
    omega = np.asarray(vee(x.T @ v))
    back = np.array([0.0, 0.0, (TOP[0] - TOP[2]) * omega[2]])
    return x @ expm(np.asarray(hat(TOP * omega))) @ expm(np.asarray(hat(back)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sphere", "rotations", "symmetric top", "cone"])
@settings(max_examples=4)
@given(seed=SEEDS)
@pytest.mark.usual("sphere")
def test_geodesics_are_exponentials_to_order_four(name, seed):
    # Unit time in 4 steps of order 4: the error is proportional to the fifth power of the length.
    facts = facts_at(name, seed)
    errors = np.max(np.abs(facts["end"] - facts["exact"]), axis=(1, 2) if name != "sphere" else 1)
    assert np.all(facts["solved"])
    assert errors[0] < 1e-3
    assert np.all(np.log2(errors[:-1] / errors[1:])[errors[1:] > 1e-12] > 4)
    np.testing.assert_allclose(max(map(np.max, facts["violations"].values())), 0, atol=1e-14)


@pytest.mark.slow
def test_the_energy_of_geodesics_of_an_ellipsoid_is_conserved_to_order_four():
    """The worst of ten geodesics: on a single one a coefficient may vanish at or between two lengths."""
    facts = [facts_at("ellipsoid", seed) for seed in range(10)]
    assert all(np.all(geodesic["solved"]) for geodesic in facts)
    energy = np.max([np.abs(geodesic["energy"]) for geodesic in facts], axis=0)
    assert energy[0] < 1e-2
    assert np.log2(energy[0] / energy[2]) > 10, "the sixth power of the length, as the energy itself is quadratic in it"


@lru_cache
def _round_trip():
    exponential = GEODESICS["sphere"]
    return compiled(lambda x, v: (exponential.inverse(x, exponential(x, v)), exponential(x, 0 * v)))


@settings(max_examples=4)
@given(seed=SEEDS)
@pytest.mark.slow
def test_newtons_method_finds_the_initial_velocity(seed):
    x, _, basis = draw_point(Sphere(2), seed)
    v = draw_tangent(np.random.default_rng(seed), basis, 1.0)
    back, rest = _round_trip()(x, v)
    np.testing.assert_allclose(back, v, atol=1e-13)
    np.testing.assert_allclose(rest, x, atol=1e-15)


@pytest.mark.slow
def test_the_exponential_of_an_embedded_metric_conforms(seeds):
    check_retraction(GEODESICS["ellipsoid"], order=2, reach=0.3, seeds=seeds[:3])


@pytest.mark.slow
def test_second_derivatives_forward_over_forward_are_those_of_differences():
    # Also off the tangent bundle, and at v = 0.
    exponential, rng = GEODESICS["sphere"], np.random.default_rng(0)
    x, d, e = np.eye(3)[0], *rng.standard_normal((2, 2, 3))

    def along(z):
        return jax.jvp(lambda z: exponential(*z), (z,), (d,))[1]

    first, second = compiled(along), compiled(lambda z: jax.jvp(along, (z,), (e,))[1])
    for v in (0 * x, np.array([0.0, 0.3, 0.1])):
        z = np.stack([x, v])
        expected = differences(np.stack([first(z + s * e) for s in 2e-3 * CENTRAL_NODES]), 2e-3)
        np.testing.assert_allclose(second(z), expected, atol=1e-10)


@pytest.mark.slow
def test_the_default_accuracy_is_the_one_stated():
    metric = EmbeddedMetric(Ellipsoid())
    fine = Composition(SymplecticIntegrator(CotangentLift(Midpoint(Central(Ellipsoid())))), KAHAN_LI_8)
    exponential, exact = compiled(GeodesicRetraction(metric)), compiled(GeodesicRetraction(metric, 60, fine))
    for length, stated in ((1.0, 7e-5), (0.1, 1.5e-9)):
        errors = []
        for seed in range(10):
            x, _, basis = draw_point(Ellipsoid(), seed)
            v = draw_tangent(np.random.default_rng(seed), basis, length)
            errors.append(np.max(np.abs(exponential(x, v) - exact(x, v))))
        assert stated / 10 < max(errors) < 2 * stated


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((Sphere(2),), "takes a metric, got Sphere"),
        ((EmbeddedMetric(Sphere(2)), 0), "steps must be a whole number of at least 1, got 0"),
        ((EmbeddedMetric(SO(3)), 8, GEODESICS["sphere"].integrator), "need an integrator of it"),
    ],
)
def test_what_geodesics_are_made_of_is_checked(arguments, words):
    with pytest.raises(InvalidInputError, match=words):
        GeodesicRetraction(*arguments)
