"""Trajectories that are known in closed form, and what they conserve."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from retrax.integrators import (
    OptimalControlProblem,
    PresymplecticIntegrator,
    SymplecticIntegrator,
    Trajectory,
    integrate,
)
from retrax.manifolds import hat
from retrax.retractions import Cayley, CotangentLift, Midpoint, Projection

from tests.support.numerics import SEEDS, norm

from .problems import IDENTITY, INERTIA, SO3, SPHERE, rigid_body_energy, rotation

NODES = 8


def kinetic_energy(q, p):
    return p @ p / 2


def great_circle(speed: float, h: float) -> Trajectory:
    lift = CotangentLift(Midpoint(Projection(SPHERE)))
    start = jnp.array([1.0, 0.0, 0.0]), jnp.array([0.0, 0.6 * speed, 0.8 * speed])
    return integrate(kinetic_energy, SymplecticIntegrator(lift), start, h, NODES)


def test_the_free_particle_on_the_sphere_turns_by_the_known_angle():
    q = np.asarray(great_circle(1.3, 0.7).q)
    angle = np.arctan2(norm(np.cross(q[0], q[1]) @ [0.0, -0.8, 0.6]), q[0] @ q[1])
    assert angle / 0.7 == pytest.approx(1.072077194117534, abs=2e-15)


@given(speed=st.floats(0.01, 2.0), h=st.floats(0.05, 0.8))
def test_the_free_particle_on_the_sphere_follows_a_great_circle_at_a_known_rate(speed, h):
    """The stage covector solves ``pi + h^2 pi^3 / 4 = |p|``, and a step turns by ``2 atan(h pi / 2)``."""
    trajectory = great_circle(speed, h)
    roots = np.roots([h**2 / 4, 0.0, 1.0, -speed])
    pi = roots[np.abs(roots.imag) < 1e-9].real[0]
    angles = 2 * np.arctan(h * pi / 2) * np.arange(NODES + 1)
    along, up = np.array([0.0, 0.6, 0.8]), np.array([1.0, 0.0, 0.0])
    assert norm(trajectory.q - (np.outer(np.cos(angles), up) + np.outer(np.sin(angles), along))) < 1e-13
    assert norm(trajectory.p - speed * (np.outer(np.cos(angles), along) - np.outer(np.sin(angles), up))) < 1e-13


@cache
def free_top(seed: int) -> tuple[Trajectory, float]:
    """The free rigid body by Cayley's midpoint map, from random data."""
    rng = np.random.default_rng(seed)
    h, attitude, mu = rng.uniform(0.05, 0.4), rotation(rng.standard_normal(3)), rng.standard_normal(3)
    return spin((jnp.asarray(attitude), SO3.covector(jnp.asarray(attitude), jnp.asarray(mu))), h), h


def spin(start: tuple, h: float) -> Trajectory:
    return integrate(rigid_body_energy, SymplecticIntegrator(CotangentLift(Midpoint(Cayley(SO3)))), start, h, NODES)


def body_momenta(trajectory: Trajectory) -> np.ndarray:
    """``mu`` with ``p = R hat(mu) / 2``."""
    skew = np.einsum("kji,kjl->kil", trajectory.q, trajectory.p)
    return np.stack(
        [skew[:, 2, 1] - skew[:, 1, 2], skew[:, 0, 2] - skew[:, 2, 0], skew[:, 1, 0] - skew[:, 0, 1]], axis=1
    )


def cayley(w: np.ndarray) -> np.ndarray:
    """``(I - hat(w)/2)^-1 (I + hat(w)/2)``."""
    a = np.cross(np.eye(3), w) / 2
    return np.linalg.solve(IDENTITY - a, IDENTITY + a)


def stage_rates(mu: np.ndarray, h: float) -> np.ndarray:
    """``W`` with ``h mu = (1 + |W|^2/16) cay(W/2) J W``, by Newton's method with a numerical Jacobian."""

    def residual(w: np.ndarray) -> np.ndarray:
        return (1 + w @ w / 16) * cayley(w / 2) @ (INERTIA * w) - h * mu

    w, e = h * mu / INERTIA, 1e-6
    for _ in range(30):
        jacobian = np.stack([(residual(w + e * d) - residual(w - e * d)) / (2 * e) for d in np.eye(3)], axis=1)
        w = w - np.linalg.solve(jacobian, residual(w))
    return w


@given(seed=SEEDS)
def test_the_free_rigid_body_follows_its_closed_form(seed):
    trajectory, h = free_top(seed)
    mu = body_momenta(trajectory)
    for k in range(NODES):
        half = cayley(stage_rates(mu[k], h) / 2)
        assert norm(trajectory.q[k + 1] - trajectory.q[k] @ half @ half) < 1e-13
        assert norm(mu[k + 1] - half.T @ half.T @ mu[k]) < 1e-13


@given(seed=SEEDS)
def test_the_free_rigid_body_conserves_spatial_momentum_and_its_size(seed):
    trajectory, _ = free_top(seed)
    mu = body_momenta(trajectory)
    spatial = np.einsum("kij,kj->ki", trajectory.q, mu)
    assert norm(np.ptp(spatial, axis=0)) < 1e-13
    assert np.ptp(np.linalg.norm(mu, axis=1)) < 1e-13


@given(seed=SEEDS)
@pytest.mark.slow
def test_the_free_rigid_body_turns_back_when_time_does(seed):
    there, h = free_top(seed)
    back = spin((there.q[-1], there.p[-1]), -h)
    assert norm((back.q[::-1] - there.q, back.p[::-1] - there.p)) < 1e-12


TURNING = OptimalControlProblem(SO3, lambda q, u: q @ hat(u), lambda q, u: u @ (INERTIA * u) / 2, 3)


@given(seed=SEEDS)
@pytest.mark.slow
def test_the_kinematic_control_problem_is_the_free_rigid_body(seed):
    """``R' = R hat(u)`` at the cost ``u . J u / 2``: its controls are the body's stage rates."""
    body, h = free_top(seed)
    lift = CotangentLift(Midpoint(Cayley(SO3)))
    extremal = integrate(TURNING, PresymplecticIntegrator(lift), (body.q[0], body.p[0]), h, NODES)
    assert norm((extremal.q - body.q, extremal.p - body.p)) < 1e-13
    rates = np.stack([stage_rates(mu, h) / h for mu in body_momenta(body)[:-1]])
    assert norm(extremal.controls - rates) < 1e-12
