"""Compiled passes over whole steps end where one iteration after the other does."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numba
import numpy as np
import pytest
from retrax.integrators import Guess, OptimalControlProblem, Solver
from retrax.integrators.boundary_value.engine import descent, pursuit, pursuit_kernels
from retrax.integrators.boundary_value.engine.first_units import first_units
from retrax.integrators.boundary_value.engine.share import UNCHANGED
from retrax.integrators.boundary_value.engine.trial import Trial
from retrax.integrators.reporting.results import Result
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Cayley, Gauss, Midpoint, default_retraction

from tests.integrators.engine.test_trial import CASES, SLEWS, one_by_one, pendulum, same
from tests.integrators.problems import RIGID, SLEW, SPHERE, half_square, spacecraft
from tests.integrators.test_claims import HALF_PERIOD, OSCILLATOR, STEPS
from tests.integrators.test_long_steps import TURNED, N, rotation, turning

LINE, PLANE = Euclidean(1), Euclidean(2)
ROUND = 1e-8  # of a way up: a way round beside it is as short but for rounding
ROUNDED = 1e-13  # a residual that is rounding
CHAOTIC = 40  # iterations, after which rounding has grown into another way


@pytest.fixture(params=[Midpoint, partial(Gauss, 2)], ids=["midpoint", "collocation"])
def method(request) -> Callable[[Any], Any]:
    """A method of a retraction, with one stage, and with more."""
    return request.param


def found(solver: Solver, way: tuple, **options: Any) -> tuple[Any, list[Any]]:
    """What a solve returns, and what its iterations show."""
    seen: list[Any] = []
    options = {"callback": lambda iteration: seen.append(iteration) and False} | options
    return solver.solve(*way, throw=False, **options), seen


def alike(one: Any, other: Any, atol: float = 1e-11) -> None:
    """Two solutions are the same one."""
    given = ((own.states, own.costates, own.controls, own.cost) for own in (one, other))
    same(*given, atol)
    assert (one.success, one.result) == (other.success, other.result)
    left = max(own.stationarity for own in (one.checks, other.checks))  # of rounding there may be a step less or more
    assert abs(one.statistics.iterations - other.statistics.iterations) <= (left < ROUNDED)
    assert one.checks.strict_minimum == other.checks.strict_minimum


@pytest.mark.parametrize("name", CASES)
def test_a_pursuit_is_its_iterations(name, pursuits, monkeypatch):
    """With costs of ends there is none, nor by collocation with inequalities at nodes."""
    solver, way, options = CASES[name]()
    short, _ = found(solver, way, callback=None, **options)
    pursued = sum(own.taken + own.arrived for own in pursuits if own is not None)
    assert short.success
    assert (pursued > 0) == (name not in ("a free end", "collocation with a cap at nodes"))
    shown, seen = found(solver, way, **options)
    one_by_one(monkeypatch)
    alone, told = found(solver, way, **options)
    # In the least time the costates are determined to the root of the last barrier.
    atol = 1e-6 if name == "a free horizon" else 1e-11
    alike(short, alone, atol)
    alike(shown, alone, atol)
    same([own._replace(members=0.0) for own in seen], [own._replace(members=0.0) for own in told], atol)


@pytest.mark.parametrize("name", ["a slew", "a sphere with parameters", "unequal steps of collocation"])
def test_units_of_a_pass(name, monkeypatch):
    """They are those that are taken from the system of the guess otherwise, from a solution too."""
    solver, way, options = CASES[name]()
    set_out, found = Trial.set_out, list[Any]()

    def heard(self: Trial, *given: Any) -> Any:
        found.append(set_out(self, *given))
        return found[-1]

    def set_units(conditions: Any, *given: Any) -> Any:
        begun = pursuit.set_out(conditions, *given)
        first = found[-1].first()
        same(tuple(found[-1].units), tuple(first_units(conditions, first.iterate, first.assembled)))
        return begun

    monkeypatch.setattr(Trial, "set_out", heard)
    monkeypatch.setattr(descent, "set_out", set_units)
    solution = solver.solve(*way, **options)
    assert solver.solve(*way, guess=solution, **options).success
    assert len(found) == 2


@pytest.mark.parametrize("name", ["a sphere with parameters", "unequal steps of collocation"])
def test_what_a_step_promises(name, monkeypatch):
    """Of the cost, which depends on the states, and of the multipliers on what is lacking, to first order."""
    solver, way, options = CASES[name]()
    pursue, known = Trial.pursue, []

    def heard(self: Trial, setting: Any, conditions: Any, *given: Any) -> Any:
        found = pursue(self, setting, conditions, *given)
        if found is not None and found.last is not None and found.step is not None:
            stands = found.standing.promised, found.standing.turned
            expected = conditions.promise(found.last.iterate, found.last.assembled, found.step)
            known.append((stands, [own.item() for own in expected]))
        return found

    monkeypatch.setattr(pursuit, "MOST", 1)
    monkeypatch.setattr(Trial, "pursue", heard)
    assert solver.solve(*way, **options).success
    assert len(known) > 2
    for stands, expected in known[:-1]:  # what the last one promises is rounding
        np.testing.assert_allclose(stands, expected, rtol=1e-6)


@pytest.mark.parametrize("stiffness", [0.0, 3.0, 10.0, 30.0, 100.0])
def test_what_is_refused_is_left_to_the_rest_of_the_iteration(method, stiffness, pursuits, monkeypatch):
    """From a slope that is a cost to one that steps have to be cut and Hessians raised for."""
    q = OptimalControlProblem(
        PLANE, pendulum, lambda q, u: u @ u / 2 + stiffness * jnp.cos(3.0 * q[0]), controls=Euclidean(1)
    )
    solver, way = Solver(q, method(Addition(PLANE)), 30), (np.zeros(2), np.array([np.pi, 0.0]), 3.0)
    short, _ = found(solver, way, callback=None)
    refused = any(own is None or (own.ahead is not None and not own.arrived) for own in pursuits)
    assert refused == (stiffness > 1.0)
    one_by_one(monkeypatch)
    alone = found(solver, way)[0]
    assert short.success
    assert alone.success
    if short.statistics.iterations < CHAOTIC:
        alike(short, alone)


@pytest.mark.long("midpoint-12.0", "midpoint-3.0", "collocation-12.0", "collocation-3.0", "collocation-10000.0")
@pytest.mark.parametrize("limit", [1e4, 12.0, 8.0, 7.5, 7.0, 3.0, 1.0])
def test_limits_of_a_pass(method, limit, pursuits, monkeypatch):
    """From those that hold nothing to those that no slew meets."""
    slew = OptimalControlProblem(RIGID, spacecraft, half_square, 3, control_bounds=(-limit, limit))
    short, alone = both_ways(Solver(slew, method(Cayley(RIGID)), 40), SLEWS, monkeypatch)
    alike(short, alone)
    assert short.success == (limit > 7.2)
    assert short.checks.active == alone.checks.active
    assert sum(own.taken for own in pursuits) > 5


@pytest.mark.parametrize(("radius", "beside"), [(0.1, 0.05), (0.1, 0.2), (0.3, 0.2), (0.49, 1e-6), (0.55, 0.2)])
def test_an_obstacle_beside_a_pass(method, radius, beside, monkeypatch):
    """From one that is hardly met to one around an end: steps are cut, Hessians raised, and the way in is elastic."""
    middle = jnp.array([0.5, beside])
    around = {"disk": lambda q, u: radius**2 - jnp.sum((q - middle) ** 2)}
    free = OptimalControlProblem(PLANE, lambda q, u: u, half_square, 2, constraints=around)
    way = np.zeros(2), np.array([1.0, 0.0]), 1.0
    short, alone = both_ways(Solver(free, method(Addition(PLANE)), 20), way, monkeypatch)
    alike(short, alone)
    assert short.success == (radius < 0.5)


@pytest.mark.parametrize("beside", np.linspace(0.2, 0.3, 6))
def test_rounding_refuses_nothing_beside_a_solution(method, beside, monkeypatch):
    """Past an obstacle that is hardly met, with a shift of the Hessians until the last step."""
    around = {"disk": lambda q, u: 0.01 - jnp.sum((q - jnp.array([0.5, beside])) ** 2)}
    free = OptimalControlProblem(PLANE, lambda q, u: u, half_square, 2, constraints=around)
    way = np.zeros(2), np.array([1.0, 0.0]), 1.0
    for own in both_ways(Solver(free, method(Addition(PLANE)), 20), way, monkeypatch):
        assert own.statistics.iterations <= 14


@pytest.mark.parametrize("height", [0.9, 0.3, -0.1, -0.5])
@pytest.mark.parametrize("kind", ["constraints", "node_constraints"])
def test_a_cap_that_a_pass_keeps_out_of(method, kind, height, monkeypatch):
    """At stages and at nodes, from one that the way hardly meets to one that has an end in it."""
    cap = (lambda q, u: q[1] - height) if kind == "constraints" else (lambda q: q[1] - height)
    turn = OptimalControlProblem(SPHERE, lambda q, u: jnp.cross(u, q), half_square, 3, **{kind: {"cap": cap}})
    way = np.array([1.0, 0.0, 0.0]), np.array([-0.6, 0.0, 0.8]), 1.0
    short, alone = both_ways(Solver(turn, method(default_retraction(SPHERE)), 25), way, monkeypatch)
    alike(short, alone)
    assert short.success == (height > 0)


@pytest.mark.parametrize("bound", [0.2, 0.5, 0.8, 1.5, 4.0])
@pytest.mark.parametrize("hill", [0.0, 3.0])
def test_a_swing_with_little_torque(method, bound, hill, monkeypatch):
    """From too little to swing up to so much that no bound is met."""
    cost = lambda q, u: u @ u / 2 + hill * jnp.cos(3.0 * q[0])  # noqa: E731
    swing = OptimalControlProblem(PLANE, pendulum, cost, 1, control_bounds=(-bound, bound))
    way = np.zeros(2), np.array([np.pi, 0.0]), 6.0
    short, alone = both_ways(Solver(swing, method(Addition(PLANE)), 60), way, monkeypatch)
    alike(short, alone, atol=1e-9)
    assert short.success == (bound > 0.6)


@pytest.mark.parametrize("most", [1, 3, 4, 5])
def test_no_more_iterations_than_asked_for(method, most, monkeypatch):
    solver = Solver(SLEW, method(Cayley(RIGID)), 30)
    short, _ = found(solver, SLEWS, callback=None, max_iterations=most)
    one_by_one(monkeypatch)
    alone, _ = found(solver, SLEWS, max_iterations=most)
    alike(short, alone)
    assert short.success == (most == 5)


@pytest.mark.parametrize("beside", [8e-6, 1e-3, 1e-2, 0.1])
@pytest.mark.parametrize("tolerance", [1e-5, 1e-3])
def test_a_guess_whose_end_is_beside_the_end_is_stepped_from(method, beside, tolerance, monkeypatch):
    """By less than the tolerance of its unit, too: in a flat space nothing is normal to it."""
    solver = Solver(OptimalControlProblem(PLANE, lambda q, u: u, half_square, 2), method(Addition(PLANE)), 10)
    near = solver.solve(np.zeros(2), np.array([1.0, 0.0]), 1.0)
    way = np.zeros(2), np.array([1.0, beside]), 1.0
    short, alone = both_ways(solver, way, monkeypatch, guess=near, tolerance=tolerance)
    alike(short, alone)
    assert short.success
    np.testing.assert_allclose(short.states[-1], way[1], atol=tolerance)


def test_an_interrupt_of_a_pass_has_a_record(method, monkeypatch):
    """It comes once the first pass has ended: of two iterations, or of all."""
    set_out, solver = Trial.set_out, Solver(SLEW, method(Cayley(RIGID)), 30)
    for most in (2, 10):
        calls: list[Any] = []

        def interrupted(self: Trial, *given: Any, calls: list[Any] = calls) -> Any:
            calls.append(set_out(self, *given))
            if len(calls) == 1:
                raise KeyboardInterrupt
            return calls[-1]

        monkeypatch.setattr(pursuit, "MOST", most)
        monkeypatch.setattr(Trial, "set_out", interrupted)
        found = solver.solve(*SLEWS, throw=False)
        assert found.success == (most == 10)
        if not found.success:
            assert found.result == Result[Result.stopped]
            assert found.statistics.iterations == most


def test_a_pass_has_so_many_iterations_at_most(method, pursuits, monkeypatch):
    """An interrupt waits for no more."""
    monkeypatch.setattr(pursuit, "MOST", 2)
    solver = Solver(SLEW, method(Cayley(RIGID)), 30)
    alike(*both_ways(solver, SLEWS, monkeypatch))
    assert [own.taken for own in pursuits][:2] == [2, 2]
    assert max(own.taken for own in pursuits) == 2


def test_a_refused_trial_is_not_evaluated_again(method, pursuits, monkeypatch):
    """After whole steps the rest of the iteration goes on with it."""
    tried = []
    call = Trial.__call__
    monkeypatch.setattr(Trial, "__call__", lambda self, *given: tried.append(given[2:]) or call(self, *given))
    hill = OptimalControlProblem(PLANE, pendulum, lambda q, u: u @ u / 2 + 10.0 * jnp.cos(3.0 * q[0]), controls=1)
    solver = Solver(hill, method(Addition(PLANE)), 30)
    assert solver.solve(np.zeros(2), np.array([np.pi, 0.0]), 3.0).success
    refused = [own for own in pursuits if own is not None and own.ahead is not None and not own.arrived]
    assert any(own.taken for own in refused)
    whole = [before[2] for before, part in tried if part == 1]
    assert not any(step is own.step for step in whole for own in refused)


def test_a_solution_as_a_guess_compiles_nothing_anew(method):
    """Its arrays are read-only."""
    solver = Solver(SLEW, method(Cayley(RIGID)), 30)
    found = solver.solve(*SLEWS)
    assert solver.solve(*SLEWS, guess=found).success
    assert len(pursuit_kernels.pursue.signatures) == 1


@pytest.mark.parametrize(("support", "may"), [(0.0, False), (1e-12, False), (0.1, True)])
def test_rounding_in_a_frame_frees_nothing_from_the_sphere_that_it_is_on(support, may):
    """A coordinate of a sphere with an entry in a line beside it, which is not of constant size."""
    points = np.stack([np.array([np.cos(t), np.sin(t), t]) for t in np.linspace(0, 1, 5)])
    frame, groups = np.array([[[1.0, 1.0, support]]]), np.array([0, 0, 1])
    asked = numba.njit(lambda *given: pursuit_kernels._may_move(*given))
    assert asked(0, 3.0, frame, points, (groups, groups), UNCHANGED) == may


def test_a_callback_stops_it(method):
    solver, seen = Solver(SLEW, method(Cayley(RIGID)), 30), []

    def stop(iteration: Any) -> bool:
        seen.append(iteration)
        return len(seen) == 3

    assert not solver.solve(*SLEWS, callback=stop, throw=False).success
    assert len(seen) == 3


def test_the_last_of_a_batch_goes_on_alone(method, pursuits):
    """One is at its end at once, the other is on its way."""
    solver = Solver(OptimalControlProblem(SPHERE, lambda q, u: jnp.cross(u, q), half_square, 3),
                    method(default_retraction(SPHERE)), 15)  # fmt: skip
    north, ends = np.array([0.0, 0.0, 1.0]), np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    both = solver.solve_many(north, ends, 1.0)
    assert both.success.all()
    assert pursuits
    alone = solver.solve(north, ends[1], 1.0)
    same(jax.tree.leaves(both[1].states), jax.tree.leaves(alone.states))


def both_ways(solver: Solver, way: tuple, monkeypatch: pytest.MonkeyPatch, **options: Any) -> tuple[Any, Any]:
    """What a solve returns with pursuits, and one iteration after the other."""
    short = solver.solve(*way, throw=False, **options)
    with monkeypatch.context() as other:
        one_by_one(other)
        return short, solver.solve(*way, throw=False, **options)


@pytest.mark.parametrize("height", [1e-9, 1e-6, 1e-3, 0.03, 0.3, 3.0])
def test_a_guess_that_is_lost_is_moved_aside(method, height, monkeypatch):
    """In Heisenberg's group, on the way to points from beside the start to above it."""
    space = Euclidean(3)
    group = OptimalControlProblem(
        space, lambda q, u: jnp.array([u[0], u[1], (q[0] * u[1] - q[1] * u[0]) / 2]), half_square, controls=2
    )
    solver = Solver(group, method(Addition(space)), 30)
    for end in (np.array([1.0, 0.0, height]), np.array([height, 0.0, 1.0])):
        found = both_ways(solver, (np.zeros(3), end, 1.0), monkeypatch, max_iterations=30)
        if height > ROUND:
            alike(*found, atol=1e-9)
        else:
            np.testing.assert_allclose(*(own.cost for own in found), rtol=1e-9)


