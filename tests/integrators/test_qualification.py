"""Constraints that do not determine their multipliers: the record says so, and what to try."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import Free, OptimalControlProblem, Solver, solve
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Gauss

PLANE = Euclidean(2)
TOGETHER = "with derivatives that depend on each other: their multipliers are not determined one by one"


def solver_of(limits: dict[str, Any], **options: Any) -> Solver:
    def cart(q: Array, u: Array, *_: Any) -> Array:
        return jnp.stack([q[1], u[0]])

    problem = OptimalControlProblem(PLANE, cart, lambda q, u, *_: u @ u / 2, 1, constraints=limits, **options)
    return Solver(problem, Gauss(2, Addition(PLANE)), 10)


def solved(solver: Solver, parameters: Any = None) -> Any:
    return solver.solve(np.zeros(2), np.array([1.0, 0.0]), 1.0, parameters=parameters, throw=False)


def test_a_limit_that_is_said_twice_has_two_multipliers_that_are_not_determined():
    """Through the difference of both at which one holds alone; their sum is that of one."""
    unit = np.array([3.0, 7.0])

    def both(q: Array, u: Array, more: Array) -> Array:
        return unit * jnp.stack([q[1] - 1.3, q[1] - 1.3 - more])

    solver = solver_of({"speed": both})
    for more in (0.0, 1e-14, 1e-4, 1e-2, 1.0):
        found = solved(solver, more)
        assert found.success
        twice = f"speed[0] and speed[1] hold the trajectory near t = 0.378868 {TOGETHER}"
        assert (twice in found.result) == (more < 1e-10), more
        assert ("try to leave out what follows from the others" in found.result) == (more < 1e-10)
        if more != 1e-4:  # between, the second one is felt
            assert np.max(found.multipliers["speed"] @ unit) == pytest.approx(28.38292, rel=1e-5)
            assert found.checks.strict_minimum == (more > 1e-10)


@pytest.mark.parametrize("room", [0.0, 0.2])
def test_an_equation_of_an_end_on_a_limit_is_said_with_both_names(room):
    """The place where the trajectory ends, at any speed, and a wall beyond which no node lies; a third state rests."""
    problem = OptimalControlProblem(
        PLANE * Euclidean(1), lambda q, u: (jnp.stack([q[0][1], u[0]]), u[1:]), lambda q, u: u @ u / 2, 2,
        node_constraints={"wall": lambda q: q[0][0] - 1.0 - room},
        boundary_constraints={"place": lambda first, last: last[0][0] - 1.0},
    )  # fmt: skip
    found = solve(problem, (np.zeros(2), np.zeros(1)), None, 1.0, steps=10, throw=False)
    assert (TOGETHER in found.result) == (room == 0.0), found.result
    if room == 0.0:
        assert "wall" in found.result
        assert "place" in found.result
    else:
        assert found.cost == pytest.approx(1.5, rel=1e-9)


def test_a_limit_on_a_bound_is_said_with_both_names():
    found = solved(solver_of({"force": lambda q, u: u[0] - 5}, control_bounds=(-5.0, 5.0)))
    assert found.success
    assert f"control_bounds upper[0] and force hold the trajectory near t = 0.0211325 {TOGETHER}" in found.result


def test_an_equation_between_two_inequalities_is_said_to_leave_no_room():
    found = solved(solver_of({"line": lambda q, u: jnp.stack([q[1] - 6 * q[0], 6 * q[0] - q[1]])}))
    assert not found.success
    assert "line[0] and line[1] hold the trajectory" in found.result
    assert "try to leave room between them, or to write an equation into the dynamics" in found.result


@pytest.mark.parametrize("room", [0.0, 1e-3, 1.0])
def test_an_equation_that_holds_all_along_is_named_too(room):
    """Two rates that are to be the same, by two inequalities: neither varies along the trajectory."""
    limits = {"over": lambda q, u, r: q[0] - q[1] - r, "under": lambda q, u, r: q[1] - q[0] - r}
    problem = OptimalControlProblem(
        PLANE, lambda q, u, r: u, lambda q, u, r: (u[0] ** 2 + 2 * u[1] ** 2 + q[0]) / 2, 2, constraints=limits
    )
    solver = Solver(problem, Gauss(2, Addition(PLANE)), 10)
    found = solver.solve(np.zeros(2), np.ones(2), 1.0, parameters=room, throw=False)
    named = "over and under hold the trajectory" in found.result
    assert named == (room == 0)
    assert named == ("try to leave room between them, or to write an equation into the dynamics" in found.result)
    assert found.checks.strict_minimum == (room > 0)


def test_a_limit_without_slope_is_named():
    """``a v + v^3`` through the slopes at which a multiplier is large, and at which there is none."""

    def cubic(q: Array, u: Array, slope: Array) -> Array:
        v = q[1] - 1.3 - slope[1]
        return slope[0] * v + v**3

    solver = solver_of({"speed": cubic})
    # Where there is none, the iteration ends now here, now there, as little things decide.
    for slope, aside in ((1.0, 0.0), (1e-2, 0.0), *((0.0, 1e-7 * k) for k in range(8))):
        found = solved(solver, (slope, aside))
        assert found.success == (slope > 0)
        assert ("The derivative of speed vanishes where it holds the trajectory" in found.result) == (slope == 0)


def test_a_limit_that_is_flat_on_one_side_is_named():
    """``max(v - a, 0)^2`` holds by multipliers without bound, at a speed that is too high by the root of what counts as
    zero."""

    def squared(q: Array, u: Array, share: Array) -> Array:
        over = q[1] - 1.3
        return share * over + (1 - share) * jnp.maximum(over, 0.0) ** 2

    solver = solver_of({"speed": squared})
    for share in (1.0, 0.5, 1e-2, 0.0):
        found = solved(solver, share)
        assert ("The derivative of speed vanishes where it holds the trajectory" in found.result) == (share == 0)


def test_limits_that_are_independent_say_nothing():
    """Active bounds of force and speed at once, and limits that do not hold it."""
    limits = {"speed": lambda q, u: q[1] - 1.3, "low": lambda q, u: jnp.stack([-9 - q[1], -9 - 2 * q[1]])}
    found = solved(solver_of(limits, control_bounds=(-6.0, 6.0)))
    assert found.success
    assert found.checks.strict_minimum
    assert found.result == "The equations are solved to the tolerance asked for."


def test_an_end_outside_a_constraint_is_no_success():
    """The constraint holds at the stages, which begin behind the start: through the place at which the start is on
    it."""
    solver = solver_of({"gate": lambda q, u, place: place - q[0]})
    for place in (-0.5, -1e-9, 0.0, 1e-6, 1e-3, 0.1):
        found = solved(solver, place)
        assert found.success == (place <= 0), place
        assert found.result.startswith("The start violates gate by") == (place > 0), place
    free = solver.solve(None, np.array([1.0, 0.0]), 1.0, guess=solved(solver, -0.5), parameters=0.1)
    assert free.success


def test_an_end_outside_a_constraint_is_named_where_the_solve_fails():
    """A force that cannot leave the forbidden side before the first stage, through the place at which the start is on
    it."""
    solver = solver_of({"gate": lambda q, u, place: place - q[0]}, control_bounds=(-8.0, 8.0))
    for place in (-0.5, 0.0, 0.1, 0.3):
        found = solved(solver, place)
        assert found.success == (place <= 0), place
        assert ("The start violates gate by" in found.result) == (place > 0), place


def test_two_bounds_of_one_control_are_not_said_to_leave_no_room():
    """An end that cannot be reached, because the momentum of a wheel changes as that of its body: through the one that
    can."""

    def wheel(q: Array, u: Array) -> Array:
        return jnp.stack([q[1], u[0], -u[0]])

    space = Euclidean(3)
    limits = {"wheel": lambda q, u: q[2] ** 2 - 4.0}
    problem = OptimalControlProblem(
        space, wheel, lambda q, u: u @ u / 2, 1, constraints=limits, control_bounds=(-6.5, 6.5)
    )
    solver = Solver(problem, Gauss(2, Addition(space)), 10)
    for last in (0.0, 1e-3, 1.0):
        found = solver.solve(np.zeros(3), np.array([1.0, 0.0, last]), 1.0, throw=False)
        assert found.success == (last == 0.0)
        assert "control_bounds lower[0] and control_bounds upper[0]" not in found.result


def test_a_constraint_without_entries_is_none():
    found = solved(solver_of({"none": lambda q, u: jnp.zeros(0)}))
    assert found.success
    assert found.cost == pytest.approx(6.0, rel=1e-9)


def test_the_stages_at_which_a_limit_holds_are_counted():
    """A limit of the speed through the largest one without it, 1.5, in units of any size."""

    def limit(q: Array, u: Array, given: Array) -> Array:
        return given[1] * (q[1] - given[0])

    solver = solver_of({"speed": limit}, control_bounds=(-50.0, 50.0))
    for unit in (1e-9, 1.0, 1e9):
        for largest in (1.2, 1.4, 1.49, 1.51, 1.7, 9.0):
            found = solved(solver, np.array([largest, unit]))
            speeds = found.stage_states[:, 1]
            held = int(np.sum(speeds > largest - 1e-7))
            assert found.success
            assert found.checks.active == {"control_bounds lower": 0, "control_bounds upper": 0, "speed": held}
            assert (held > 0) == (largest < 1.5)


def test_a_bound_that_holds_all_along_is_counted_at_all_stages():
    line = Euclidean(1)
    problem = OptimalControlProblem(
        line, lambda q, u: u, lambda q, u: (u[0] - 2) ** 2 / 2, 1, control_bounds=(-1.0, 1.0)
    )
    found = Solver(problem, Gauss(2, Addition(line)), 5).solve(np.zeros(1), None, 1.0)
    assert found.checks.active == {"control_bounds lower": 0, "control_bounds upper": 10}


@pytest.mark.parametrize("iterations", range(1, 40, 3))
@pytest.mark.usual(2)
def test_a_trajectory_on_its_way_through_an_obstacle_is_held_by_nothing(iterations):
    """In the middle of a disc the derivative vanishes, where the disc is violated and holds nothing."""

    def velocity(q, u):
        pull = 0.2 / ((q[0] - 2) ** 2 + q[1] ** 2 + 0.5)
        return jnp.stack([jnp.cos(u[0]) - pull * q[1], jnp.sin(u[0]) + pull * (q[0] - 2)])

    disc = {"disc": lambda q, u: 0.9**2 - (q[0] - 2.2) ** 2 - (q[1] + 0.6) ** 2}
    problem = OptimalControlProblem(PLANE, velocity, lambda q, u: 1.0, 1, constraints=disc)
    ends = np.zeros(2), np.array([4.0, 0.0]), Free(4.0, 0.5, 20.0)
    found = solve(problem, *ends, method=Gauss(2, Addition(PLANE)), steps=20, max_iterations=iterations, throw=False)
    assert "derivative of disc" not in found.result
