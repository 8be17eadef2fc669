"""Constraints of the states at the nodes of a trajectory, beside known optima, IPOPT, and differences of solves."""

from typing import Any

import casadi as ca
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import (
    Free,
    Guess,
    OptimalControlProblem,
    Phase,
    Solver,
    default_guess,
    load_solution,
    solve,
    solve_phases,
)
from retrax.interop import to_casadi
from retrax.manifolds import ConvergenceError, Euclidean, InvalidInputError, Sphere
from retrax.plotting import multipliers, optimality
from retrax.retractions import Addition, Cayley, Euler, Gauss, Midpoint, Theta, default_retraction

from tests.integrators.problems import IDENTITY, PLANE, REST, RIGID, SLEW_END, below, half_square, particle, spacecraft

LINES = Euclidean(1) * Euclidean(1)
START, END = np.array([0.0, 1.0]), np.array([0.0, -1.0])
METHODS = Midpoint(Addition(PLANE)), Gauss(2, Addition(PLANE)), Gauss(3, Addition(PLANE))
QUIET = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.tol": 1e-10}
BOTH = pytest.mark.parametrize("method", METHODS[:2], ids=["midpoint", "Gauss"])


def least(ceiling: float) -> float:
    """The known optimum of the continuous problem."""
    if ceiling > 1 / 4:
        return 2.0
    return 2 + 6 * (1 - 4 * ceiling) ** 2 if ceiling > 1 / 6 else 4 / (9 * ceiling)


@pytest.fixture(scope="module")
def solvers():
    """For each method one whose parameter is the ceiling."""
    problem = OptimalControlProblem(
        PLANE, particle, lambda q, u, a: u @ u / 2, 1, node_constraints={"ceiling": lambda q, a: q[0] - a}
    )
    return {method: Solver(problem, method, 60) for method in METHODS}


@pytest.mark.parametrize("ceiling", [0.05, 0.1, 1 / 6 - 1e-3, 1 / 6 + 1e-3, 0.2, 0.2499, 0.25, 0.2501, 0.3, 10.0])
@pytest.mark.usual(2)
def test_a_ceiling_at_the_nodes_is_swept_through_what_it_decides(solvers, ceiling):
    """It touches, holds along an arc, or does nothing; nodes are where arcs begin for 0.05 and 0.1, and where it
    touches."""
    for method, solver in solvers.items():
        found = solver.solve(START, END, 1.0, parameters=ceiling)
        assert found.success
        assert found.checks.strict_minimum
        assert np.max(found.states[:, 0]) <= ceiling * (1 + 1e-9)
        exact = method is not METHODS[0] and (ceiling in (0.05, 0.1) or ceiling > 1 / 6)
        assert found.cost == pytest.approx(least(ceiling), rel=1e-7 if exact else 5e-3)
        if ceiling != 0.25:
            assert (found.checks.active["ceiling"] > 0) == (ceiling < 0.25)


@BOTH
def test_the_costate_jumps_by_the_multiplier_times_the_slope(method):
    """``g = exp(3 x) - exp(3 a)``; between the nodes the costate of the position is constant."""
    problem = OptimalControlProblem(
        PLANE, particle, half_square, 1, node_constraints={"bent": lambda q: jnp.exp(3 * q[0]) - jnp.exp(0.3)}
    )
    found = solve(problem, START, END, 1.0, method=method, steps=31)
    pulls = found.node_multipliers["bent"][:, 0] * 3 * np.exp(3 * found.states[:, 0])
    np.testing.assert_allclose(np.diff(found.costates[:, 0]), pulls[1:], atol=1e-9 * np.max(pulls))
    assert np.flatnonzero(found.jumps).tolist() == [9, 10, 21, 22]
    np.testing.assert_allclose(found.stage_costates[:, 1], found.controls[:, 0], atol=1e-9)  # dH/du = 0
    just = np.array([-1e-6, 1e-6])
    for node in (9, 10):
        before, after = found(found.times[node] + just).costates[:, 0]
        np.testing.assert_allclose([before, after], found.costates[node - 1 : node + 1, 0], atol=2e-3)


