"""The conformance kit in single precision: what is right passes, what is wrong is caught, what rounding hides is not
decided."""

from typing import final

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.manifolds import (
    SO,
    SPD,
    AffineInvariantMetric,
    Euclidean,
    Grassmann,
    LeftInvariantMetric,
    Manifold,
    Simplex,
    Sphere,
    Stiefel,
)
from retrax.retractions import QR, Cayley, CotangentLift, Exponential, Midpoint, Polar, Projection, Retraction
from retrax.testing import (
    check_cotangent_lift,
    check_discretization_map,
    check_lie_group,
    check_manifold,
    check_metric,
    check_retraction,
)
from retrax.testing.draws import Sampler

from .mutants import MUTANTS

TOLERANCE = 450 * float(jnp.finfo(jnp.float32).eps)  # as many roundings as are allowed in double precision, 1e-13

# Made in single precision: some have arrays. The slow ones have other closed forms, or take longer to compile.
OBJECTS = {
    "SO(3)": lambda: check_lie_group(SO(3), tolerance=TOLERANCE),
    "inertia": lambda: check_metric(LeftInvariantMetric(SO(3), [1.0, 2.0, 3.0]), tolerance=TOLERANCE),
    "projection of S2": lambda: check_retraction(Projection(Sphere(2)), order=2, reach=3.0, tolerance=TOLERANCE),
    "midpoint": lambda: check_discretization_map(Midpoint(Exponential(Sphere(2))), symmetric=True, tolerance=TOLERANCE),
}
SLOW_OBJECTS = {
    "Gr(4, 2)": lambda: check_manifold(Grassmann(4, 2), tolerance=TOLERANCE),
    "Cayley of SO(3)": lambda: check_retraction(Cayley(SO(3)), order=2, reach=3.0, tolerance=TOLERANCE),
    "SPD(2)": lambda: check_manifold(SPD(2), tolerance=TOLERANCE),
    "exponential of SO(3)": lambda: check_retraction(Exponential(SO(3)), order=2, reach=3.0, tolerance=TOLERANCE),
    "exponential of SO(4)": lambda: check_retraction(Exponential(SO(4)), order=2, reach=3.0, tolerance=TOLERANCE),
    "polar of St(4, 2)": lambda: check_retraction(Polar(Stiefel(4, 2)), order=2, reach=3.0, tolerance=TOLERANCE),
    "QR of St(4, 2)": lambda: check_retraction(QR(Stiefel(4, 2)), reach=3.0, tolerance=TOLERANCE),
    "exponential of SPD(2)": lambda: check_retraction(
        Exponential(SPD(2)), order=2, metric=AffineInvariantMetric(SPD(2)), reach=3.0, tolerance=TOLERANCE
    ),
    "Cayley of Gr(4, 2)": lambda: check_retraction(Cayley(Grassmann(4, 2)), order=2, reach=2.5, tolerance=TOLERANCE),
    "lift": lambda: check_cotangent_lift(
        CotangentLift(Midpoint(Projection(Sphere(2)))), symmetric=True, tolerance=TOLERANCE
    ),
}


@pytest.mark.parametrize("name", [*OBJECTS, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW_OBJECTS)])
@pytest.mark.usual(1)
def test_what_is_right_in_double_precision_is_right_in_single(name):
    with jax.enable_x64(False):
        report = {**OBJECTS, **SLOW_OBJECTS}[name]()
    assert all(outcome.status in ("holds", "not applicable") for outcome in report.outcomes), report


# One of each kind of object by default, all of the others with the slow tests.
QUICK_MUTANTS = (
    "violations that are squared",
    "a momentum with another sign than the generators",
    "a metric with twice the energy",
    "an inverse that is wrong near the edge of its domain",
    "a map with a wrong `theta`",
)


@pytest.mark.parametrize("name", QUICK_MUTANTS)
@pytest.mark.usual(1)
def test_a_mutant_is_caught(name):
    check, subject, options = MUTANTS[name]
    with jax.enable_x64(False):
        assert check(subject, throw=False, **options).failures


@pytest.mark.slow
def test_every_other_mutant_is_caught():
    missed = []
    for name in set(MUTANTS) - set(QUICK_MUTANTS):
        check, subject, options = MUTANTS[name]
        with jax.enable_x64(False):
            missed += [] if check(subject, throw=False, **options).failures else [name]
    assert not missed


@final
class Stretched(Retraction):
    """``R(x, v) = x + (1 + c) v``."""

    manifold: Manifold
    c: float

    def retract(self, x: Array, v: Array) -> Array:
        return x + (1 + self.c) * v

    def preimage(self, x: Array, y: Array) -> Array:
        return (y - x) / (1 + self.c)

    def domain(self, x: Array, v: Array) -> Array:
        return jnp.all(jnp.isfinite(v))


@pytest.mark.parametrize(
    ("c", "single", "double"),
    [(0.0, "holds", "holds"), (1e-6, "holds", "fails"), (4e-4, "not decided", "fails"), (1e-2, "fails", "fails")],
)
@pytest.mark.usual(1)
def test_an_error_that_rounding_hides_is_not_decided(c, single, double):
    name = "error_against_the_straight_line_is_of_second_order"
    (found,) = check_retraction(Stretched(Euclidean(2), c), only=name, seeds=[0], throw=False).outcomes
    assert found.status == double
    with jax.enable_x64(False):
        report = check_retraction(Stretched(Euclidean(2), c), only=name, seeds=[0], throw=False)
    assert report.outcomes[0].status == single
    assert ("not decided in single precision: the errors of most lengths are below rounding" in str(report)) == (
        c == 4e-4
    )
    assert ("1 not decided" in str(report)) == (c == 4e-4)


@pytest.mark.parametrize("precision", [True, False], ids=["double", "single"])
@pytest.mark.parametrize("manifold", [Simplex(3), SPD(2), Sphere(2)], ids=str)
@pytest.mark.usual(2)
def test_a_point_near_another_is_a_point_however_near_the_edge_of_an_inequality(manifold, precision):
    with jax.enable_x64(precision):
        sampler = Sampler(manifold)
        x = sampler.point(0)[0]
        for distance in np.geomspace(1e-3, 10.0, 25):
            y = sampler.near(x, np.random.default_rng(0), distance)
            assert manifold.contains(sampler.unflat(jnp.asarray(y)))
            assert 0 < np.linalg.norm(y - x) <= 2 * distance
