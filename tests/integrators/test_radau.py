"""Radau methods: orders of solves and of integration on curved manifolds, symplecticity, and stiff dynamics."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, SymplecticIntegrator, integrate, solve
from retrax.manifolds import Euclidean, Product, Sphere, hat
from retrax.retractions import (
    Addition,
    CollocationMethod,
    Gauss,
    Projection,
    Radau,
    Retraction,
    default_retraction,
)

from .problems import INERTIA, RIGID, rotation, top_energy

S2 = Sphere(2)


def body(q: tuple, u: jax.Array) -> tuple:
    return q[0] @ hat(q[1]), (u - jnp.cross(q[1], INERTIA * q[1])) / INERTIA


def turned(q: jax.Array, u: jax.Array) -> jax.Array:
    return jnp.cross(u + 0.3 * jnp.array([0.0, 0.0, 1.0]), q)


SLEW = OptimalControlProblem(RIGID, body, lambda q, u: u @ u / 2, 3)
POINTING = OptimalControlProblem(S2, turned, lambda q, u: u @ u / 2 + q[2] ** 2 / 4, 3)
CASES: dict[str, tuple[OptimalControlProblem, object, object]] = {
    "SO(3) x R^3": (
        SLEW,
        (np.eye(3), np.zeros(3)),
        (rotation(np.array([0.3, 1.0, -0.5])), np.array([0.1, 0.0, 0.2])),
    ),
    "S^2": (POINTING, np.array([1.0, 0.0, 0.0]), np.array([0.6, 0.0, 0.8])),
}


def slopes(errors: list[float]) -> np.ndarray:
    return np.log2(np.array(errors[:-1]) / errors[1:])


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("stages", [2, 3])
@pytest.mark.usual(1)
def test_states_of_a_solve_converge_with_the_order(name: str, stages: int) -> None:
    problem, start, end = CASES[name]
    R = default_retraction(problem.manifold)

    def middle(method: CollocationMethod, steps: int) -> np.ndarray:
        states = solve(problem, start, end, 2.0, method=method, steps=steps).states
        return np.concatenate([np.ravel(leaf[steps // 2]) for leaf in jax.tree.leaves(states)])

    exact = middle(Gauss(5, R), 20)
    errors = [float(np.max(np.abs(middle(Radau(stages, R), steps) - exact))) for steps in (8, 16, 32)]
    assert slopes(errors) == pytest.approx(2 * stages - 1, abs=0.25)


def sphere_energy(q: jax.Array, p: jax.Array) -> jax.Array:
    return p @ p / 2 + q[2] + q[0] * q[1]


def vehicle_energy(q: tuple, p: tuple) -> jax.Array:
    """A rigid body and a point whose potential couples them."""
    return top_energy(q[0], p[0]) + p[1] @ p[1] / 2 + (q[0][:, 0] - q[1]) @ (q[0][:, 0] - q[1])


VEHICLE = default_retraction(RIGID)
INTEGRATED: dict[str, tuple[Callable, Retraction, Any]] = {
    "SO(3) x R^3": (
        vehicle_energy,
        VEHICLE,
        (
            (np.eye(3), np.array([0.2, 0.1, -0.3])),
            (np.asarray(hat(jnp.array([0.1, 0.4, -0.2]))), np.array([0.3, -0.2, 0.5])),
        ),
    ),
    "S^2": (sphere_energy, Projection(S2), (np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.7, 0.2]))),
}


@pytest.mark.parametrize("name", INTEGRATED)
@pytest.mark.usual(1)
def test_a_trajectory_converges_with_the_order(name: str) -> None:
    energy, R, start = INTEGRATED[name]

    def last(method: CollocationMethod, steps: int) -> np.ndarray:
        path = integrate(energy, SymplecticIntegrator(method), start, 1.0 / steps, steps)
        return np.concatenate([np.ravel(leaf[-1]) for leaf in jax.tree.leaves((path.q, path.p))])

    exact = last(Gauss(5, R), 40)
    errors = [float(np.max(np.abs(last(Radau(2, R), steps) - exact))) for steps in (8, 16, 32)]
    assert slopes(errors) == pytest.approx(3, abs=0.25)


def lagging(lag: float) -> OptimalControlProblem:
    """A mass whose actuator follows the command with a lag."""
    return OptimalControlProblem(
        Euclidean(3), lambda q, u: jnp.array([q[1], q[2], (u[0] - q[2]) / lag]), lambda q, u: u @ u / 2, 1
    )


@pytest.mark.parametrize("stages", [2, 3])
def test_a_fast_actuator_follows_its_command_where_gauss_methods_swing(stages: int) -> None:
    # As the lag vanishes, the force tends to 6 - 12 t and the cost to 6, but for the first 3 lags and the last ones.
    lag, R, start, end = 1e-6, Addition(Euclidean(3)), np.array([0.0, 0.0, 3.0]), np.array([1.0, 0.0, -6.0])
    errors, costs = {}, {}
    for method in (Radau(stages, R), Gauss(stages, R)):
        found = solve(lagging(lag), start, end, 1.0, method=method, steps=10)
        force = found.states[1:-1, 2]
        errors[type(method)] = float(np.max(np.abs(force - (6 - 12 * found.times[1:-1]))))
        costs[type(method)] = abs(found.cost - 6)
    assert errors[Radau] <= 100 * lag
    assert costs[Radau] <= 20 * lag
    assert errors[Gauss] >= 1.0
    assert costs[Gauss] >= 50 * costs[Radau]


@pytest.mark.parametrize("lag", [1e-6, 1e-5, 1e-4, 0.1, 1.0])
@pytest.mark.usual(1)
def test_radau_has_the_smaller_error_where_the_dynamics_is_stiff_and_gauss_elsewhere(lag: float) -> None:
    R, start, end = Addition(Euclidean(3)), np.array([0.0, 0.0, 3.0]), np.array([1.0, 0.0, -6.0])
    fine = solve(lagging(lag), start, end, 1.0, method=Radau(5, R), steps=np.diff(graded(lag)))
    cost = {kind: solve(lagging(lag), start, end, 1.0, method=kind(2, R), steps=10).cost for kind in (Gauss, Radau)}
    assert (abs(cost[Radau] - fine.cost) < abs(cost[Gauss] - fine.cost)) == (lag < 1e-2)


def graded(lag: float) -> np.ndarray:
    """Times that resolve layers at both ends."""
    layer = np.concatenate([[0.0], np.geomspace(min(lag, 0.02) / 4, 0.5, 25)])
    return np.concatenate([layer, 1 - layer[-2::-1]])


@pytest.mark.parametrize("stages", [1, 2, 4])
@pytest.mark.usual(1)
def test_one_stage_is_a_discretization_map_and_solutions_are_continuous(stages: int) -> None:
    problem, start, end = CASES["S^2"]
    found = solve(problem, start, end, 2.0, method=Radau(stages, Projection(S2)), steps=6)
    at = found(found.times[3] + np.array([-1e-9, 0.0, 1e-9]))
    assert np.ptp(at.states, axis=0) == pytest.approx(0, abs=1e-8)
    assert np.ptp(at.costates, axis=0) == pytest.approx(0, abs=1e-8)
    again = solve(problem, start, end, 2.0, method=Radau(stages, Projection(S2)), steps=6, guess=found)
    assert again.cost == pytest.approx(found.cost, rel=1e-12)
    assert again.statistics.iterations <= 1


def test_an_accuracy_raises_the_number_of_stages() -> None:
    problem, start, end = CASES["SO(3) x R^3"]
    R = default_retraction(problem.manifold)
    exact = solve(problem, start, end, 2.0, method=Gauss(5, R), steps=20)
    found = solve(problem, start, end, 2.0, method=Radau(2, R), steps=6, accuracy=1e-7)
    assert found.cost == pytest.approx(exact.cost, rel=1e-6)
    assert found.checks.error <= 1e-7


def test_products_keep_the_method() -> None:
    method = Radau(3, default_retraction(Product(S2, Euclidean(2))))
    assert method.with_stages(2).order == 3
    assert method.on(Projection(S2)).stages == 3