@pytest.mark.parametrize("theta", [0.0, 0.25, 0.5, 1.0])
def test_costates_are_read_on_this_side_of_a_jump_by_every_discretization_map(theta):
    method = Theta(Addition(PLANE), theta) if theta else Euler(Addition(PLANE))
    found = solve(below(0.1), START, END, 1.0, method=method, steps=31)
    for node in np.flatnonzero(found.jumps):
        before = found(found.times[node] - 1e-6).costates[0]
        assert before == pytest.approx(found.costates[node - 1, 0], rel=1e-6)


@pytest.mark.parametrize("method", [Midpoint(Cayley(RIGID)), Gauss(2, Cayley(RIGID))], ids=["midpoint", "Gauss"])
@pytest.mark.usual(1)
def test_a_slew_beside_a_cone_at_the_nodes_costs_what_ipopt_finds(method):
    """From and to points where the cone holds, with a turn between them that crosses it."""
    start, end = (IDENTITY, REST), (SLEW_END, REST)
    free = OptimalControlProblem(RIGID, spacecraft, half_square, 3)
    largest = np.max(solve(free, start, end, 60.0, method=method, steps=20).states[0][:, 2, 1])
    cone = {"cone": lambda q: q[0][2, 1] - 0.9 * largest}
    problem = OptimalControlProblem(RIGID, spacecraft, half_square, 3, node_constraints=cone)
    found = solve(problem, start, end, 60.0, method=method, steps=20)
    assert found.checks.strict_minimum
    assert found.checks.active == {"cone": 1}
    assert np.max(found.states[0][:, 2, 1]) == pytest.approx(0.9 * largest, rel=1e-9)
    discrete = to_casadi(problem, method, start, end, 60.0, 20)
    solver = ca.nlpsol("solver", "ipopt", discrete.nlp, QUIET)
    assert found.cost == pytest.approx(float(solver(**discrete.arguments)["f"]), rel=1e-7)


@BOTH
def test_stages_and_nodes_have_limits_of_their_own(method):
    """A limit at both is as the stricter of the two, and that of the stages alone leaves the nodes beyond it."""
    ceiling = {"stages": lambda q, u: q[0] - 0.1}
    stages = OptimalControlProblem(PLANE, particle, half_square, 1, constraints=ceiling)
    alone, both = (
        solve(problem, START, END, 1.0, method=method, steps=14)
        for problem in (stages, below(0.1, constraints=ceiling))
    )
    assert np.max(alone.states[:, 0]) > 0.1 + 5e-6
    assert np.max(both.states[:, 0]) <= 0.1 + 1e-9
    assert np.max(both.stage_states[:, 0]) <= 0.1 + 1e-9
    assert both.cost > alone.cost
    assert set(both.multipliers) == {"stages"}
    assert set(both.node_multipliers) == {"ceiling"}


@BOTH
def test_derivatives_with_active_nodes(method):
    problem = OptimalControlProblem(
        PLANE, particle, lambda q, u, a: u @ u / 2, 1, node_constraints={"bent": lambda q, a: jnp.exp(a * q[0]) - 1.1}
    )
    solver, step = Solver(problem, method, 31), 1e-5
    solution = solver.solve(START, END, 1.0, parameters=1.0)
    assert solution.checks.active == {"bent": 4}
    found = solver.sensitivity(solution)
    later = [solver.solve(START, END, 1.0 + way * step, parameters=1.0) for way in (-1, 1)]
    other = [solver.solve(START, END, 1.0, parameters=1.0 + way * step) for way in (-1, 1)]
    for derivative, near in ((found.horizon, later), (found.parameters, other)):
        assert derivative.cost == pytest.approx((near[1].cost - near[0].cost) / (2 * step), rel=1e-6)
        for name in ("states", "costates", "controls"):
            difference = (getattr(near[1], name) - getattr(near[0], name)) / (2 * step)
            np.testing.assert_allclose(getattr(derivative, name), difference, atol=1e-6 * np.max(np.abs(difference)))


@BOTH
def test_a_free_start_is_held_at_the_first_node(method):
    """It costs its distance from a point beyond the ceiling; the rest is of order ``h^2`` for free."""
    problem = below(0.1, initial_cost=lambda q: (q[0] - 1.0) ** 2 + (q[1] + 0.3) ** 2)
    found = solve(problem, None, np.zeros(2), 1.0, method=method, steps=20)
    assert found.states[0, 0] == pytest.approx(0.1, abs=1e-9)
    assert found.node_multipliers["ceiling"][0, 0] == pytest.approx(1.8, rel=1e-6)
    distance = 2 * (found.states[0] - [1.0, -0.3])
    np.testing.assert_allclose(found.costates[0], distance, rtol=1e-6)  # before the jump
    assert found(1e-6).costates[0] == pytest.approx(found.costates[1, 0], abs=1e-5)  # behind it


