"""Cotangent lifts of discretization maps: their axioms, that they are symplectic, their inverses."""

from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given
from retrax.manifolds import CotangentBundle, InvalidInputError, Sphere
from retrax.retractions import BundleRetraction, CotangentLift, Exponential, Midpoint, SphereExponential
from retrax.retractions.discretization import newton_preimage

from tests.support.cases import RETRACTIONS, discretization_maps, inverted_maps, reach
from tests.support.maps import LIFTED, flat_lift, lift_facts, lift_inverses, map_facts
from tests.support.numerics import FRACTIONS, SEEDS, compiled, draw_bundle_tangent, flat, norm, unflat

every_lift = pytest.mark.parametrize("name", LIFTED)
EQUIVARIANT = [name for name in LIFTED if name.split("-")[1] in ("S2", "S4", "SO2", "SO3", "SO4", "St42")]
INVERTED_LIFTS = ["addition-R2x3", "exponential-S2", "cayley-SO4", "nearest-ellipsoid", "exponential-(SO3*R3)*S2"]


def omega(n: int) -> np.ndarray:
    """Matrix of ``dq ^ dp`` on ``(q, p)`` with ``n`` entries each."""
    return np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])


def tangent_lift_of_omega(n: int) -> np.ndarray:
    """Matrix of ``d_T omega`` on ``(z, zdot)``: ``omega(adot, b) + omega(a, bdot)``."""
    zero = np.zeros((2 * n, 2 * n))
    return np.block([[zero, omega(n)], [omega(n), zero]])


def omega_of_both_ends(n: int) -> np.ndarray:
    """Matrix of ``Omega_12 = pr2* omega - pr1* omega`` on ``(z0, z1)``."""
    zero = np.zeros((2 * n, 2 * n))
    return np.block([[-omega(n), zero], [zero, omega(n)]])


def symplectic_defect(facts: dict, key: str) -> float:
    """Largest entry of ``(R_d^{T*})^* Omega_12 - d_T omega`` on a frame."""
    n, frame, push = facts["w"].size // 4, facts["frame"], facts[key]["push"]
    return norm(push @ omega_of_both_ends(n) @ push.T - frame @ tangent_lift_of_omega(n) @ frame.T)


@every_lift
@given(seed=SEEDS)
def test_zero_goes_to_the_base_point_twice(name, seed):
    facts = lift_facts(name, seed, 0.0)
    z, _ = np.split(facts["w"], 2)
    for key in discretization_maps(name):
        np.testing.assert_allclose(facts[key]["value"], np.tile(z, 2), atol=1e-13, err_msg=key)


@every_lift
@given(seed=SEEDS)
def test_the_derivatives_of_the_two_ends_at_zero_differ_by_the_identity(name, seed):
    facts = lift_facts(name, seed, 0.0)
    fibre = len(facts["frame"]) // 2
    _, e = np.split(facts["frame"][fibre:], 2, axis=1)
    for key in discretization_maps(name):
        first, second = np.split(facts[key]["push"][fibre:], 2, axis=1)
        np.testing.assert_allclose(second - first, e, atol=1e-11, err_msg=key)


@every_lift
@given(seed=SEEDS, fraction=FRACTIONS)
def test_the_cotangent_lift_is_symplectic(name, seed, fraction):
    facts = lift_facts(name, seed, fraction * min(1.0, reach(name)))
    for key in discretization_maps(name):
        assert symplectic_defect(facts, key) < 1e-13, key


@every_lift
@given(seed=SEEDS, fraction=FRACTIONS)
def test_the_ends_lie_in_the_cotangent_bundle_over_those_of_the_map(name, seed, fraction):
    facts = lift_facts(name, seed, fraction * min(1.0, reach(name)))
    manifold = RETRACTIONS[name].manifold
    bundle, unravel = CotangentBundle(manifold), unflat(CotangentBundle(manifold))
    x, _, xdot, _ = map(unflat(manifold), np.split(facts["w"], 4))
    for key, discretization in discretization_maps(name).items():
        for z in np.split(facts[key]["value"], 2):
            verdict = bundle.contains(unravel(z), 1e-12)
            assert verdict, f"{key}: {verdict.reason}"
        q0, _, q1, _ = np.split(facts[key]["value"], 4)
        if name == "exponential-S2":
            np.testing.assert_allclose(flat(discretization(x, xdot)), np.concatenate([q0, q1]), atol=1e-15)


