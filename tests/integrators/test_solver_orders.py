"""Orders of the Gauss methods in the boundary-value problem, their Newton iteration, and the extremals that they are
steps of."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, PresymplecticIntegrator, Solver, integrate
from retrax.manifolds import Euclidean, Sphere
from retrax.retractions import Gauss, Projection, default_retraction

from tests.support.numerics import slope

SPHERE = Sphere(2)
PENDULUM = SPHERE * Euclidean(3)
START = np.array([1.0, 0, 0]), np.zeros(3)
END = np.array([0.6, 0.0, 0.8]), np.array([0.1, 0.0, 0.2])


def spinning(q, u):
    """A direction turned by a rate, which controls change against friction."""
    return jnp.cross(q[1], q[0]), u - 0.3 * q[1] + 0.2 * jnp.cross(q[0], q[1])


def cost(q, u):
    return u @ u / 2 + 0.3 * q[0][2] ** 2 + 0.1 * q[1] @ q[1]


PROBLEM = OptimalControlProblem(PENDULUM, spinning, cost, 3)


@cache
def solver_of(stages):
    return Solver(PROBLEM, Gauss(stages, default_retraction(PENDULUM)), 8)


def solved(stages, steps):
    return [solver_of(stages).with_steps(n).solve(START, END, 1.0) for n in steps]


@pytest.fixture(scope="module")
def fine():
    """Order 8 with steps far below those that are measured; its nodes are among theirs."""
    return solved(4, [24])[0]


@pytest.mark.parametrize(("stages", "steps"), [(1, (6, 12, 24)), (2, (3, 6, 12)), (3, (4, 6, 8))])
@pytest.mark.usual(1)
def test_orders_in_states_costates_and_cost(fine, stages, steps):
    found = solved(stages, steps)
    for part in (lambda s: s.states, lambda s: s.costates):
        errors = []
        for n, solution in zip(steps, found, strict=True):
            there = jax.tree.map(lambda leaf, n=n: leaf[:: 24 // n], part(fine))
            pairs = zip(jax.tree.leaves(part(solution)), jax.tree.leaves(there), strict=True)
            errors.append(max(np.max(np.abs(a - b)) for a, b in pairs))
        assert slope(1 / np.array(steps), np.array(errors), 1e-12) > 2 * stages - 0.4
    errors = np.array([abs(solution.cost - fine.cost) for solution in found])
    assert slope(1 / np.array(steps), errors, 1e-13) > 2 * stages - 0.4


@pytest.mark.slow
def test_costates_are_those_that_the_integrator_propagates():
    (found,) = solved(2, [4])
    q0, p0 = (jax.tree.map(lambda leaf: leaf[0], part) for part in (found.states, found.costates))
    path = integrate(PROBLEM, PresymplecticIntegrator(Gauss(2, default_retraction(PENDULUM))), (q0, p0), 0.25, 4)
    for part, own in ((path.q, found.states), (path.p, found.costates)):
        for a, b in zip(jax.tree.leaves(part), jax.tree.leaves(own), strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-10)
    np.testing.assert_allclose(np.reshape(path.controls, (-1, 3)), found.controls, rtol=0, atol=1e-9)


@pytest.fixture(scope="module")
def weighted():
    """Solver for a terminal cost with a weight."""
    problem = OptimalControlProblem(
        SPHERE,
        lambda q, u: jnp.cross(u + jnp.array([0, 0.1, 0.4]), q),
        lambda q, u: u @ u / 2 + q[0] / 10,
        3,
        terminal_cost=lambda q, weight: weight * (q[0] ** 3 + q[1] * q[2] / 2),
    )
    return Solver(problem, Gauss(2, Projection(SPHERE)), 3)


@pytest.mark.parametrize("weight", [-30.0, -1.0, 1e-3, 0.3, 3.0, 30.0, 1e3])
@pytest.mark.usual(2)
def test_a_terminal_cost_at_a_fixed_end_changes_neither_the_trajectory_nor_the_iteration(weighted, weight):
    """It is a constant there; its curvature acts on all points of the last step, and leaves Newton's iteration
    quadratic."""
    (free, few), (found, many) = (stationarity_of(weighted, own) for own in (0.0, weight))
    np.testing.assert_allclose(found.states, free.states, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.controls, free.controls, rtol=0, atol=1e-11 * (1 + abs(weight)))
    assert abs(np.sum(many > 1e-11) - np.sum(few > 1e-11)) <= 1  # below, rounding decides on one more
    assert np.all(many[2:] <= np.maximum(10 * many[1:-1] ** 1.7, 1e-11))


def stationarity_of(solver, weight):
    """The solution, and the stationarity of all iterates."""
    seen = []
    found = solver.solve(START[0], END[0], 1.0, parameters=weight, callback=lambda i: seen.append(i.stationarity[0]))
    return found, np.array(seen)


@pytest.mark.parametrize("tolerance", np.geomspace(1e-13, 1e-3, 31))
def test_a_tolerance_between_the_measures_of_a_gap_ends_at_the_point_that_was_asked_for(tolerance):
    """The gap counts defects of the points too, by other units than the nodes: it may exceed the tolerance alone."""
    found = solver_of(3).solve(START, END, 1.0, tolerance=tolerance)
    assert found.checks.defect <= tolerance
    np.testing.assert_allclose(found.states[0][-1], END[0], atol=1e3 * tolerance)