@pytest.mark.parametrize("method", [Midpoint, lambda r: Gauss(2, r)], ids=["midpoint", "Gauss"])
@pytest.mark.parametrize("above", [-1e-3, 0.0, 1e-6, 1e-2])
@pytest.mark.usual(2)
def test_a_start_that_is_prescribed_in_part_is_not_asked_for_what_it_cannot_give(method, above):
    """The position is given, where it may be on the ceiling or beyond; its speed is free and limited."""
    limits = {"ceiling": lambda q: q[0] - 0.1, "speed": lambda q: -0.3 - q[1]}
    problem = OptimalControlProblem(LINES, lambda q, u: (q[1], u), half_square, 1, node_constraints=limits)
    start, end = (np.array([0.1 + above]), None), (np.zeros(1), np.zeros(1))
    found = solve(problem, start, end, 1.0, method=method(default_retraction(LINES)), steps=20, throw=False)
    assert found.success == (above <= 0)
    assert found.node_multipliers["ceiling"][0, 0] == 0
    if above > 0:
        assert f"The start violates ceiling[0] by {above:.3g}: it is prescribed" in found.result


@BOTH
def test_a_ceiling_that_moves_with_the_time(method):
    limits = {"ceiling": lambda q, t: q[0] - 0.1 - 0.05 * t}
    timed = OptimalControlProblem(
        PLANE,
        lambda q, u, t: particle(q, u),
        lambda q, u, t: u @ u / 2,
        1,
        time_dependent=True,
        node_constraints=limits,
    )
    found = solve(timed, START, END, 1.0, method=method, steps=30)
    assert np.max(found.states[:, 0] - 0.1 - 0.05 * found.times) == pytest.approx(0.0, abs=1e-9)
    assert found.checks.active["ceiling"] > 0


@BOTH
def test_jumps_do_not_depend_on_whether_the_horizon_is_free(method):
    problem = OptimalControlProblem(
        PLANE, particle, lambda q, u: u @ u / 2 + 1, 1, node_constraints={"ceiling": lambda q: q[0] - 0.1}
    )
    free = solve(problem, START, END, Free(1.0), method=method, steps=30)
    given = solve(problem, START, END, free.horizon, method=method, steps=30)
    assert free.cost == pytest.approx(given.cost, rel=1e-9)
    jumps = [found.node_multipliers["ceiling"] for found in (free, given)]
    np.testing.assert_allclose(*jumps, atol=1e-6 * np.max(jumps))


@BOTH
def test_periodic_ends_are_one_node(method):
    limits = {"ceiling": lambda q: q[0] - 0.05}
    problem = OptimalControlProblem(
        PLANE,
        particle,
        lambda q, u: u @ u / 2 + 100 * (q[0] - 0.2) ** 2,
        1,
        periodic=True,
        node_constraints=limits,
    )
    guess = default_guess(problem, method, np.zeros(2), np.zeros(2), 10)
    found = solve(problem, None, None, 1.0, method=method, steps=10, guess=guess)
    assert found.checks.strict_minimum
    assert found.cost == pytest.approx(100 * 0.15**2, rel=1e-6)
    pulls = found.node_multipliers["ceiling"][:, 0]
    assert pulls[0] == 0
    np.testing.assert_allclose(pulls[1:], 200 * 0.15 / 10, rtol=1e-4)


@BOTH
def test_a_turn_that_is_no_identity_leaves_both_ends_their_limits(method):
    """``q(T) = -q(0)`` with a limit from one side: what holds at the end says nothing of the start."""
    problem = OptimalControlProblem(
        PLANE,
        particle,
        lambda q, u: u @ u / 2,
        1,
        periodic=lambda q: -q,
        initial_cost=lambda q: 1e3 * (q[0] - 1.0) ** 2,
        node_constraints={"ceiling": lambda q: q[0] - 0.3},
    )
    guess = default_guess(problem, method, np.zeros(2), np.zeros(2), 10)
    found = solve(problem, None, None, 1.0, method=method, steps=10, guess=guess)
    assert found.states[0, 0] == pytest.approx(0.3, abs=1e-8)
    assert found.node_multipliers["ceiling"][0, 0] > 0.1