@pytest.mark.parametrize(("spin", "far"), [(0.1, False), (1.0, False), (4.0, False), (8.0, True), (16.0, True)])
def test_a_step_that_turns_too_far_is_cut(method, spin, far, pursuits, monkeypatch):
    """A direction that turns by itself, from slowly to many times round in the horizon."""
    axis = spin * jnp.array([1.0, 2.0, 2.0]) / 3.0
    turning = OptimalControlProblem(SPHERE, lambda q, u: jnp.cross(u + axis, q), half_square, controls=3)
    solver = Solver(turning, method(default_retraction(SPHERE)), 40)
    way = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), 1.0
    alike(*both_ways(solver, way, monkeypatch))
    assert (pursuits[0] is None) == far


@pytest.mark.parametrize("beside", [0.3, 1e-3, 1e-6, 1e-9, 1e-12, 1e-14])
def test_a_last_step_is_one_beside_opposite_points_too(method, beside, monkeypatch):
    """From a turn that is isolated to one of many that rounding does not tell apart."""
    way = np.array([0.0, 0.0, 1.0]), np.array([np.sin(beside), 0.0, -np.cos(beside)]), 1.0
    free = OptimalControlProblem(SPHERE, lambda q, u: jnp.cross(u, q), half_square, controls=3)
    alike(*both_ways(Solver(free, method(default_retraction(SPHERE)), 20), way, monkeypatch))


