"""A small satellite with four reaction wheels, torque and rate limits and a Sun cone, as in the example of the loop."""

import jax.numpy as jnp
import numpy as np
import retrax as rx
from scipy.spatial.transform import Rotation

J = np.array([120.0, 100.0, 70.0])  # mN m s^2, principal axes
OWN = J * np.array([1.1, 0.9, 1.05])  # of the plant
AXES = np.array([[1, -1, 0, 0], [0, 0, 1, -1], [0.8, 0.8, 0.8, 0.8]])
AXES = AXES / np.linalg.norm(AXES, axis=0)
TORQUE, RATE, CONE = 2.0, np.deg2rad(2.5), np.deg2rad(25)  # mN m, rad/s, rad
CAMERA = np.array([1.0, 0.0, 0.0])  # body frame
SUN = Rotation.from_rotvec([0, 0, 55], degrees=True).apply([1, 0, 0.15])
SUN /= np.linalg.norm(SUN)
SPACE = rx.SO(3) * rx.Euclidean(3) * rx.Euclidean(4)  # R, w in rad/s, h in mN m s
SAMPLE, HORIZON = 0.1, 12.0  # s
STEPS = np.geomspace(0.1, 2.0, 12)
SOFT = {"rate": 50.0, "sun": 1000.0}  # weights
TARGET = Rotation.from_rotvec([0, 0, 120], degrees=True).as_matrix()
START = np.eye(3), np.zeros(3), np.array([3.0, -2.0, 1.0, 4.0])


def move(q, u, inertia):
    R, w, h = q
    return R @ rx.hat(w), (-AXES @ u - jnp.cross(w, inertia * w + AXES @ h)) / inertia, u


def off_target(q, target):
    return 3 - jnp.trace(target.T @ q[0])  # about the squared angle


def satellite():
    """The problem, whose parameter is the attitude of the target."""
    return rx.OptimalControlProblem(
        SPACE,
        lambda q, u, target: move(q, u, J),
        lambda q, u, target: 20 * off_target(q, target) + 300 * q[1] @ q[1] + u @ u / 10,
        controls=4,
        terminal_cost=lambda q, target: 200 * off_target(q, target) + 2000 * q[1] @ q[1],
        control_bounds=(-TORQUE, TORQUE),
        constraints={
            "rate": lambda q, u, target: q[1] @ q[1] / RATE**2 - 1,
            "sun": lambda q, u, target: q[0] @ CAMERA @ SUN - np.cos(CONE),
        },
    )


def plant():
    """The satellite with another inertia; its parameter is a ripple of the wheels."""
    return rx.OptimalControlProblem(
        SPACE, lambda q, u, ripple: move(q, u + ripple, OWN), lambda q, u: u @ u / 2, controls=4
    )


def measure(q, t, rng):
    """The state with the noise of a star tracker and of a gyroscope."""
    R, w, h = q
    turn = Rotation.from_rotvec(rng.normal(size=3) * 20 / 3600, degrees=True)
    return R @ turn.as_matrix(), w + np.deg2rad(2e-3) * rng.normal(size=3), h


def ripple(t, rng):
    """The ripple of the wheels for a sample."""
    return 0.02 * rng.normal(size=4)


def controller(**options):
    """The controller at 10 Hz."""
    solver = rx.Solver(satellite(), rx.Gauss(2, rx.Cayley(SPACE)), steps=STEPS)
    given = {"horizon": HORIZON, "parameters": TARGET, "max_iterations": 8, "hold": SAMPLE} | options
    return rx.RecedingHorizon(solver, None, soft=SOFT, **given)
