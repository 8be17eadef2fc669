"""Costs of the first state: closed forms, transversality, and the derivative that a fixed start has there."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Solver, solve
from retrax.manifolds import SO, Euclidean, InvalidInputError, hat
from retrax.retractions import Addition, Cayley, Euler, Gauss, Midpoint

LINE, SO3 = Euclidean(1), SO(3)


def moving(q, u):
    return u


def half_square(q, u, *_):
    return u @ u / 2


METHODS = {"Gauss": Gauss(2, Addition(LINE)), "midpoint": Midpoint(Addition(LINE)), "Euler": Euler(Addition(LINE))}


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("weight", [1e-3, 1.0, 1e3])
@pytest.mark.usual(2)
def test_a_start_that_costs(name, weight):
    """``k (x - 3)^2 / 2`` at the start, 1 at the end of ``x' = u``: ``u = k (x(0) - 3) = (1 - x(0)) / T``."""
    paid = OptimalControlProblem(LINE, moving, half_square, 1, initial_cost=lambda q: weight * (q[0] - 3) ** 2 / 2)
    found = solve(paid, None, np.ones(1), 2.0, method=METHODS[name], steps=4)
    first = (3 * weight + 0.5) / (weight + 0.5)
    np.testing.assert_allclose(found.states[0], first, rtol=1e-10)
    np.testing.assert_allclose(found.controls, (1 - first) / 2, rtol=1e-9)
    np.testing.assert_allclose(found.costates, (1 - first) / 2, rtol=1e-9)
    assert found.cost == pytest.approx(weight * (first - 3) ** 2 / 2 + (1 - first) ** 2 / 4, rel=1e-10)
    assert found.checks.strict_minimum
    assert found.statistics.iterations <= 3


@pytest.mark.parametrize("method", [Gauss, Midpoint, Euler], ids=lambda kind: kind.__name__)
def test_a_linear_quadratic_problem_that_pays_at_both_ends_takes_one_step(method):
    """And one that finds nothing left to do; at the ends costates are the slopes of what these cost."""
    plane, oscillator = Euclidean(2), jnp.array([[0.0, 1.0], [-2.0, -0.3]])
    first, last = np.array([[3.0, 1.5], [1.5, 3.0]]), 5 * np.eye(2)
    problem = OptimalControlProblem(
        plane,
        lambda q, u: oscillator @ q + jnp.array([0.0, 1.0]) * u[0],
        lambda q, u: q @ q / 2 + u @ u / 2,
        1,
        initial_cost=lambda q: (q - 1) @ first @ (q - 1) / 2,
        terminal_cost=lambda q: (q - 1) @ last @ (q - 1) / 2,
    )
    given = method(2, Addition(plane)) if method is Gauss else method(Addition(plane))
    found = solve(problem, Free(np.zeros(2)), None, 2.0, method=given, steps=10)
    assert found.success
    assert found.statistics.iterations <= 2
    np.testing.assert_allclose(found.costates[0], first @ (found.states[0] - 1), rtol=1e-9)
    np.testing.assert_allclose(found.costates[-1], -last @ (found.states[-1] - 1), rtol=1e-9)


TARGET = np.asarray([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])


def drift(q, u, weight):
    return q @ hat(u + jnp.array([0.1, 0.0, 0.3]))


def aside(q, weight):
    return -weight * jnp.trace(q) + q[0, 1] ** 2


ROTATING = OptimalControlProblem(
    SO3, drift, half_square, 3, initial_cost=aside, terminal_cost=lambda q, weight: q[0, 2]
)


