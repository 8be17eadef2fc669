"""Every cotangent lift satisfies the facts of the conformance kit; closed forms, inverses, wrong arguments."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.manifolds import CotangentBundle, Euclidean, InvalidInputError, Sphere
from retrax.retractions import BundleRetraction, CotangentLift, Exponential, Midpoint, SphereExponential, Theta
from retrax.retractions.discretization import newton_preimage
from retrax.testing import check_cotangent_lift
from retrax.testing.checks.cotangent_lift import omega_of_both_ends, tangent_lift_of_omega
from retrax.testing.checks.discretization import flat_ends
from retrax.testing.numerics import ambient_size

from tests.support.cases import LIFTED_MAPS, RETRACTIONS, THETAS, FreeTheta, reach
from tests.support.numerics import SEEDS, bundle_frame, compiled, draw_bundle_tangent, flat, norm, unflat

EQUIVARIANT = ("S2", "S4", "SO2", "SO3", "SO4", "St42")


@pytest.mark.parametrize("name", LIFTED_MAPS)
@pytest.mark.usual("theta=0.3, exponential-S2")
def test_is_a_cotangent_lift(name, seeds):
    lift, equivariant = CotangentLift(LIFTED_MAPS[name]), name.split("-")[-1] in EQUIVARIANT
    check_cotangent_lift(lift, equivariant=equivariant, reach=min(1.0, reach(name)), seeds=seeds, tolerance=1e-13)


@pytest.mark.parametrize("name", RETRACTIONS)
@pytest.mark.usual(2)
def test_the_theta_maps_of_every_retraction_and_their_lifts(name, seeds):
    """The axioms of both at the zero vector, and symplecticity there and at two others, by one compiled function of
    theta."""
    retraction = RETRACTIONS[name]
    n = ambient_size(retraction.manifold)

    def facts(theta, w, frame):
        ends = flat_ends(CotangentLift(FreeTheta(retraction, theta)))
        values, push = jax.lax.map(lambda direction: jax.jvp(ends, (w,), (direction,)), frame)
        base = jnp.concatenate([jnp.split(part, 2)[0] for part in jnp.split(w, 2)])
        named = {theta: flat_ends(Theta(retraction, theta))(base) for theta in THETAS}
        return values[0], push, named

    measure = compiled(facts)
    for seed, length in zip(seeds, (0.0, 0.5, 1.0), strict=False):
        w = draw_bundle_tangent(retraction.manifold, seed, length * min(1.0, reach(name)))
        frame = bundle_frame(retraction.manifold, w)
        omega = frame @ tangent_lift_of_omega(n) @ frame.T
        fibre = frame[len(frame) // 2 :, 2 * n :]
        for theta in THETAS:
            value, push, named = measure(theta, w, frame)
            # Of vectors no longer than 1 at both ends: their products cancel, and those of long ones leave rounding.
            sizes = np.maximum(1.0, np.linalg.norm(push, axis=1))
            pulled = push @ omega_of_both_ends(n) @ push.T
            left = {"the lift is symplectic": (pulled - omega) / np.outer(sizes, sizes)}
            lifted = np.concatenate([value[:n], value[2 * n : 3 * n]])
            left["the lift is over the map with this theta"] = lifted - named[theta]
            if length == 0.0:
                first, second = np.split(push[len(frame) // 2 :], 2, axis=1)
                left["R_d(z, 0) = (z, z)"] = value - np.tile(w[: 2 * n], 2)
                left["D_v R2 - D_v R1 = Id"] = second - first - fibre
                left["D_v R1 = -theta Id on the base"] = first[:, :n] + theta * fibre[:, :n]
            for what, defect in left.items():
                assert norm(defect) < 1e-11 * (1 + norm(omega)), f"{what}: theta={theta}, seed={seed}"


@pytest.mark.parametrize("theta", THETAS)
@given(seed=SEEDS)
@pytest.mark.usual(1)
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
    w = draw_bundle_tangent(Sphere(2), seed, 0.5)
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