@BOTH
@pytest.mark.usual(1)
def test_a_solution_is_a_guess_near_to_the_end_also_on_another_mesh(method):
    problem = below(0.1)
    found = solve(problem, START, END, 1.0, method=method, steps=31)
    assert solve(problem, START, END, 1.0, method=method, steps=31, guess=found).statistics.iterations <= 2
    other, fresh = (solve(problem, START, END, 1.0, method=method, steps=40, guess=guess) for guess in (found, None))
    assert other.cost == pytest.approx(fresh.cost, rel=1e-9)


@BOTH
def test_a_batch_is_its_members(solvers, method):
    solver, ceilings = solvers[method], np.array([0.05, 0.1, 0.2, 0.3])
    many = solver.solve_many(np.tile(START, (4, 1)), np.tile(END, (4, 1)), 1.0, parameters=ceilings)
    for one, ceiling in zip(many, ceilings, strict=True):
        alone = solver.solve(START, END, 1.0, parameters=ceiling)
        assert one.cost == pytest.approx(alone.cost, rel=1e-9)
        assert one.checks.active == alone.checks.active
    again = solver.solve_many(
        np.tile(START, (4, 1)), np.tile(END, (4, 1)), 1.0, parameters=ceilings, guesses=list(many)
    )
    assert all(a.statistics.iterations < b.statistics.iterations for a, b in zip(again, many, strict=True))


@BOTH
def test_two_halves_are_the_whole(method):
    """Where they meet, on the ceiling, the constraint is of both."""
    problem = below(0.1)
    whole = solve(problem, START, END, 1.0, method=method, steps=32)
    first = Phase(problem, method, 16, 0.5, start=START)
    found = solve_phases([first, Phase(problem, method, 16, 0.5, end=END)])
    assert found.cost == pytest.approx(whole.cost, rel=1e-9)
    assert found.strict_minimum


@pytest.mark.slow
def test_what_is_not_on_a_tape_holds_too():
    """The last of sorted entries, on a sphere, by XLA: beside the same limit without sorting."""
    sphere, start, end = Sphere(2), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.6, 0.8])

    def limited(limit: Any) -> OptimalControlProblem:
        return OptimalControlProblem(
            sphere, lambda q, u: jnp.cross(u, q), half_square, 3, node_constraints={"limit": limit}
        )

    by_values = limited(lambda q: jnp.sort(q[1:])[-1] - 0.75)
    plain = limited(lambda q: jnp.maximum(q[1], q[2]) - 0.75)
    for method in (Midpoint(default_retraction(sphere)), Gauss(2, default_retraction(sphere))):
        # The end is prescribed beyond the limit: the words are the same, and so is the way.
        found, expected = (solve(p, start, end, 1.0, method=method, steps=7, throw=False) for p in (by_values, plain))
        assert "The end violates limit by 0.05" in found.result
        assert found.cost == pytest.approx(expected.cost, rel=1e-8)


def test_steps_between_nodes_beyond_the_ceiling_are_seen():
    found = solve(below(0.1), START, END, 1.0, method=METHODS[2], steps=7, accuracy=1e-5)
    assert found.checks.between["ceiling"] <= 1e-5 * 0.1
    assert found.steps > 7
    assert found.cost == pytest.approx(least(0.1), rel=1e-4)


def test_contradictions_are_named():
    limits = {"ceiling": lambda q: q[0] - 0.1, "floor": lambda q: 0.2 - q[0]}
    problem = OptimalControlProblem(PLANE, particle, half_square, 1, node_constraints=limits)
    start, end = np.array([0.15, 1.0]), np.array([0.15, -1.0])
    for method in METHODS[:2]:
        with pytest.raises(ConvergenceError, match="contradict each other") as raised:
            solve(problem, start, end, 1.0, method=method, steps=20)
        assert "ceiling by up to" in str(raised.value)
        assert "floor by up to" in str(raised.value)


