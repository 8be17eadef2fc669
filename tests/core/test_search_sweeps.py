"""Searches while a number of the problem is swept: which of them succeed, and what they then have to satisfy."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Solver
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Cayley, Gauss, Midpoint, default_retraction
from scipy.optimize import brentq

from ..integrators.problems import RIGID, SLEW, SPHERE, half_square, spacecraft
from ..integrators.search_cases import PLANE, SLEWS, pendulum

METHODS = {"midpoint": Midpoint, "collocation": lambda retraction: Gauss(2, retraction)}
RIGHT = np.zeros(2), np.array([1.0, 0.0]), 1.0  # a way to the right


@pytest.fixture(params=list(METHODS))
def method(request: Any) -> Any:
    """A method of a retraction, with one stage, and with more."""
    return METHODS[request.param]


@pytest.mark.parametrize("limit", [1e4, 12.0, 8.0, 7.5, 7.0, 1.0])
@pytest.mark.usual(2)
def test_torque_limits_from_loose_ones_to_those_that_no_slew_meets(method, limit):
    slew = OptimalControlProblem(RIGID, spacecraft, half_square, 3, control_bounds=(-limit, limit))
    found = Solver(slew, method(Cayley(RIGID)), 40).solve(*SLEWS, throw=False)
    assert found.success == (limit > 7.2)
    if found.success:
        assert np.abs(found.controls).max() <= limit * (1 + 1e-6)


@pytest.mark.parametrize(("radius", "beside"), [(0.1, 0.05), (0.1, 0.2), (0.3, 0.2), (0.49, 1e-6), (0.55, 0.2)])
@pytest.mark.usual(2)
def test_an_obstacle_from_a_small_one_to_one_around_an_end(method, radius, beside):
    middle = np.array([0.5, beside])
    around = {"disk": lambda q, u: radius**2 - jnp.sum((q - middle) ** 2)}
    free = OptimalControlProblem(PLANE, lambda q, u: u, half_square, 2, constraints=around)
    found = Solver(free, method(Addition(PLANE)), 20).solve(*RIGHT, throw=False)
    assert found.success == (radius < 0.5)
    if found.success:
        assert np.linalg.norm(found.stage_states - middle, axis=1).min() >= radius - 1e-7
        assert found.cost >= 0.5 * (1 - 1e-9)  # of the straight way


@pytest.mark.parametrize("beside", np.linspace(0.2, 0.3, 6))
@pytest.mark.usual(2)
def test_rounding_beside_an_obstacle_that_is_hardly_met_costs_no_iterations(method, beside):
    around = {"disk": lambda q, u: 0.01 - jnp.sum((q - jnp.array([0.5, beside])) ** 2)}
    free = OptimalControlProblem(PLANE, lambda q, u: u, half_square, 2, constraints=around)
    found = Solver(free, method(Addition(PLANE)), 20).solve(*RIGHT)
    assert found.cost == pytest.approx(0.5, rel=1e-6)
    assert found.statistics.iterations <= 14


@pytest.mark.parametrize("height", [0.9, 0.3, -0.1, -0.5])
@pytest.mark.parametrize("kind", ["constraints", "node_constraints"])
@pytest.mark.usual(2)
def test_a_cap_from_one_beside_the_way_to_one_with_an_end_in_it(method, kind, height):
    cap = (lambda q, u: q[1] - height) if kind == "constraints" else (lambda q: q[1] - height)
    turn = OptimalControlProblem(SPHERE, lambda q, u: jnp.cross(u, q), half_square, 3, **{kind: {"cap": cap}})
    way = np.array([1.0, 0.0, 0.0]), np.array([-0.6, 0.0, 0.8]), 1.0
    found = Solver(turn, method(default_retraction(SPHERE)), 25).solve(*way, throw=False)
    assert found.success == (height > 0)
    if found.success:
        at = found.stage_states if kind == "constraints" else found.states
        assert at[:, 1].max() <= height + 1e-7
        assert found.cost == pytest.approx(np.arccos(-0.6) ** 2 / 2, rel=1e-3)


@pytest.mark.parametrize("bound", [0.2, 0.5, 0.8, 1.5, 4.0])
@pytest.mark.parametrize("hill", [0.0, 3.0])
@pytest.mark.usual(2)
def test_a_swing_from_too_little_torque_to_plenty(method, bound, hill):
    cost = lambda q, u: u @ u / 2 + hill * jnp.cos(3.0 * q[0])  # noqa: E731
    swing = OptimalControlProblem(PLANE, pendulum, cost, 1, control_bounds=(-bound, bound))
    found = Solver(swing, method(Addition(PLANE)), 60).solve(np.zeros(2), np.array([np.pi, 0.0]), 6.0, throw=False)
    assert found.success == (bound > 0.6)
    if found.success:
        assert np.abs(found.controls).max() <= bound * (1 + 1e-6)
        energy = found.states[:, 1] ** 2 / 2 - np.cos(found.states[:, 0])
        works = np.abs(np.diff(energy)) - bound * np.abs(np.diff(found.states[:, 0]))
        assert works.max() < 0.02  # power is torque times speed, to the error of the steps


@pytest.mark.parametrize("most", [1, 3, 4, 5])
@pytest.mark.usual(2)
def test_no_more_iterations_than_asked_for(method, most):
    seen = []
    solver = Solver(SLEW, method(Cayley(RIGID)), 30)
    found = solver.solve(
        *SLEWS, throw=False, max_iterations=most, callback=lambda one: seen.append(one.number) and False
    )
    assert found.success == (most == 5)
    assert max(seen) == most  # of each search


@pytest.mark.parametrize("beside", [8e-6, 1e-3, 1e-2, 0.1])
@pytest.mark.parametrize("tolerance", [1e-5, 1e-3])
@pytest.mark.usual(2)
def test_a_guess_whose_end_is_beside_the_end_is_stepped_from(method, beside, tolerance):
    """By less than the tolerance of its size, too."""
    solver = Solver(OptimalControlProblem(PLANE, lambda q, u: u, half_square, 2), method(Addition(PLANE)), 10)
    near, end = solver.solve(*RIGHT), np.array([1.0, beside])
    found = solver.solve(np.zeros(2), end, 1.0, guess=near, tolerance=tolerance)
    np.testing.assert_allclose(found.states[-1], end, atol=tolerance)
    assert found.cost == pytest.approx(end @ end / 2, abs=tolerance)


def polygon_cost(chord: float, area: float, edges: int) -> float:
    """Half the squared length of an open polygon of equal edges on a circle, over a chord, with this area."""

    def shape(turn: float) -> tuple[float, float]:
        """The chord and the area of one of radius one, each edge seen by twice this angle from the middle."""
        whole = edges * turn
        return 2 * np.sin(whole), (edges * np.sin(2 * turn) - np.sin(2 * whole)) / 2

    def lacks(turn: float) -> float:
        own = shape(turn)
        return area * own[0] ** 2 - chord**2 * own[1]

    turn = brentq(lacks, 1e-9, np.pi / edges, xtol=1e-16)
    radius = np.sqrt((chord**2 + area) / (shape(turn)[0] ** 2 + shape(turn)[1]))
    return (2 * edges * radius * np.sin(turn)) ** 2 / 2


@pytest.mark.parametrize("height", [1e-6, 1e-3, 0.03, 0.3, 3.0])
def test_ways_in_heisenbergs_group_are_arcs_of_polygons(height):
    """To points from beside the start to above it, where a search leaves a guess that no control moves."""
    space, steps = Euclidean(3), 30
    group = OptimalControlProblem(
        space, lambda q, u: jnp.array([u[0], u[1], (q[0] * u[1] - q[1] * u[0]) / 2]), half_square, controls=2
    )
    solver = Solver(group, Midpoint(Addition(space)), steps)
    for chord, area in ((1.0, height), (height, 1.0)):
        found = solver.solve(np.zeros(3), np.array([chord, 0.0, area]), 1.0, throw=False)
        assert found.success
        assert found.cost == pytest.approx(polygon_cost(chord, area, steps), rel=1e-6)


@pytest.mark.parametrize("beside", [0.3, 1e-3, 1e-6, 1e-9, 1e-12, 1e-14])
@pytest.mark.usual(2)
def test_turns_to_beside_an_opposite_point(method, beside):
    """From a turn that is isolated to one of many that rounding does not tell apart."""
    way = np.array([0.0, 0.0, 1.0]), np.array([np.sin(beside), 0.0, -np.cos(beside)]), 1.0
    free = OptimalControlProblem(SPHERE, lambda q, u: jnp.cross(u, q), half_square, controls=3)
    found = Solver(free, method(default_retraction(SPHERE)), 20).solve(*way, throw=False)
    assert found.cost == pytest.approx((np.pi - beside) ** 2 / 2, rel=1e-6)
    assert found.success


@pytest.mark.parametrize(("spin", "far"), [(0.1, False), (1.0, False), (4.0, False), (8.0, True), (16.0, True)])
@pytest.mark.usual(2)
def test_directions_that_turn_by_themselves(method, spin, far):
    """From slowly to many times round in the horizon: beside the turn the cost is that of a geodesic."""
    axis = np.array([1.0, 2.0, 2.0]) / 3.0
    turning = OptimalControlProblem(SPHERE, lambda q, u: jnp.cross(u + spin * axis, q), half_square, controls=3)
    way = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), 1.0
    found = Solver(turning, method(default_retraction(SPHERE)), 40).solve(*way)
    along = axis * (axis @ way[1])
    back = along + (way[1] - along) * np.cos(spin) - np.cross(axis, way[1]) * np.sin(spin)
    angle = np.arccos(back @ way[0])
    assert far or found.cost == pytest.approx(angle**2 / 2, rel=0.02, abs=0.01)
