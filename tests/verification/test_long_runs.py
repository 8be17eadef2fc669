"""Long runs: what is conserved, and what only oscillates."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import SymplecticIntegrator, Trajectory, integrate
from retrax.retractions import CotangentLift, Euler, Midpoint, Projection

from tests.integrators.problems import SPHERE, pendulum_energy

STEPS = 600
MAPS = {"midpoint": Midpoint(Projection(SPHERE)), "euler": Euler(Projection(SPHERE))}
WORST = {"midpoint": 4.7e-3, "euler": 5.0e-2}

for_both_maps = pytest.mark.parametrize("name", MAPS)


@cache
def pendulum(name: str) -> Trajectory:
    """The spherical pendulum from the horizontal over 60 units of time, in steps of 1/10."""
    start = jnp.array([1.0, 0.0, 0.0]), jnp.array([0.0, 0.6, 0.3])
    return integrate(pendulum_energy, SymplecticIntegrator(CotangentLift(MAPS[name])), start, 0.1, STEPS)


def energy_errors(name: str) -> np.ndarray:
    trajectory = pendulum(name)
    energies = np.asarray(jax.vmap(pendulum_energy)(trajectory.q, trajectory.p))
    return energies - energies[0]


@for_both_maps
def test_the_pendulum_conserves_its_vertical_momentum(name):
    q, p = np.asarray(pendulum(name).q), np.asarray(pendulum(name).p)
    momentum = q[:, 0] * p[:, 1] - q[:, 1] * p[:, 0]
    assert np.max(np.abs(momentum - 0.6)) < 1e-12


@for_both_maps
def test_the_pendulum_stays_on_its_cotangent_bundle(name):
    q, p = np.asarray(pendulum(name).q), np.asarray(pendulum(name).p)
    assert np.max(np.abs(np.sum(q * q, axis=1) - 1)) < 2e-15
    assert np.max(np.abs(np.sum(q * p, axis=1))) < 2e-15


@for_both_maps
def test_the_largest_energy_error_of_the_pendulum_is_known(name):
    assert np.max(np.abs(energy_errors(name))) == pytest.approx(WORST[name], rel=0.02)


@for_both_maps
def test_the_energy_error_of_the_pendulum_does_not_drift(name):
    """A line through it gains less over the whole run than a tenth of its largest value."""
    errors = energy_errors(name)
    slope, _ = np.polyfit(np.arange(STEPS + 1), errors, 1)
    assert abs(slope) * STEPS < 0.1 * np.max(np.abs(errors))
    quarters = [np.max(np.abs(part)) for part in np.array_split(errors, 4)]
    assert max(quarters) < 1.1 * min(quarters)
