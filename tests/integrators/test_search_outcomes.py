"""Outcomes of searches through the place where a problem stops having a solution, or the way there changes."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Solver
from retrax.integrators.reporting.result_sentences import Result
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Cayley, Gauss, Midpoint, default_retraction

from tests.integrators.problems import RIGID, SLEW, SPHERE, half_square, rotation, spacecraft
from tests.integrators.search_cases import CASES, SLEWS, pendulum, same

PLANE = Euclidean(2)
START, AHEAD = np.zeros(2), np.array([1.0, 0.0])
ROUND = 1e-8  # of a way up: all circles around it cost the same but for rounding


@pytest.fixture(params=[Midpoint, partial(Gauss, 2)], ids=["midpoint", "collocation"])
def method(request) -> Callable[[Any], Any]:
    """A method of a retraction, with one stage, and with more."""
    return request.param


def moved(**limits: Any) -> OptimalControlProblem:
    """A point in the plane that its controls move."""
    return OptimalControlProblem(PLANE, lambda q, u: u, half_square, 2, **limits)


def disk(radius: float, beside: float) -> dict[str, Any]:
    """The outside of a disk around a point beside the middle of the straight way."""
    middle = jnp.array([0.5, beside])
    return {"disk": lambda q, u: radius**2 - jnp.sum((q - middle) ** 2)}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.usual(2)
def test_a_search_from_its_solution_takes_few_iterations(name):
    """With limits, whose barrier is lowered once more, no more than half of the iterations."""
    solver, way, options = CASES[name]()
    found = solver.solve(*way, **options)
    again = solver.solve(*way, guess=found, **options)
    assert again.statistics.iterations <= max(2, found.statistics.iterations // 2)
    assert again.cost == pytest.approx(found.cost, rel=1e-8)


@pytest.mark.parametrize("limit", [1e4, 12.0, 8.0, 7.5, 7.0, 3.0, 1.0])
@pytest.mark.usual(2)
def test_torque_limits_from_far_to_infeasible(method, limit):
    """The turn about the slowest axis needs 7.2 N m."""
    slew = OptimalControlProblem(RIGID, spacecraft, half_square, 3, control_bounds=(-limit, limit))
    found = Solver(slew, method(Cayley(RIGID)), 40).solve(*SLEWS, throw=False)
    assert found.success == (limit > 7.2)
    if found.success:
        assert np.max(np.abs(found.controls)) <= limit * (1 + 1e-6)


@pytest.mark.parametrize(("radius", "beside"), [(0.1, 0.05), (0.1, 0.2), (0.3, 0.2), (0.49, 1e-6), (0.55, 0.2)])
@pytest.mark.usual(2)
def test_an_obstacle_from_beside_the_way_to_around_an_end(method, radius, beside):
    solver = Solver(moved(constraints=disk(radius, beside)), method(Addition(PLANE)), 20)
    found = solver.solve(START, AHEAD, 1.0, throw=False)
    assert found.success == (radius < 0.5)
    if found.success:
        assert found.cost >= 0.5 * (1 - 1e-8), "no way is shorter than the straight one"


@pytest.mark.parametrize("beside", np.linspace(0.2, 0.3, 6))
@pytest.mark.usual(2)
def test_an_obstacle_that_is_hardly_met_takes_few_iterations(method, beside):
    solver = Solver(moved(constraints=disk(0.1, beside)), method(Addition(PLANE)), 20)
    found = solver.solve(START, AHEAD, 1.0)
    assert found.statistics.iterations <= 14
    assert found.cost == pytest.approx(0.5, rel=1e-6)


@pytest.mark.parametrize("height", [0.9, 0.3, -0.1, -0.5])
@pytest.mark.parametrize("kind", ["constraints", "node_constraints"])
@pytest.mark.usual(2)
def test_a_cap_of_the_sphere_from_beside_the_way_to_around_an_end(method, kind, height):
    cap = (lambda q, u: q[1] - height) if kind == "constraints" else (lambda q: q[1] - height)
    turn = OptimalControlProblem(SPHERE, lambda q, u: jnp.cross(u, q), half_square, 3, **{kind: {"cap": cap}})
    way = np.array([1.0, 0.0, 0.0]), np.array([-0.6, 0.0, 0.8]), 1.0
    found = Solver(turn, method(default_retraction(SPHERE)), 25).solve(*way, throw=False)
    assert found.success == (height > 0)


@pytest.mark.parametrize("bound", [0.2, 0.5, 0.8, 1.5, 4.0])
@pytest.mark.parametrize("hill", [0.0, 3.0])
@pytest.mark.usual(2)
def test_a_swing_from_too_little_torque_to_more_than_it_needs(method, bound, hill):
    cost = lambda q, u: u @ u / 2 + hill * jnp.cos(3.0 * q[0])  # noqa: E731
    swing = OptimalControlProblem(PLANE, pendulum, cost, 1, control_bounds=(-bound, bound))
    way = np.zeros(2), np.array([np.pi, 0.0]), 6.0
    found = Solver(swing, method(Addition(PLANE)), 60).solve(*way, throw=False)
    assert found.success == (bound > 0.6)


@pytest.mark.parametrize("most", range(2, 7))
@pytest.mark.usual(2)
def test_a_limit_of_iterations_is_kept(method, most):
    solver = Solver(SLEW, method(Cayley(RIGID)), 30)
    needed = solver.solve(*SLEWS).statistics.iterations
    found = solver.solve(*SLEWS, throw=False, max_iterations=most)
    assert found.success == (most >= needed)
    assert found.statistics.iterations == min(most, needed)
    near = found.result.startswith("The iteration limit came near an extremal")
    assert found.success or near or found.result == Result[Result.too_many_iterations]


@pytest.mark.parametrize("height", [1e-9, 1e-6, 1e-3, 0.03, 0.3, 3.0])
@pytest.mark.usual(2)
def test_ways_from_beside_the_start_to_above_it_in_the_heisenberg_group(method, height):
    """Straight up the optimum is a circle of area ``z``, which costs ``2 pi z``; from its reflection it is the same."""
    space = Euclidean(3)
    group = OptimalControlProblem(
        space, lambda q, u: jnp.array([u[0], u[1], (q[0] * u[1] - q[1] * u[0]) / 2]), half_square, controls=2
    )
    solver, costs = Solver(group, method(Addition(space)), 60), []
    for end in (np.array([height, 0.0, 1.0]), np.array([-height, 0.0, 1.0])):
        found = solver.solve(np.zeros(3), end, 1.0, throw=False)
        assert found.success or height < ROUND
        costs.append(found.cost)
    assert costs[0] == pytest.approx(costs[1], rel=1e-8 if height > ROUND else 1e-3)
    if height < 1e-3:
        assert costs[0] == pytest.approx(2 * np.pi, rel=0.01)


@pytest.mark.parametrize("beside", [0.3, 1e-3, 1e-6, 1e-9, 1e-12, 1e-14])
@pytest.mark.usual(2)
def test_turns_to_beside_the_opposite_point(method, beside):
    """The cost of a turn by an angle is half its square, up to half a turn."""
    free = OptimalControlProblem(SPHERE, lambda q, u: jnp.cross(u, q), half_square, controls=3)
    way = np.array([0.0, 0.0, 1.0]), np.array([np.sin(beside), 0.0, -np.cos(beside)]), 1.0
    found = Solver(free, method(default_retraction(SPHERE)), 20).solve(*way)
    assert found.cost == pytest.approx((np.pi - beside) ** 2 / 2, rel=0.01)


@pytest.mark.parametrize("spin", [0.1, 1.0, 4.0, 8.0, 16.0])
@pytest.mark.usual(2)
def test_a_direction_that_turns_by_itself(method, spin):
    """In the frame that turns with it the way is a turn by one angle: no direction needs more than half a turn."""
    axis = spin * np.array([1.0, 2.0, 2.0]) / 3.0
    turning = OptimalControlProblem(SPHERE, lambda q, u: jnp.cross(u + axis, q), half_square, controls=3)
    way = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), 1.0
    found = Solver(turning, method(default_retraction(SPHERE)), 80).solve(*way)
    back = rotation(-axis) @ way[1]
    assert found.cost == pytest.approx(np.arccos(back[2]) ** 2 / 2, rel=0.05)


def test_steps_of_any_turn_below_half_a_turn(method):
    """The guess is steps that rest amid their parts of the way, whose ends are far apart."""
    solver = Solver(SLEW, method(Cayley(RIGID)), 2)
    for angle in np.deg2rad([20.0, 80.0, 120.0, 126.0, 130.0, 140.0, 170.0]):
        end = rotation(angle * np.array([1.0, 2.0, -2.0]) / 3), np.zeros(3)
        assert solver.solve(SLEWS[0], end, SLEWS[2]).success


def test_members_of_a_batch_are_found_as_alone(method):
    """One is at its end at once, the others are on their way."""
    free = OptimalControlProblem(SPHERE, lambda q, u: jnp.cross(u, q), half_square, 3)
    solver, north = Solver(free, method(default_retraction(SPHERE)), 15), np.array([0.0, 0.0, 1.0])
    ends = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.6, 0.0, -0.8]])
    both = solver.solve_many(north, ends, 1.0)
    assert both.success.all()
    for k, end in enumerate(ends):
        same(both[k].states, solver.solve(north, end, 1.0).states)