@pytest.mark.parametrize("tolerance", [0.1, 0.01])
def test_a_tolerance_that_is_met_far_off_at_a_conjugate_point_does_not_end_it(method, tolerance, monkeypatch):
    """A pendulum's action over half a period and somewhat less and more: steps are long where residuals are small."""
    action = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: u @ u / 2 + jnp.cos(q[0]), controls=1)
    solver = Solver(action, method(Addition(LINE)), 20)
    for horizon in (2.8, 3.1, 3.14, 3.2, 3.5, 4.0):
        way = np.zeros(1), np.array([0.5]), horizon
        alike(*both_ways(solver, way, monkeypatch, tolerance=tolerance, max_iterations=40))


@pytest.mark.parametrize("size", [0.0, 1e-15, 1e-8, 1e-2, 0.1, 1.0])
def test_a_step_that_leaves_what_constraints_ask_for_is_not_followed(size, monkeypatch):
    """A turn by two controls about the third axis, from guesses at rest to far from it."""
    solver, times = turning(), np.linspace(0, 1, N)
    controls = size * np.stack([np.cos(times), np.sin(2 * times)], axis=1)
    guess = Guess.from_controls(TURNED, solver.method, np.eye(3), controls, 1.0, N)
    way = np.eye(3), rotation([0.2, -0.1, 0.5]), 1.0
    alike(*both_ways(solver, way, monkeypatch, guess=guess))


