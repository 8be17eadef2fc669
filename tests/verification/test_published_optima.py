"""Optimal control problems with reference optima, by extrapolation of a method of order 2."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Guess, OptimalControlProblem, Solution, solve
from retrax.manifolds import TangentBundle, hat
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import BundleRetraction, Cayley, Exponential, Midpoint

from tests.integrators.problems import IDENTITY, REST, RIGID, SLEW, SLEW_END, SO3, SPHERE, half_square, rotation

pytestmark = pytest.mark.usefixtures("traced_once")


def extrapolated(coarse: float, fine: float) -> float:
    """The limit, from a step and half that step of a method of order 2."""
    return fine + (fine - coarse) / 3


def observed_order(coarse: float, middle: float, fine: float) -> float:
    return float(np.log2((coarse - middle) / (middle - fine)))


@cache
def slew(steps: int) -> Solution:
    """Rest to rest, 150 degrees about (1, 2, -2)/3 in 60 s, solved to rounding."""
    return solve(
        SLEW, (IDENTITY, REST), (SLEW_END, REST), 60.0, method=Midpoint(Cayley(RIGID)), steps=steps, tolerance=1e-13
    )


def spatial_covector(steps: int) -> np.ndarray:
    (covector,) = slew(steps).spatial_costates.values()
    return covector


STEPS = [
    pytest.param(50, marks=pytest.mark.slow),
    100,
    *(pytest.param(steps, marks=pytest.mark.slow) for steps in (200, 400)),
]


@pytest.mark.slow
def test_the_cost_of_the_slew_is_of_order_two_and_has_the_known_limit():
    costs = [slew(steps).cost for steps in (50, 100, 200, 400)]
    assert observed_order(*costs[:3]) == pytest.approx(2.0, abs=0.05)
    assert observed_order(*costs[1:]) == pytest.approx(2.0, abs=0.05)
    assert extrapolated(*costs[1:3]) == pytest.approx(2504.24655710, rel=1e-7)
    assert slew(200).checks.strict_minimum


@pytest.mark.parametrize("steps", STEPS)
def test_the_spatial_covector_of_the_slew_is_constant(steps):
    covector = spatial_covector(steps)
    assert np.max(np.ptp(covector, axis=0)) < 1e-12 * np.max(np.abs(covector))


@pytest.mark.slow
def test_the_spatial_covector_of_the_slew_has_the_known_limit():
    limit = extrapolated(spatial_covector(100)[0], spatial_covector(200)[0])
    assert np.abs(limit) == pytest.approx([2005.83548, 441.24040, 946.65736], rel=1e-6)


@pytest.mark.parametrize("steps", STEPS)
def test_every_attitude_of_the_slew_is_orthogonal(steps):
    attitude, _ = slew(steps).states
    assert np.max(np.abs(np.swapaxes(attitude, 1, 2) @ attitude - IDENTITY)) < 1e-13
    assert slew(steps).checks.manifold_violation < 1e-13


def test_the_hamiltonian_of_the_slew_is_constant_in_the_limit():
    coarse, fine = (slew(steps).checks.hamiltonian_spread for steps in (100, 200))
    assert np.log2(coarse / fine) == pytest.approx(2.0, abs=0.1)


SUB_RIEMANNIAN = OptimalControlProblem(SO3, lambda q, u: q @ hat(jnp.stack([u[0], u[1], 0.0 * u[0]])), half_square, 2)
TURN = 1.0


@cache
def about_the_missing_axis(steps: int) -> Solution:
    """From the identity to a turn about the third axis with controls about the first two, near the known extremal.

    ``R(t) = exp(t (r E1 + w E3)) exp(-t w E3)`` with ``w = 2 pi - turn`` and ``r^2 = turn (4 pi - turn)``.
    """
    t = (np.arange(steps) + 0.5) / steps
    w, r = 2 * np.pi - TURN, np.sqrt(TURN * (4 * np.pi - TURN))
    states = np.stack([rotation([r * s, 0.0, w * s]) @ rotation([0.0, 0.0, -w * s]) for s in t])
    controls = r * np.stack([np.cos(w * t), np.sin(w * t)], axis=1)
    end = rotation([0.0, 0.0, TURN])
    return solve(
        SUB_RIEMANNIAN, IDENTITY, end, 1.0, method=Midpoint(Cayley(SO3)), steps=steps, guess=Guess(states, controls)
    )


@pytest.mark.slow
def test_the_sub_riemannian_distance_has_the_known_limit():
    """``turn (4 pi - turn) / 2``, to order 2."""
    coarse, middle, fine = (about_the_missing_axis(steps).cost for steps in (20, 40, 80))
    assert observed_order(coarse, middle, fine) == pytest.approx(2.0, abs=0.05)
    assert extrapolated(middle, fine) == pytest.approx(TURN * (4 * np.pi - TURN) / 2, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("steps", [20, 40, 80])
def test_the_sub_riemannian_optimum_is_one_of_a_circle_of_them(steps):
    """Turning all controls about the third axis gives another: no minimum is strict."""
    assert not about_the_missing_axis(steps).checks.strict_minimum


BUNDLE = TangentBundle(SPHERE)


def swing(z: tuple, u: jax.Array) -> tuple:
    """Unit pendulum with a tangent force: ``q' = v``, ``v' = P_q(g + u) - |v|^2 q``."""
    q, v = z
    force = SPHERE.projection(q, u - jnp.array([0.0, 0.0, 1.0]))
    return v, vec.subtract(force, (v @ v) * q)


PENDULUM = OptimalControlProblem(BUNDLE, swing, half_square, 3)
HANGING = np.array([np.sin(0.5), 0.0, -np.cos(0.5)]), np.array([0.0, 0.5, 0.0])
UPRIGHT = np.array([0.0, 0.0, 1.0]), np.zeros(3)


@cache
def swung_up(steps: int) -> Solution:
    discretization = Midpoint(BundleRetraction(Exponential(SPHERE)))
    return solve(PENDULUM, HANGING, UPRIGHT, 3.0, method=discretization, steps=steps)


@pytest.mark.slow
def test_the_pendulum_swings_up_at_the_known_cost():
    coarse, middle, fine = (swung_up(steps).cost for steps in (40, 80, 160))
    assert observed_order(coarse, middle, fine) == pytest.approx(2.0, abs=0.05)
    assert extrapolated(middle, fine) == pytest.approx(2.1226524395, rel=1e-6)


@pytest.mark.slow
def test_the_pendulum_arrives_upright_at_rest_and_stays_on_the_tangent_bundle():
    q, v = swung_up(160).states
    assert np.max(np.abs(q[-1] - UPRIGHT[0])) < 1e-11
    assert np.max(np.abs(v[-1])) < 1e-11
    assert np.max(np.abs(np.sum(q * v, axis=1))) < 1e-13