def test_limits_that_depend_on_each_other_or_are_flat_show_no_minimum():
    twice = {"once": lambda q: q[0] - 0.1, "again": lambda q: 2 * q[0] - 0.2}
    flat = {"flat": lambda q: (q[0] - 0.1) * jnp.abs(q[0] - 0.1)}
    for limits, words in ((twice, "once and again hold"), (flat, "The derivative of flat vanishes")):
        problem = OptimalControlProblem(PLANE, particle, half_square, 1, node_constraints=limits)
        found = solve(problem, START, END, 1.0, method=METHODS[0], steps=31, throw=False)
        assert words in found.result
        assert not found.checks.strict_minimum


def test_files_tables_and_words(tmp_path):
    found = solve(below(0.1), START, END, 1.0, method=METHODS[1], steps=20)
    found.save(tmp_path / "found.npz")
    again = load_solution(tmp_path / "found.npz")
    np.testing.assert_array_equal(again.node_multipliers["ceiling"], found.node_multipliers["ceiling"])
    assert solve(below(0.1), START, END, 1.0, method=METHODS[1], steps=20, guess=again).statistics.iterations <= 3
    assert found.to_pandas()["multiplier of ceiling[0]"].max() == np.max(found.node_multipliers["ceiling"])
    assert found.to_xarray()["multiplier of ceiling"].dims == ("time", "ceiling_0")
    assert f"ceiling: active at {found.checks.active['ceiling']} of 21 nodes" in str(found)
    assert "(relative, at the nodes)" in str(found)
    (points,) = multipliers(found).get_lines()
    np.testing.assert_array_equal(points.get_xdata(), found.times)
    assert points.get_label() == "ceiling"
    assert len(optimality(found)) == 2
    assert "ceiling(q) <= 0 at the nodes" in repr(below_named())


def below_named() -> OptimalControlProblem:
    return OptimalControlProblem(PLANE, particle, half_square, 1, node_constraints={"ceiling": lambda q: q[0]})


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (3, "node_constraints must be a dictionary"),
        ({"": lambda q: q[0]}, "node_constraints must have names that are words"),
        ({"horizon lower": lambda q: q[0]}, "node_constraints have the name 'horizon lower', which bounds have"),
        ({"a": 3}, r"node_constraints\['a'\] must be a function of a state"),
        ({"a": lambda: 1.0}, r"node_constraints\['a'\] must be a function of q"),
        ({"taken": lambda q: q[0]}, r"node_constraints\['taken'\] has the name of one of the constraints"),
    ],
)
def test_bad_node_constraints_are_named(given, words):
    with pytest.raises(InvalidInputError, match=words):
        OptimalControlProblem(
            PLANE, particle, half_square, 1, constraints={"taken": lambda q, u: q[0]}, node_constraints=given
        )


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (lambda q: jnp.sqrt(q[0] - 5), r"node_constraints\['a'\] is not finite at q"),
        (lambda q: q[0] < 1, r"node_constraints\['a'\] must .* bool values; .*, as q\[0\] - 1 for q\[0\] < 1"),
        (lambda q: jnp.ones((2, 2)), r"node_constraints\['a'\] must return a number or a vector"),
        (lambda q, p: q[0], "parameters"),
    ],
)
def test_functions_that_fail_are_named(function, words):
    problem = OptimalControlProblem(PLANE, particle, half_square, 1, node_constraints={"a": function})
    with pytest.raises(InvalidInputError, match=words):
        solve(problem, START, END, 1.0, method=METHODS[0], steps=5)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"other": np.zeros((6, 1))}, "node_multipliers belong to 'other', expected names of inequalities"),
        ({"ceiling": np.zeros((5, 1))}, r"node_multipliers of 'ceiling' must be real numbers of shape \(6, k\)"),
        ({"ceiling": np.zeros((6, 2))}, "multipliers of 'ceiling' have 2 entries at a node, expected 1"),
        ({"ceiling": -np.ones((6, 1))}, "node_multipliers of 'ceiling' must be finite and not negative"),
    ],
)
def test_bad_multipliers_of_nodes_are_named(given, words):
    guess = default_guess(below(0.1), METHODS[0], START, END, 5)
    with pytest.raises(InvalidInputError, match=words):
        solve(below(0.1), START, END, 1.0, method=METHODS[0], steps=5, guess=Guess(*guess[:3], node_multipliers=given))