@pytest.mark.parametrize("distance", [-1e-6, -1e-13, 0.0, 1e-15, 1e-14, 1e-12, 1e-6])
def test_a_step_that_leads_far_off_is_not_followed(method, distance, monkeypatch):
    """An oscillator over half a period, as far as the horizon is known: the system is singular to rounding."""
    solver = Solver(OSCILLATOR, method(Addition(LINE)), STEPS)
    alike(*both_ways(solver, (np.zeros(1), np.ones(1), HALF_PERIOD + distance), monkeypatch))


@pytest.mark.parametrize(("rule", "bounds"), [("FAR", [100.0, 10.0, 1.0, 0.1, 0.0]), ("UNMET", [1.0, 1e-9, -1.0])])
def test_how_far_a_first_step_may_lead_is_swept(method, rule, bounds, pursuits, monkeypatch):
    """It moves the slew by some times its spread, and leaves rounding of what the constraints ask for."""
    solver, followed = Solver(SLEW, method(Cayley(RIGID)), 30), []
    for bound in bounds:
        monkeypatch.setattr(pursuit, rule, bound)
        alike(*both_ways(solver, SLEWS, monkeypatch))
        followed.append(pursuits[0] is not None)
        pursuits.clear()
    assert followed[0]
    assert not followed[-1]
    assert followed == sorted(followed, reverse=True)


def test_steps_that_turn_by_a_quarter_turn_and_less_are_those_of_one_iteration_after_the_other(
    method, pursuits, monkeypatch
):
    """The guess is steps that rest amid their parts of the way: where these are far apart no pass sets out from it."""
    solver, set_out = Solver(SLEW, method(Cayley(RIGID)), 2), []
    for angle in np.deg2rad([20.0, 80.0, 120.0, 126.0, 130.0, 140.0, 170.0]):
        end = rotation(angle * np.array([1.0, 2.0, -2.0]) / 3), np.zeros(3)
        short, alone = both_ways(solver, (SLEWS[0], end, SLEWS[2]), monkeypatch)
        alike(short, alone)
        assert short.success
        set_out.append(pursuits[0] is not None)
        pursuits.clear()
    assert set_out == sorted(set_out, reverse=True)
    assert set_out[0]
    assert not set_out[-1]
