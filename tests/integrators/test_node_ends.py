"""Ends of trajectories with constraints at the nodes: prescribed, in part or as a whole, by equations, or shared."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import (
    Free,
    OptimalControlProblem,
    Phase,
    Solver,
    default_guess,
    solve,
    solve_phases,
)
from retrax.integrators.boundary_value.inputs.arguments import BoundaryData
from retrax.integrators.boundary_value.inputs.inputs import Inputs
from retrax.integrators.boundary_value.inputs.options import Options
from retrax.integrators.boundary_value.reformulations import restarts
from retrax.manifolds import Euclidean, Sphere, hat
from retrax.retractions import Addition, Cayley, Gauss, Midpoint, default_retraction
from scipy.spatial.transform import Rotation

from tests.integrators.problems import IDENTITY, PLANE, REST, RIGID, below, half_square, particle

LINES = Euclidean(1) * Euclidean(1)
START, END = np.array([0.0, 1.0]), np.array([0.0, -1.0])
METHODS = Midpoint(Addition(PLANE)), Gauss(2, Addition(PLANE))
BOTH = pytest.mark.parametrize("method", METHODS, ids=["midpoint", "Gauss"])


BEYOND = {
    "straight": lambda q: q[1][0] - 7.0,
    "maximum": lambda q: jnp.maximum(-1.0, q[1][0] - 7.0),
    "softplus": lambda q: jax.nn.softplus(500 * (q[1][0] - 7.0)) / 500 - 0.01,
}


@pytest.mark.parametrize("name", BEYOND)
@pytest.mark.usual(1)
def test_what_is_flat_far_from_an_end_is_asked_for_there(name):
    """The end is prescribed in part; at most points that somebody would look at, none of the limits has a slope."""
    start, end, limit = (np.zeros(1), np.zeros(1)), (np.ones(1), None), BEYOND[name]
    problem = OptimalControlProblem(
        LINES,
        lambda q, u: (q[1], u),
        half_square,
        1,
        terminal_cost=lambda q: -40.0 * q[1][0],
        node_constraints={"speed": limit},
    )
    for method in (Midpoint(default_retraction(LINES)), Gauss(2, default_retraction(LINES))):
        guess = default_guess(problem, method, start, (np.ones(1), np.zeros(1)), 10)
        found = solve(problem, start, end, 1.0, method=method, steps=10, guess=guess)
        assert float(limit((found.states[0][-1], found.states[1][-1]))) == pytest.approx(0.0, abs=1e-9)
        assert found.node_multipliers["speed"][-1, 0] > 1


@BOTH
@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e11])
@pytest.mark.usual(2)
def test_a_turn_leaves_both_ends_their_limits_in_any_unit(method, unit):
    problem = OptimalControlProblem(
        PLANE,
        particle,
        lambda q, u: u @ u / 2 / unit**2,
        1,
        periodic=lambda q: -q,
        initial_cost=lambda q: 1e3 * (q[0] / unit - 1) ** 2,
        node_constraints={"ceiling": lambda q: q[0] - 0.3 * unit},
    )
    guess = default_guess(problem, method, np.zeros(2), np.zeros(2), 10)
    assert solve(problem, None, None, 1.0, method=method, steps=10, guess=guess).states[0, 0] == pytest.approx(
        0.3 * unit, rel=1e-8
    )


@BOTH
def test_periodic_ends_are_one_node_of_a_ceiling_that_is_optimised(method):
    problem = OptimalControlProblem(
        PLANE,
        particle,
        lambda q, u, a: u @ u / 2 + 100 * (q[0] - 0.2) ** 2 + 20 * (a - 0.05) ** 2,
        1,
        periodic=True,
        node_constraints={"ceiling": lambda q, a: q[0] - a},
    )
    guess = default_guess(problem, method, np.zeros(2), np.zeros(2), 10)
    found = solve(problem, None, None, 1.0, method=method, steps=10, guess=guess, parameters=Free(0.1))
    assert found.checks.strict_minimum
    assert found.parameters == pytest.approx(0.175)
    assert found.node_multipliers["ceiling"][0, 0] == 0


@BOTH
@pytest.mark.parametrize("above", [-1e-3, -1e-9, -1e-12, 0.0, 1e-12, 1e-10, 1e-3])
@pytest.mark.usual(2)
def test_an_end_is_swept_across_a_ceiling_that_moves_with_the_time(method, above):
    """The end, and with the horizon its time, are prescribed."""
    limits = {"ceiling": lambda q, t: q[0] - 0.1 * (1 - t) + above}
    problem = OptimalControlProblem(
        PLANE,
        lambda q, u, t: particle(q, u),
        lambda q, u, t: u @ u / 2,
        1,
        time_dependent=True,
        node_constraints=limits,
    )
    found = solve(problem, START, np.array([0.0, 0.3]), 1.0, method=method, steps=20, throw=False)
    assert found.success == (above < 1e-5)
    assert ("The end violates ceiling" in found.result) == (above > 1e-5)
    assert found.cost == pytest.approx(3.395, rel=2e-2)
    assert found.statistics.iterations < 25


CEILINGS = {
    "at stages": lambda above: {"constraints": {"ceiling": lambda q, u: q[0] - 0.3 + above}},
    "at nodes": lambda above: {"node_constraints": {"ceiling": lambda q: q[0] - 0.3 + above}},
}


@pytest.mark.parametrize("place", CEILINGS)
@pytest.mark.parametrize("above", [-0.1, -1e-3, 1e-3, 0.1])
@pytest.mark.usual(2)
def test_one_search_is_enough_for_an_end_beyond_a_ceiling(place, above, monkeypatch):
    """No search changes what is prescribed."""
    begun, restart = list[float](), restarts.from_feasible_trajectory
    monkeypatch.setattr(restarts, "RESTARTS", (lambda *given: begun.append(above) or restart(*given),))
    problem = OptimalControlProblem(
        PLANE, particle, half_square, 1, control_bounds=(-1e3, 1e3), **CEILINGS[place](above)
    )
    method = Gauss(2, Addition(PLANE))
    found = solve(problem, START, np.array([0.3, -1.0]), 1.0, method=method, steps=10, throw=False)
    assert ("The end violates ceiling" in found.result) == (not found.success) == (above > 0)
    assert not begun


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_limit_that_a_control_can_meet_leaves_the_restarts(sign):
    """The end alone violates the limit, at each control but those that are large enough."""
    problem = OptimalControlProblem(
        PLANE, particle, half_square, 1, constraints={"reach": lambda q, u: q[0] + 0.1 - sign * u[0]}
    )
    solver = Solver(problem, Gauss(2, Addition(PLANE)), 10)
    given = BoundaryData(START, np.array([0.3, -1.0]), 1.0, None)
    inputs = Inputs.of(solver._reader, given, None, Options.of(None, 100))
    assert not solver._audit.ends_are_outside(inputs)


def test_rounding_does_not_put_an_end_beyond_a_limit():
    """Along a circle of latitude that is the limit."""
    sphere, angle = Sphere(2), 0.9
    problem = OptimalControlProblem(
        sphere,
        lambda q, u: jnp.cross(u, q),
        half_square,
        3,
        node_constraints={"cap": lambda q: q[2] - np.cos(angle)},
    )
    method = Gauss(2, default_retraction(sphere))
    for first, last in ((1.1, 3.1), (0.3, 1.7), (2.0, 0.1)):
        ends = [Rotation.from_euler("ZY", [turn, angle]).as_matrix()[:, 2] for turn in (first, last)]
        assert solve(problem, *ends, 1.0, method=method, steps=16).checks.active["cap"] > 0


@BOTH
def test_an_equation_that_puts_an_end_on_a_limit_is_named_with_it(method):
    problem = below(0.1, boundary_constraints={"pin": lambda a, b: b[0] - 0.1})
    guess = default_guess(problem, method, START, END, 20)
    found = solve(problem, START, None, 1.0, method=method, steps=20, guess=guess, throw=False)
    assert "ceiling and boundary_constraints['pin'] hold the trajectory near t = 1" in found.result
    assert not found.checks.strict_minimum
    apart = below(0.1, boundary_constraints={"pin": lambda a, b: b[0] - 0.05})
    assert "hold" not in solve(apart, START, None, 1.0, method=method, steps=20, guess=guess).result


def test_a_node_that_two_phases_share_has_its_limit_once():
    problem = OptimalControlProblem(
        PLANE, particle, lambda q, u: u @ u / 2 + 1, 1, node_constraints={"ceiling": lambda q: q[0] - 0.1}
    )
    for method in METHODS:
        found = solve_phases([Phase(problem, method, 10, 0.25, start=START), Phase(problem, method, 10, 0.25, end=END)])
        assert found.strict_minimum
        first, last = (phase.node_multipliers["ceiling"][:, 0] for phase in found.phases)
        assert last[0] == 0
        assert first[-1] > 1


@pytest.mark.long("Gauss")
@BOTH
def test_a_speed_limit_between_switches_that_are_found(method):
    """The quickest way of a cart: faster, at the limit, slower."""
    limits = {"speed": lambda q: q[1] - 0.4}
    problem = OptimalControlProblem(
        PLANE, particle, lambda q, u: 1.0, 1, control_bounds=(-1, 1), node_constraints=limits
    )
    end = np.array([1.0, 0.0])
    found = solve(problem, np.zeros(2), end, Free(3.0), method=method, steps=20, accuracy=1e-3, throw=False)
    assert found.horizon == pytest.approx(2.9, rel=2e-3)
    assert found.checks.active["speed"] == np.sum(found.jumps) > 10
    wide = problem._with_arguments(
        constraints=None, control_bounds=(-1, 1), node_constraints={"speed": lambda q: q[1] - 1.2}
    )
    assert solve(wide, np.zeros(2), end, Free(3.0), method=method, steps=20, accuracy=1e-8).horizon == pytest.approx(
        2.0, abs=1e-9
    )


def test_what_a_trajectory_without_success_violates_is_named():
    """Too fast a slew for its rate limit and torques: not shown to be impossible, and said where it ended."""
    inertia = np.array([2.0, 1.5, 1.0])
    problem = OptimalControlProblem(
        RIGID,
        lambda q, u: (q[0] @ hat(q[1]), (u - jnp.cross(q[1], inertia * q[1])) / inertia),
        half_square,
        3,
        control_bounds=(-0.3, 0.3),
        node_constraints={"rate": lambda q: q[1] @ q[1] - 0.01},
    )
    end = Rotation.from_euler("ZYX", [100, 30, 40], degrees=True).as_matrix(), REST
    found = solve(problem, (IDENTITY, REST), end, 2.5, method=Midpoint(Cayley(RIGID)), steps=16, throw=False)
    assert not found.success
    assert re.search(r"violates control_bounds lower by up to .*, rate by up to 0\.", found.result)