@pytest.mark.parametrize(
    "method", [Gauss(3, Cayley(SO3)), Midpoint(Cayley(SO3)), Euler(Cayley(SO3))], ids=lambda m: repr(m)[:6]
)
@pytest.mark.usual(1)
def test_a_free_start_is_where_a_fixed_one_has_no_derivative(method):
    solver = Solver(ROTATING, method, 6)
    found = solver.solve(None, TARGET, 1.5, parameters=2.0)
    R = found.states[0]
    slope = SO3.projection(R, -2.0 * np.eye(3) + 2 * R[0, 1] * np.eye(3)[:, :1] * np.eye(3)[1])
    np.testing.assert_allclose(found.costates[0], slope, atol=1e-9)
    assert found.checks.strict_minimum
    assert found.statistics.iterations <= 12
    fixed = solver.solve(R, TARGET, 1.5, parameters=2.0, guess=found)
    assert fixed.cost == pytest.approx(found.cost, rel=1e-12)
    np.testing.assert_allclose(solver.sensitivity(fixed).start.cost, 0.0, atol=1e-9)


@pytest.mark.parametrize("method", [Gauss(2, Cayley(SO3)), Midpoint(Cayley(SO3))], ids=["Gauss", "midpoint"])
def test_derivatives_with_an_initial_cost(method):
    """Against differences, of the cost by the weight and the horizon, and of the states."""
    solver = Solver(ROTATING, method, 5)
    found, step = solver.solve(None, TARGET, 1.5, parameters=2.0), 1e-5
    by = solver.sensitivity(found)
    near = [solver.solve(None, TARGET, 1.5, parameters=2.0 + s, guess=found) for s in (-step, step)]
    assert by.parameters.cost == pytest.approx((near[1].cost - near[0].cost) / (2 * step), rel=1e-6)
    for name in ("states", "costates", "controls"):
        slope = (getattr(near[1], name) - getattr(near[0], name)) / (2 * step)
        np.testing.assert_allclose(getattr(by.parameters, name), slope, atol=1e-6)
    near = [solver.solve(None, TARGET, 1.5 + s, parameters=2.0, guess=found) for s in (-step, step)]
    assert by.horizon.cost == pytest.approx((near[1].cost - near[0].cost) / (2 * step), rel=1e-6)
    fixed = solver.solve(np.eye(3), TARGET, 1.5, parameters=2.0)
    pair = [
        solver.solve(np.asarray(Cayley(SO3)(jnp.eye(3), s * SO3.basis(jnp.eye(3))[0])), TARGET, 1.5, parameters=2.0)
        for s in (-step, step)
    ]
    assert solver.sensitivity(fixed).start.cost[0] == pytest.approx(
        (pair[1].cost - pair[0].cost) / (2 * step), rel=1e-6
    )


def test_an_initial_cost_with_a_free_horizon_and_bounds():
    """``x' = u``, ``|u| <= 1``, ``int 1 dt`` to 0 from ``x0 >= 1`` that costs ``(x0 - 3)^2 / 2``: ``T = x0 = 2``."""
    paid = OptimalControlProblem(
        LINE, moving, lambda q, u: 1.0, 1, initial_cost=lambda q: (q[0] - 3) ** 2 / 2, control_bounds=(-1, 1)
    )
    solver = Solver(paid, Midpoint(Addition(LINE)), 5)
    found = solver.solve(Free(np.ones(1)), np.zeros(1), Free(10.0))
    assert found.horizon == pytest.approx(2.0, rel=1e-8)
    np.testing.assert_allclose(found.states[0], 2.0, rtol=1e-8)
    assert found.costates[0, 0] == pytest.approx(-1.0, rel=1e-7)
    # Where the horizon tends to zero every condition does, and none is met: that was a success.
    lost = solver.solve(None, np.zeros(1), Free(1.0), throw=False)
    assert not lost.success or lost.horizon == pytest.approx(2.0, rel=1e-8)
    assert lost.success or "The horizon tends to" in lost.result


def test_a_singular_problem_with_an_initial_cost_is_refused():
    flat = OptimalControlProblem(LINE, moving, lambda q, u: q[0] ** 2, 1, initial_cost=lambda q: q[0] ** 2)
    with pytest.raises(
        InvalidInputError, match="the problem has an initial cost, which solve of a singular problem does not"
    ):
        solve(flat, None, np.zeros(1), 1.0, method=Midpoint(Addition(LINE)), steps=4)
