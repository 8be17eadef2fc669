"""Receding horizon control and closed loops, against regulators, open-loop optima, SciPy and other plans."""

from functools import cache

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
import retrax as rx
from retrax.integrators import Feedback, soften
from retrax.integrators.closed_loop.plant import Plant
from retrax.manifolds import DomainError, InvalidInputError
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_continuous_are
from scipy.spatial.transform import Rotation

SYSTEM, INPUT = np.array([[0.0, 1.0], [0.5, -0.3]]), np.array([[0.0], [1.0]])
WEIGHT, PRICE, BOUND = np.diag([2.0, 0.5]), 0.4, 1.5
GAIN = INPUT.T @ solve_continuous_are(SYSTEM, INPUT, WEIGHT, PRICE * np.eye(1)) / PRICE
PLANE = rx.Euclidean(2)
AWAY = np.array([1.0, -0.5])

BODY = rx.SO(3) * rx.Euclidean(3)
INERTIA, TORQUE, RATE = np.array([3.0, 2.0, 1.5]), 0.6, 0.5
START = np.eye(3), np.zeros(3)
END = Rotation.from_rotvec([0.5, 1.0, -0.8]).as_matrix(), np.zeros(3)
TIME, SAMPLE = 8.0, 0.5


def linear(q, u):
    return SYSTEM @ q + INPUT @ u


def quadratic(q, u):
    return q @ WEIGHT @ q / 2 + PRICE * u @ u / 2


def body(q, u, push):
    return q[0] @ rx.hat(q[1]), (u + push - jnp.cross(q[1], INERTIA * q[1])) / INERTIA


@cache
def regulated(bound=np.inf):
    """The solver of the linear-quadratic problem with a bound."""
    problem = rx.OptimalControlProblem(PLANE, linear, quadratic, 1, control_bounds=(-bound, bound))
    return rx.Solver(problem, rx.Gauss(2 if bound < np.inf else 3, rx.default_retraction(PLANE)), steps=30)


@cache
def turning():
    """The solver of a rigid body with limits of torque and rate; the parameter is a torque that disturbs it."""
    problem = rx.OptimalControlProblem(
        BODY,
        body,
        lambda q, u: u @ u / 2,
        3,
        control_bounds=(-TORQUE, TORQUE),
        constraints={"rate": lambda q, u: q[1] @ q[1] / RATE**2 - 1},
    )
    return rx.Solver(problem, rx.Gauss(2, rx.Cayley(BODY)), steps=16)


def angles(attitudes, others):
    """The angles between rotations in rad."""
    return (Rotation.from_matrix(attitudes).inv() * Rotation.from_matrix(others)).magnitude()


def test_a_long_horizon_is_the_linear_quadratic_regulator():
    errors = []
    for steps in (20, 40, 80):
        controller = rx.RecedingHorizon(regulated().with_steps(steps), None, horizon=20.0)
        errors.append(abs(controller(AWAY, 0.0) + GAIN @ AWAY).max())
    assert errors[-1] <= 1e-3
    assert np.log2(errors[1] / errors[2]) >= 2.5  # the controls between the stages are of order 3
    loop = rx.simulate(regulated().problem, controller, AWAY, horizon=3.0, sample_time=0.25, seed=1) if False else None
    controller = rx.RecedingHorizon(regulated().with_steps(80), None, horizon=20.0)
    loop = rx.simulate(regulated().problem, controller, AWAY, horizon=3.0, sample_time=0.25)
    exact = np.stack([expm((SYSTEM - INPUT @ GAIN) * t) @ AWAY for t in loop.t])
    assert abs(loop.q - exact).max() <= 1e-4
    assert set(loop.solves.sources) == {"solve"}
    assert loop.solves.iterations.max() == 1
