"""A plant with an unstable state that a limit drives over narrow peaks, Betts' alp rider [Practical Methods, 2010],
against IPOPT on the same transcription."""

import casadi as ca
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, solve
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Gauss

A = np.array([[-10.0, 0, 0, 0], [0, -2, 0, 0], [0, 0, -3, 5], [0, 0, 5, -3]])  # eigenvalues -10, -2, -8 and 2
B = np.array([[1.0, 1], [1, 2], [1, -1], [1, 3]])
START, END, HORIZON = np.array([2.0, 1, 2, 1]), np.array([2.0, 3, 1, -2]), 20.0
PEAKS = ((3, 3, 12), (3, 6, 10), (3, 10, 6), (8, 15, 4))
SPACE = Euclidean(4)


def least(t, exp=ca.exp):
    """The least square of the state."""
    return 0.01 + sum(high * exp(-sharp * (t - at) ** 2) for high, at, sharp in PEAKS)


def rate(q, u, t):
    return A @ q + B @ u


def cost(q, u, t):
    return 100 * q @ q + 0.01 * u @ u


def judge(steps, states, controls):
    """The cost that IPOPT finds with ``Gauss(2)`` beside given states at the nodes and controls of the stages."""
    h, s = HORIZON / steps, np.sqrt(3) / 6
    inside = np.array([[0.25, 0.25 - s], [0.25 + s, 0.25]])
    q, v, u = ca.SX.sym("q", 4, steps + 1), ca.SX.sym("v", 8, steps), ca.SX.sym("u", 4, steps)
    equations, limits, total = [q[:, 0] - START, q[:, -1] - END], [], 0
    for k in range(steps):
        each = [v[:4, k], v[4:, k]]
        for i, share in enumerate(inside.sum(axis=1)):
            point, push = q[:, k] + h * (inside[i, 0] * each[0] + inside[i, 1] * each[1]), u[2 * i : 2 * i + 2, k]
            equations.append(each[i] - A @ point - B @ push)
            limits.append(least(h * (k + share)) - ca.dot(point, point))
            total += h / 2 * (100 * ca.dot(point, point) + 0.01 * ca.dot(push, push))
        equations.append(q[:, k + 1] - q[:, k] - h / 2 * (each[0] + each[1]))
    unknowns, rows = ca.vertcat(ca.vec(q), ca.vec(v), ca.vec(u)), ca.vertcat(*equations, *limits)
    options = {"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-9, "ipopt.mu_init": 1e-7}
    solver = ca.nlpsol("s", "ipopt", {"x": unknowns, "f": total, "g": rows}, options)
    slopes = np.repeat((states[1:] - states[:-1]) / h, 2, axis=0)
    first = np.concatenate([states.ravel(), slopes.ravel(), controls.ravel()])
    below = np.where(np.arange(rows.shape[0]) < rows.shape[0] - len(limits), 0.0, -np.inf)
    found = solver(x0=first, lbg=below, ubg=0)
    assert solver.stats()["success"]
    return float(found["f"])


@pytest.mark.parametrize("steps", [50, *(pytest.param(n, marks=pytest.mark.slow) for n in (100, 200))])
def test_peaks_are_ridden_over(steps):
    """Through meshes from two steps a peak on: IPOPT takes 136, 113 and 130 iterations from the same guess."""
    limits = {"peaks": lambda q, u, t: least(t, jnp.exp) - q @ q}
    problem = OptimalControlProblem(SPACE, rate, cost, 2, constraints=limits, time_dependent=True)
    found = solve(problem, START, END, HORIZON, method=Gauss(2, Addition(SPACE)), steps=steps, max_iterations=200)
    assert found.statistics.iterations <= 150
    stages = np.asarray(found.controls)
    assert found.cost == pytest.approx(judge(steps, np.asarray(found.states), stages), rel=1e-5)
