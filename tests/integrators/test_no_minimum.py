"""Costs without a lower bound: what the iteration saw of that is said, and of costs that have a minimum it is not."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Solver, solve
from retrax.integrators.reporting.result_sentences import sentence
from retrax.manifolds import SO, Euclidean, Product, hat
from retrax.retractions import Cayley, Exponential, Gauss, Midpoint
from scipy.spatial.transform import Rotation

FEWEST = 20  # trials of a search, before it tells that the cost has no lower bound
PLANE, ROTATIONS = Euclidean(2), SO(3)
ON_PLANE, ON_ROTATIONS = Midpoint(Exponential(PLANE)), Midpoint(Cayley(ROTATIONS))
TARGET = Rotation.from_rotvec([0.3, 0.4, 0.5]).as_matrix()
FALLING = sentence("falling")


def pushed(q, u):
    return jnp.array([q[1], u[0]])


def slew(curvature, quartic=0.0):
    def cost(q, u):
        return curvature * u @ u / 2 + quartic * (u @ u) ** 2

    return OptimalControlProblem(ROTATIONS, lambda q, u: q @ hat(u), cost, 3)


@pytest.mark.parametrize("curvature", [1.0, 0.1, 0.01, -0.01, -0.1, -1.0])
@pytest.mark.usual(2)
def test_a_concave_cost_of_a_turn_falls_without_end(curvature):
    solution = solve(slew(curvature), np.eye(3), TARGET, 1.0, method=ON_ROTATIONS, steps=10, throw=False)
    assert solution.success == (curvature > 0)
    assert (solution.result == FALLING) == (curvature < 0)


@pytest.mark.parametrize("quartic", [1.0, 1e-2, 1e-3, 1e-4, 0.0])
@pytest.mark.usual(1)
def test_a_concave_cost_that_far_off_is_convex_has_a_minimum(quartic):
    solution = solve(slew(-1.0, quartic), np.eye(3), TARGET, 1.0, method=ON_ROTATIONS, steps=20, throw=False)
    assert (solution.result == FALLING) == (quartic == 0)


@pytest.mark.parametrize("most", [1, FEWEST - 2, FEWEST - 1, 40, 100])
@pytest.mark.parametrize("power", [2, 4])
@pytest.mark.usual(2)
def test_states_that_pay_more_than_they_cost_escape(power, most):
    problem = OptimalControlProblem(PLANE, pushed, lambda q, u: u @ u / 2 - jnp.sqrt(1 + q[0] ** 2) ** power / 40, 1)
    solution = solve(problem, np.ones(2), None, 2.0, method=ON_PLANE, steps=10, throw=False, max_iterations=most)
    assert solution.success == (power == 2)
    assert (solution.result == FALLING) == (power == 4 and most + 1 >= FEWEST)  # the guess is tried too


@pytest.mark.parametrize("rate", [1.0, 1e-8, 1e-14, 0.0, -1e-8, -1.0])
@pytest.mark.usual(2)
def test_a_horizon_that_is_never_long_enough_is_named(rate):
    problem = OptimalControlProblem(PLANE, pushed, lambda q, u: rate + u @ u / 2, 1)
    solver, ends = Solver(problem, ON_PLANE, 20), (np.zeros(2), np.array([1.0, 0.0]))
    free = solver.solve(*ends, Free(1.0), throw=False)
    assert free.success == (rate > 0)
    if rate != -1e-8:  # where a search ends whose horizon has grown to 1e15, is up to rounding
        assert ("a longer one still costs less" in free.result) == (rate <= 0)
        assert (FALLING in free.result) == (rate < 0)
    held = solver.solve(*ends, Free(1.0, upper=50.0), throw=False)
    assert held.success
    assert held.horizon == pytest.approx(min(50.0, 2.06 * rate**-0.25 if rate > 0 else 50.0), rel=1e-2)


@pytest.mark.parametrize(
    ("time", "price"), [(1.0, 1.0), (1e-3, 1.0), (40.0, 1.0), (200.0, 1.0), (1e6, 1.0), (200.0, 1e-9), (200.0, 1e9)]
)
@pytest.mark.usual(2)
def test_a_horizon_that_grows_is_named_in_all_units(time, price):
    """In other units of the time the same problem, with the same answer; it does not say that a longer one may help."""
    problem = OptimalControlProblem(PLANE, pushed, lambda q, u: price * u @ u / 2, 1)
    grown = solve(problem, np.zeros(2), np.array([1.0, 0.0]), Free(time), method=ON_PLANE, steps=20, throw=False)
    assert grown.horizon > 1e3 * time
    assert grown.cost < price * 6 / (1e3 * time) ** 3  # the least energy over T is 6 / T^3
    begins = f"The iteration limit of a search came before the conditions were met. The horizon grew from {time:.3g} to"
    assert grown.result.startswith(begins)
    assert "or a longer horizon" not in grown.result


@pytest.mark.slow
@pytest.mark.parametrize("price", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("time", [0.1, 10.0, 40.0, 200.0, 1e4])
def test_a_slew_whose_horizon_grows_is_told_so_in_all_units(time, price):
    space = Product(ROTATIONS, Euclidean(3))
    inertia = np.array([12.0, 30.0, 21.0])

    def turned(q, u):
        return q[0] @ hat(q[1]), (u - jnp.cross(q[1], inertia * q[1])) / inertia

    problem = OptimalControlProblem(space, turned, lambda q, u: price * u @ u / 2, 3)
    ends = (np.eye(3), np.zeros(3)), (Rotation.from_rotvec([0.3, -1.0, 0.9]).as_matrix(), np.zeros(3))
    grown = solve(problem, *ends, Free(time), method=Gauss(2, Cayley(space)), steps=10, throw=False)
    assert not grown.success
    assert "a longer one still costs less" in grown.result
    assert "or a longer horizon" not in grown.result
