"""Waypoints at given times, beside clamped splines, solves of each piece, and errors of what has no meaning."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, load_solution, solve
from retrax.manifolds import SO, Euclidean, InvalidInputError, hat
from retrax.retractions import Cayley, Gauss, Midpoint, default_retraction
from scipy.interpolate import CubicSpline

CAR = Euclidean(1) * Euclidean(1)
DRIVEN = OptimalControlProblem(CAR, lambda q, u: (q[1], u), lambda q, u: u @ u / 2, 1)
METHOD = Gauss(2, default_retraction(CAR))


@pytest.mark.parametrize("count", [1, 2, 5])
@pytest.mark.usual(1)
def test_positions_of_a_car_make_it_a_clamped_spline(count):
    """Least acceleration through positions alone, at times that are drawn anew, on a mesh of unequal steps."""
    draw = np.random.default_rng(count)
    times = np.sort(draw.uniform(0.2, 3.8, count))
    mesh = np.unique(np.concatenate([np.linspace(0, 4, 9), times]))
    places = draw.uniform(-1, 1, count)
    through = {float(t): (np.array([x]), None) for t, x in zip(times, places, strict=True)}
    start, end = (np.zeros(1), np.array([0.5])), (np.ones(1), np.array([-0.5]))
    found = solve(DRIVEN, start, end, 4.0, method=METHOD, steps=np.diff(mesh), through=through)
    known = CubicSpline([0, *times, 4], [0, *places, 1], bc_type=((1, 0.5), (1, -0.5)))
    assert found.status == "minimum"
    assert np.allclose(found.states[0][:, 0], known(found.times), atol=1e-10)
    assert np.allclose(found.controls[:, 0], known(found.stage_times, 2), atol=1e-8)
    pieces = np.array([known(t, 2) ** 2 for t in (mesh[:-1], mesh[:-1] / 2 + mesh[1:] / 2, mesh[1:])])
    assert found.cost == pytest.approx(np.diff(mesh) @ (np.array([1, 4, 1]) / 6 @ pieces) / 2, rel=1e-9)
    between = np.linspace(0, 4, 57)
    assert np.allclose(found(between).states[1][:, 0], known(between, 1), atol=1e-8)
    assert np.allclose(found(between).costates[1][:, 0], known(between, 2), atol=1e-6)
    again = solve(DRIVEN, start, end, 4.0, method=METHOD, steps=np.diff(mesh), through=through, guess=found)
    assert again.statistics.iterations <= 2  # the second where rounding of large costates is above the tolerance


def test_whole_points_part_a_trajectory_and_costs_of_ends_are_paid_once(tmp_path):
    """Between prescribed attitudes the pieces are independent; the end has a price instead of a place."""
    problem = OptimalControlProblem(
        SO(3),
        lambda q, u, p: q @ hat(u * p),
        lambda q, u, p: u @ u / 2,
        3,
        terminal_cost=lambda q, p: 3 - jnp.trace(q),
        initial_cost=lambda q, p: 2 * (3 - jnp.trace(q)),
        control_bounds=(-1.2, 1.2),
    )
    method, turn = Midpoint(Cayley(SO(3))), Cayley(SO(3))
    middle = np.array(turn(jnp.eye(3), hat(jnp.array([0.5, -0.8, 0.3]))))
    options = {"method": method, "parameters": 1.3}
    found = solve(problem, Free(np.eye(3)), None, 1.5, steps=15, through={0.5: middle}, **options)
    first = solve(problem._with_arguments(terminal_cost=None), Free(np.eye(3)), middle, 0.5, steps=5, **options)
    last = solve(problem._with_arguments(initial_cost=None), middle, None, 1.0, steps=10, **options)
    assert found.success
    assert found.cost == pytest.approx(first.cost + last.cost, rel=1e-9)
    assert np.allclose(found.states[5], middle, atol=1e-10)
    assert np.allclose(found.controls, np.concatenate([first.controls, last.controls]), atol=1e-6)
    assert np.allclose(found.costates[:5], first.costates[:-1], atol=1e-6)
    assert np.allclose(found.costates[5:], last.costates, atol=1e-6)
    found.save(tmp_path / "found")
    assert np.array_equal(load_solution(tmp_path / "found")(0.7).states, found(0.7).states)


def test_waypoints_without_a_node_or_a_fixed_time_are_refused():
    start, end, point = (np.zeros(1), np.zeros(1)), (np.ones(1), np.zeros(1)), (np.ones(1), None)
    given = {"method": METHOD, "steps": 8, "through": {0.25: point}}
    for through, words in (
        ({0.3: point}, "nearest to it are at 0.25, 0.375"),
        ({0.0: point}, "waypoint at 0, and the inner nodes"),
        ({2.0: point}, "waypoint at 2, and the inner nodes"),
        ([point], "through must be a dictionary of points by their times"),
    ):
        with pytest.raises(InvalidInputError, match=words):
            solve(DRIVEN, start, end, 1.0, **given | {"through": through})
    with pytest.raises(InvalidInputError, match="through fixes times"):
        solve(DRIVEN, start, end, Free(1.0), **given)
    for options in ({"steps": None}, {"accuracy": 1e-3}):
        with pytest.raises(InvalidInputError, match="through fixes the nodes at the waypoints"):
            solve(DRIVEN, start, end, 1.0, **given | options)
    periodic = OptimalControlProblem(CAR, DRIVEN.dynamics, DRIVEN.running_cost, 1, periodic=True)
    with pytest.raises(InvalidInputError, match="periodic ends, which solve with through does not treat"):
        solve(periodic, None, None, 1.0, **given)