@pytest.mark.parametrize("name", EQUIVARIANT)
@given(seed=SEEDS, fraction=FRACTIONS)
def test_the_momentum_of_rotations_changes_by_its_derivative_along_the_vector(name, seed, fraction):
    # Equivariant maps: <p1, xi q1> - <p0, xi q0> = d/dt <p, xi x>, hence their integrators conserve momenta.
    facts = lift_facts(name, seed, fraction * min(1.0, reach(name)))
    rows = RETRACTIONS[name].manifold.ambient.shape[0]

    def momentum(q, p):
        q, p = q.reshape(rows, -1), p.reshape(rows, -1)
        return p @ q.T - q @ p.T

    x, p, xdot, pdot = np.split(facts["w"], 4)
    for key in discretization_maps(name):
        q0, p0, q1, p1 = np.split(facts[key]["value"], 4)
        expected = momentum(x, pdot) + momentum(xdot, p)
        np.testing.assert_allclose(momentum(q1, p1) - momentum(q0, p0), expected, atol=1e-12, err_msg=key)


@pytest.mark.parametrize("theta", [0.0, 0.3, 0.5, 1.0])
@given(seed=SEEDS)
def test_on_a_vector_space_the_lift_is_known(theta, seed):
    facts = lift_facts("addition-R2x3", seed, 3.0)
    q, p, qdot, pdot = np.split(facts["w"], 4)
    expected = q - theta * qdot, p - (1 - theta) * pdot, q + (1 - theta) * qdot, p + theta * pdot
    np.testing.assert_allclose(facts[f"theta={theta}"]["value"], np.concatenate(expected), atol=1e-13)


@pytest.mark.parametrize("name", INVERTED_LIFTS)
@given(seed=SEEDS, fraction=FRACTIONS)
def test_inverse_finds_the_vector_tangent_to_the_cotangent_bundle(name, seed, fraction):
    facts = lift_inverses(name, seed, fraction * min(1.0, reach(name)))
    for key in inverted_maps(name):
        np.testing.assert_allclose(facts[key]["back"], facts["w"], atol=1e-11, err_msg=key)


@pytest.mark.parametrize("name", INVERTED_LIFTS)
@given(seed=SEEDS)
def test_a_lift_inverts_its_inverse(name, seed):
    facts = lift_inverses(name, seed, 0.0)
    for key in inverted_maps(name):
        np.testing.assert_allclose(facts[key]["there"], facts["ends"], atol=1e-12, err_msg=key)


@lru_cache
def _both_inverses():
    lift = CotangentLift(Midpoint(Exponential(Sphere(2))))
    unravel = unflat(lift.manifold)

    def facts(w):
        ends = flat_lift(lift.discretization)(w).reshape(2, -1)
        z0, z1 = map(unravel, ends)
        return flat(lift.inverse(z0, z1)), flat(newton_preimage(lift, z0, z1))

    return compiled(facts)


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


@given(seed=SEEDS)
def test_a_defect_would_be_seen(seed):
    # The same two matrices on the ends of the bundle retraction, which is not symplectic.
    facts = map_facts("bundle-T*S2", seed, 1.0)
    ends, n = facts["theta=0.5"]["push"], facts["x"].size // 2
    frame = np.concatenate([np.zeros_like(facts["basis"]), facts["basis"]], axis=1)
    pulled = ends @ omega_of_both_ends(n) @ ends.T - frame @ tangent_lift_of_omega(n) @ frame.T
    assert norm(pulled) > 1e-6
