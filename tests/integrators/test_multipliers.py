"""Discretizing and dualizing commute: the KKT multipliers are the costates of the initial-value integrator."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from retrax.integrators import OptimalControlProblem, PresymplecticIntegrator, Solution, integrate, solve
from retrax.retractions import CotangentLift, DiscretizationMap, Exponential, Midpoint, Projection, Theta

from tests.support.numerics import norm

from .problems import ELLIPSOID, IDENTITY, REST, RIGID, SLEW, SLEW_END, SPACECRAFT, at, rotation


def drifting(q: jax.Array, u: jax.Array) -> jax.Array:
    """A current around the vertical axis, and a control in every direction."""
    return ELLIPSOID.projection(q, u + jnp.cross(jnp.array([0.0, 0.0, 0.5]), q))


EXACT, STEPS = Midpoint(Exponential(RIGID)), 20
DRIFTING = OptimalControlProblem(ELLIPSOID, drifting, lambda q, u: u @ u / 2 + q[0] ** 2 - q[0] * u[1] / 5, 3)
POINTS = np.array([[1.0, 0.0, 0.0], [0.0, 0.5, np.sqrt(1 / 6)]])


def slew() -> tuple[OptimalControlProblem, DiscretizationMap, Solution]:
    return SLEW, EXACT, solve(SLEW, (IDENTITY, REST), (SLEW_END, REST), 60.0, method=EXACT, steps=STEPS)


def drift() -> tuple[OptimalControlProblem, DiscretizationMap, Solution]:
    discretization = Theta(Projection(ELLIPSOID), 0.3)
    return DRIFTING, discretization, solve(DRIFTING, *POINTS, 1.0, method=discretization, steps=8)


@pytest.fixture(
    scope="module",
    params=[slew, pytest.param(drift, marks=pytest.mark.slow)],
    ids=["slew on SO3*R3", "drift on an ellipsoid"],
)
def solved(request: pytest.FixtureRequest) -> tuple[OptimalControlProblem, DiscretizationMap, Solution]:
    solve_it: Callable = request.param
    return solve_it()


def test_the_initial_value_integrator_reproduces_nodes_costates_and_controls(solved):
    problem, discretization, solution = solved
    integrator = PresymplecticIntegrator(CotangentLift(discretization))
    start = jax.tree.map(jnp.asarray, (at(solution.states, 0), at(solution.costates, 0)))
    trajectory = integrate(problem, integrator, start, float(solution.times[1]), solution.steps)
    pairs = (
        (trajectory.q, solution.states),
        (trajectory.p, solution.costates),
        (trajectory.controls, solution.controls),
    )
    for reached, expected in pairs:
        for mine, theirs in zip(jax.tree.leaves(reached), jax.tree.leaves(expected), strict=True):
            assert norm(mine - theirs) < 1e-10 * norm(theirs)
    assert norm(trajectory.stage_times - solution.stage_times) < 1e-12


def test_costates_are_tangent_and_states_on_the_manifold(solved):
    problem, _, solution = solved
    for k in range(solution.steps + 1):
        q, p = at((solution.states, solution.costates), k)
        assert problem.manifold.contains(q, 1e-13)
        assert problem.manifold.is_tangent(q, p, 1e-13)


def test_the_hamiltonian_is_pontryagins_at_the_stages(solved):
    problem, _, solution = solved
    values = jax.vmap(problem.hamiltonian)(solution.stage_states, solution.stage_costates, solution.controls)
    assert norm(solution.hamiltonians - values) < 1e-12 * norm(values)


def test_the_controls_make_the_hamiltonian_stationary_at_the_stage_costates(solved):
    problem, _, solution = solved
    slope = jax.vmap(jax.grad(problem.hamiltonian, argnums=2))
    values = slope(solution.stage_states, solution.stage_costates, jnp.asarray(solution.controls))
    assert norm(values) < 1e-10 * norm(solution.controls)


def test_the_boundary_points_are_met(solved):
    _, _, solution = solved
    assert solution.success
    assert solution.checks.defect < 1e-11
    assert solution.checks.manifold_violation < 1e-13


def test_the_cost_is_the_sum_of_the_running_cost_over_the_stages(solved):
    problem, _, solution = solved
    step = solution.times[1]
    rates = jax.vmap(problem.running_cost)(solution.stage_states, solution.controls)
    assert solution.cost == pytest.approx(float(step * np.sum(rates)), rel=1e-13)


@pytest.mark.slow
@given(angle=st.floats(0.1, 2.5), axis=st.integers(0, 2))
def test_a_slew_about_a_principal_axis_is_the_double_integrator(angle, axis):
    """Its cost from rest to rest is ``6 (J a)^2 / T^3``, and ``N^2 / (N^2 - 1)`` times that in N steps."""
    end = rotation(angle * IDENTITY[axis])
    solution = solve(SLEW, (IDENTITY, REST), (end, REST), 60.0, method=EXACT, steps=STEPS)
    limit = 6 * (SPACECRAFT[axis] * angle) ** 2 / 60.0**3
    assert solution.cost == pytest.approx(limit * STEPS**2 / (STEPS**2 - 1), rel=1e-10)
    assert norm(np.delete(solution.controls, axis, axis=1)) < 1e-9 * norm(solution.controls)
