"""Every cotangent lift satisfies the facts of the conformance kit; closed forms, inverses, wrong arguments."""

from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given
from retrax.manifolds import CotangentBundle, Euclidean, InvalidInputError, Sphere
from retrax.retractions import BundleRetraction, CotangentLift, Exponential, Midpoint, SphereExponential, Theta
from retrax.retractions.discretization import newton_preimage
from retrax.testing import check_cotangent_lift
from retrax.testing.checks.cotangent_lift import omega_of_both_ends, tangent_lift_of_omega
from retrax.testing.checks.discretization import both_ends, flat_ends
from retrax.testing.numerics import ambient_size

from tests.support.cases import LIFTED_MAPS, RETRACTIONS, THETAS, FreeTheta, reach
from tests.support.numerics import SEEDS, compiled, draw_bundle_tangent, flat, norm, unflat

EQUIVARIANT = ("S2", "S4", "SO2", "SO3", "SO4", "St42")


LARGE = (
    "nearest-ellipsoid",
    "exponential-(SO3*R3)*S2",
    "polar-St42",
    "projection-S4",
    "cayley-Gr42",
    "qr-SO4",
    "exponential-SO3",
    "cayley-SO2",
    "cayley-SO4",
)


def marked(name: str):
    repeated = name in ("theta=0.0, exponential-S2", "theta=1.0, exponential-S2", "two, cayley-SO3")
    return pytest.param(name, marks=pytest.mark.slow) if repeated or name.split(", ")[-1] in LARGE else name


@pytest.mark.parametrize("name", [marked(name) for name in LIFTED_MAPS])
@pytest.mark.long(
    "theta=0.3, polar-SO3",
    "theta=0.3, projection-H2",
    "theta=0.3, softmax-simplex3",
    "theta=0.3, quadratic-SPD2",
    "theta=0.5, exponential-S2",
    "theta=0.0, addition-R2x3",
    "theta=1.0, addition-R2x3",
)
def test_is_a_cotangent_lift(name, seeds):
    lift, equivariant = CotangentLift(LIFTED_MAPS[name]), name.split("-")[-1] in EQUIVARIANT
    check_cotangent_lift(lift, equivariant=equivariant, reach=min(1.0, reach(name)), seeds=seeds, tolerance=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("name", RETRACTIONS)
def test_the_lifts_over_every_retraction_are_symplectic(name, seeds):
    """At the zero vector and at two others, by one compiled function of theta."""
    retraction = RETRACTIONS[name]
    n = ambient_size(retraction.manifold)
    measure = compiled(lambda theta, sample: both_ends(CotangentLift(FreeTheta(retraction, theta)), sample)["push"])
    for seed, length in zip(seeds, (0.0, 0.5, 1.0), strict=False):
        w, frame = draw_bundle_tangent(retraction.manifold, seed, length * min(1.0, reach(name)))
        x, v = np.split(w, 2)
        expected = frame @ tangent_lift_of_omega(n) @ frame.T
        for theta in THETAS:
            push = measure(theta, {"x": x, "v": v, "frame": frame})
            defect = norm(push @ omega_of_both_ends(n) @ push.T - expected)
            assert defect < 1e-11 * (1 + norm(expected)), f"theta={theta}, seed={seed}"


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.usual("0.0", "0.3")
@given(seed=SEEDS)
def test_on_a_vector_space_the_lift_is_known(theta, seed):
    lift = CotangentLift(Theta(Exponential(Euclidean((2, 3))), theta))
    q, p, qdot, pdot = np.random.default_rng(seed).standard_normal((4, 2, 3))
    expected = (q - theta * qdot, p - (1 - theta) * pdot), (q + (1 - theta) * qdot, p + theta * pdot)
    np.testing.assert_allclose(np.stack(lift((q, p), (qdot, pdot))), np.stack(expected), atol=1e-13)


@lru_cache
def _both_inverses():
    lift = CotangentLift(Midpoint(Exponential(Sphere(2))))
    unravel = unflat(lift.manifold)

    def facts(w):
        ends = flat_ends(lift)(w).reshape(2, -1)
        z0, z1 = map(unravel, ends)
        return flat(lift.inverse(z0, z1)), flat(newton_preimage(lift, z0, z1))

    return compiled(facts)


@pytest.mark.slow
@given(seed=SEEDS)
def test_newtons_method_on_the_bundle_finds_the_closed_inverse(seed):
    w, _ = draw_bundle_tangent(Sphere(2), seed, 0.5)
    closed, newton = _both_inverses()(w)
    np.testing.assert_allclose(closed, w, atol=1e-12)
    np.testing.assert_allclose(newton, w, atol=1e-12)


def test_a_lift_is_a_discretization_map_of_the_cotangent_bundle():
    discretization = Midpoint(Exponential(Sphere(2)))
    lift = CotangentLift(discretization)
    assert lift.theta == 0.5
    assert lift.retraction == BundleRetraction(SphereExponential(Sphere(2)))
    assert lift.manifold == CotangentBundle(Sphere(2))


@pytest.mark.parametrize("other", [Exponential(Sphere(2)), Sphere(2), None], ids=["a retraction", "a manifold", "None"])
def test_the_lift_of_something_else_than_a_discretization_map_is_refused(other):
    with pytest.raises(InvalidInputError, match=r"CotangentLift takes a discretization map, got .*try Midpoint"):
        CotangentLift(other)
