"""Orders of convergence, fitted from log-log slopes against references that another program computed.

Euler's maps are of order 1, the midpoint map of order 2.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import SymplecticIntegrator, integrate
from retrax.retractions import Cayley, CotangentLift, Projection, Theta
from scipy.integrate import solve_ivp

from tests.integrators.problems import INERTIA, SO3, SPHERE, at, pendulum_energy, rotation, top_energy
from tests.support.numerics import slope

pytestmark = pytest.mark.usefixtures("traced_once")

BLOCK = 20  # steps of one compiled call; a trajectory is a chain of calls
REFINEMENTS = 2 ** np.arange(4)
ORDERS = [pytest.param(0.0, 1, marks=pytest.mark.slow), (0.5, 2), pytest.param(1.0, 1, marks=pytest.mark.slow)]


def final_state(energy, retraction, theta, start, horizon, blocks) -> tuple[np.ndarray, np.ndarray]:
    """The state at the horizon after ``BLOCK * blocks`` steps."""
    integrator = SymplecticIntegrator(CotangentLift(Theta(retraction, theta)))
    for _ in range(blocks):
        path = integrate(energy, integrator, start, horizon / (BLOCK * blocks), BLOCK, save_every=BLOCK)
        start = at((path.q, path.p), -1)
    return jax.tree.map(np.asarray, start)


def reference(field, y0, horizon) -> np.ndarray:
    """The end of a trajectory, by an explicit method of order 8."""
    return solve_ivp(lambda _, y: field(y), (0.0, horizon), y0, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]


def pendulum(y: np.ndarray) -> np.ndarray:
    """``q'' = -g e_z``, with the force that keeps ``|q| = 1``."""
    q, p = y[:3], y[3:]
    up = np.array([0.0, 0.0, 1.0])
    return np.concatenate([p, -up + (up @ q - p @ p) * q])


def heavy_top(y: np.ndarray) -> np.ndarray:
    """``R' = R hat(w)``, ``mu' = mu x w - torque`` with ``w = J^-1 mu`` and the potential ``R_33 + 0.3 R_12``."""
    attitude, mu = y[:9].reshape(3, 3), y[9:]
    w = mu / INERTIA
    slope = attitude.T @ np.array([[0.0, 0.3, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    torque = np.array([slope[2, 1] - slope[1, 2], slope[0, 2] - slope[2, 0], slope[1, 0] - slope[0, 1]])
    return np.concatenate([(attitude @ np.cross(np.eye(3), w)).ravel(), np.cross(mu, w) - torque])


@pytest.mark.parametrize(("theta", "order"), ORDERS)
def test_order_for_the_spherical_pendulum(theta, order):
    q, p = np.array([0.6, 0.0, -0.8]), np.array([0.4, 0.6, 0.3])
    expected = reference(pendulum, np.concatenate([q, p]), 1.5)
    start = jnp.asarray(q), jnp.asarray(p)
    ends = [final_state(pendulum_energy, Projection(SPHERE), theta, start, 1.5, int(n)) for n in REFINEMENTS]
    errors = np.array([np.max(np.abs(np.concatenate(end) - expected)) for end in ends])
    assert slope(1.0 / REFINEMENTS, errors, 1e-12) == pytest.approx(order, abs=0.1)
    assert errors[-1] < 0.02**order


@pytest.mark.parametrize(("theta", "order"), ORDERS)
def test_order_for_the_heavy_top(theta, order):
    attitude, mu = rotation([0.3, 0.1, -0.2]), np.array([1.0, -0.5, 0.7])
    expected = reference(heavy_top, np.concatenate([attitude.ravel(), mu]), 2.0)
    start = jnp.asarray(attitude), SO3.covector(jnp.asarray(attitude), jnp.asarray(mu))
    ends = [final_state(top_energy, Cayley(SO3), theta, start, 2.0, int(n)) for n in REFINEMENTS]
    flat = [np.concatenate([q.ravel(), np.asarray(SO3.body(q, p))]) for q, p in ends]
    errors = np.array([np.max(np.abs(end - expected)) for end in flat])
    assert slope(1.0 / REFINEMENTS, errors, 1e-12) == pytest.approx(order, abs=0.1)
    assert errors[-1] < 0.03**order
