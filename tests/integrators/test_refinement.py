"""Solutions of an accuracy that is asked for: beside closed forms, while what is decided changes."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from retrax import problems
from retrax.integrators import (
    Free,
    OptimalControlProblem,
    Solver,
    discretization_error,
    load_solution,
    solve,
    step_errors,
    switching_structure,
)
from retrax.integrators.boundary_value.audit.step_errors import StepErrors
from retrax.integrators.boundary_value.drivers.mesh_refinement import MOST_PARTS_OF_STEP, MeshRefinement, _MeshSolution
from retrax.manifolds import ConvergenceError, Euclidean, InvalidInputError
from retrax.retractions import Addition, Euler, Gauss, Midpoint, Radau

LINE, PLANE = Euclidean(1), Euclidean(2)
FLAT = Addition(LINE)


def energy(q, u):
    return u @ u / 2


def cart(q, u):
    return jnp.stack([q[1], u[0]])


REGULATOR = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: (q @ q + u @ u) / 2, 1)
HYPERSENSITIVE = problems.get("hypersensitive")


@pytest.mark.parametrize("stages", [1, 2, pytest.param(3, marks=pytest.mark.slow)])
def test_errors_of_steps_sum_up_to_that_of_the_cost(stages):
    """Where the dynamics are integrated exactly, as ``x' = u``, all of it is in the controls."""
    solver = Solver(REGULATOR, Gauss(stages, Addition(LINE)), 4)
    for steps in (4, 16):
        found = solver.with_steps(steps).solve(np.ones(1), None, 1.0)
        errors = step_errors(REGULATOR, found)
        assert np.max(errors.states) == 0
        assert 0.2 < np.sum(errors.controls) / abs(found.cost / (np.tanh(1) / 2) - 1) < 20


def test_the_steps_that_are_too_long_are_those_in_the_layers():
    entry = HYPERSENSITIVE
    found = solve(entry.problem, entry.start, entry.end, 30.0, method=entry.discretization, steps=30)
    bad = step_errors(entry.problem, found).each
    assert set(np.argsort(bad)[-4:]) <= {0, 1, 2, 27, 28, 29}
    assert np.max(bad[10:20]) < 1e-9 * np.max(bad)


@pytest.mark.parametrize("weight", [0.0, 1e-40, 1e-24, 1e-12, 1.0])
@pytest.mark.usual(1)
def test_a_control_of_no_effect_has_no_error(weight):
    """An oscillator that nothing, or next to nothing, asks to stop: the control tends to zero with the weight."""
    size, free = np.sqrt(weight), np.array([np.cos(4.0), -2 * np.sin(4.0)])  # where it ends without control
    problem = OptimalControlProblem(
        PLANE,
        lambda q, u: jnp.stack([q[1], u[0] - 4 * q[0]]),
        energy,
        1,
        terminal_cost=lambda q: (size * q) @ (size * q) / 2,
    )
    found = solve(problem, np.array([1.0, 0.0]), None, 2.0)
    assert found.status == "minimum"
    assert found.states[-1] == pytest.approx(free, abs=1e-7 + weight)
    if weight < 1e-6:
        assert found.cost == pytest.approx(weight * free @ free / 2, rel=1e-6, abs=1e-30)


@pytest.mark.parametrize("steps", [5, pytest.param(np.geomspace(1, 1e3, 12), marks=pytest.mark.slow)])
def test_an_accuracy_is_reached_or_what_is_reached_is_said(steps):
    """From what a coarse mesh has to what no mesh has; the closed form neglects ``exp(-40)``."""
    entry = HYPERSENSITIVE
    for accuracy in (1e-2, 1e-6, 1e-11, 1e-17):
        given = entry.problem, entry.start, entry.end, 40.0
        found = solve(*given, method=entry.discretization, steps=steps, accuracy=accuracy, throw=False)
        assert found.success == (found.checks.error <= accuracy) == (accuracy > 1e-15), found.result
        assert abs(entry.distance(found.cost)) < 10 * max(found.checks.error, 1e-13)
        if not found.success:
            assert "not to the accuracy of 1.0e-17" in found.result


QUICKEST = OptimalControlProblem(PLANE, cart, lambda q, u: 1.0, 1, control_bounds=(-1, 1))


def quickest(speed):
    """The least time from a speed to rest at distance 1, and the times of its switch."""
    sign = 1 if speed**2 < 2 else -1
    root = np.sqrt(speed**2 / 2 + sign)
    return 2 * root - sign * speed, root - sign * speed, sign


@pytest.mark.parametrize("longer", [(1.0,), pytest.param(tuple(1 + 0.01 * np.arange(1, 12)), marks=pytest.mark.slow)])
def test_a_mesh_that_is_too_coarse_to_begin_with(longer):
    """Rounding decides whether 20 steps of 500 arrive, where layers are 10 long: other meshes are tried."""
    dynamics, resting = (lambda q, u: u - q**3), (lambda q, u: (q @ q + u @ u) / 2)
    problem, method = OptimalControlProblem(LINE, dynamics, resting, 1), Gauss(3, Addition(LINE))
    for share in longer:
        found = solve(
            problem, np.ones(1), np.array([1.5]), 1e4 * share, method=method, steps=np.ones(20), accuracy=1e-6
        )
        assert found.cost == pytest.approx(3.36205689, rel=1e-5)


@pytest.mark.parametrize("speeds", [(0.9,), pytest.param((0.0, 1.41, 1.4142, 1.42, 3.0), marks=pytest.mark.slow)])
def test_a_switch_is_found_wherever_it_is(speeds):
    """It moves over nodes and towards the start, beyond which the signs change."""
    for speed in speeds:
        least, first, sign = quickest(speed)
        ends = np.array([0.0, speed]), np.array([1.0, 0.0])
        found = solve(
            QUICKEST, *ends, Free(3.0), method=Gauss(2, Addition(PLANE)), steps=10, accuracy=1e-9, throw=False
        )
        assert abs(found.horizon - least) < max(found.checks.error, 1e-9) * least
        assert found.success or 0 < first < 1e-4  # an arc shorter than that may not be seen
        if first > 0.1 and least - first > 0.1:
            assert found.checks.hamiltonian_spread < 1e-8
            structure = switching_structure(QUICKEST, found)
            np.testing.assert_allclose(structure.times, [0, first, least], atol=1e-10)
            assert structure.sides.tolist() == [[sign], [-sign]]
            side = found.multipliers["control_bounds upper"] - found.multipliers["control_bounds lower"]
            np.testing.assert_array_equal(np.sign(side[:, 0]), np.sign(found.controls[:, 0]))
            counts = {
                name: np.sum(rows > 0) for name, rows in found.multipliers.items() if name.startswith("control_bounds")
            }
            assert found.checks.active == counts


@pytest.mark.parametrize("limits", [(1.01, 1.0, 0.99, 0.9), (1.5, 0.95, 0.8, 0.5)], ids=["near", "far"])
@pytest.mark.parametrize(("stages", "steps", "at_nodes"), [(2, 20, False), (3, 10, True)])
@pytest.mark.slow
def test_a_coast_between_two_switches_comes_with_a_limit_of_the_speed(stages, steps, at_nodes, limits):
    """Least time is ``v + 1 / v`` with a limit ``v < 1`` of the speed. Along a coast the control is not at a bound, and
    an arc without one could be at a bound as well: where it ends nothing says."""
    for limit in limits:

        def speed(q, *_, limit=limit):
            return q[1] - limit

        held = {"node_constraints": {"at nodes": speed}} if at_nodes else {}
        problem = OptimalControlProblem(
            PLANE, cart, lambda q, u: 1.0, 1, control_bounds=(-1, 1), constraints={"speed": speed}, **held
        )
        method = Gauss(stages, Addition(PLANE))
        found = solve(
            problem,
            np.zeros(2),
            np.array([1.0, 0.0]),
            Free(3.0),
            method=method,
            steps=steps,
            accuracy=1e-4,
            throw=False,
        )
        assert found.success, (limit, found.result)
        assert found.cost == pytest.approx(limit + 1 / limit if limit < 1 else 2.0, rel=1e-4), limit


DECAY = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: q @ q, 1, control_bounds=(-1, 1))


@pytest.mark.parametrize("force", [4.0, pytest.param(0.25, marks=pytest.mark.slow)])
def test_parameters_hold_in_arcs_too(force):
    """A force of ``c`` instead of one, with times ``sqrt(c)`` times as short."""
    problem = OptimalControlProblem(
        PLANE, lambda q, u, c: jnp.stack([q[1], c * u[0]]), lambda q, u, c: 1.0, 1, control_bounds=(-1, 1)
    )
    (time, switch, _), rate = quickest(0.9), np.sqrt(force)
    given = np.array([0.0, 0.9 * rate]), np.array([1.0, 0.0]), Free(1.5)
    found = solve(problem, *given, method=Gauss(2, Addition(PLANE)), steps=5, parameters=force, accuracy=1e-10)
    assert found.horizon == pytest.approx(time / rate, rel=1e-9)
    assert np.min(np.abs(found.times - switch / rate)) < 1e-9
    assert found.steps < 20  # both arcs are parabolas: no step of theirs is divided


@pytest.mark.parametrize("slopes", [(0.5,), pytest.param((-0.3, 0.01, 0.2, 0.8, 1.1), marks=pytest.mark.slow)])
def test_ends_on_a_set_hold_in_arcs_too(slopes):
    """To the line ``x = 1 + c v`` in least time: forward, and for the last ``c`` of the time backward."""
    labels = {"controls": "force"}
    for c in slopes:
        ends = {"line": lambda first, last, c=c: last[0] - 1 - c * last[1]}
        problem = OptimalControlProblem(
            PLANE, cart, lambda q, u: 1.0, 1, control_bounds=(-1, 1), boundary_constraints=ends, labels=labels
        )
        guess = Free(np.array([1.0, 0.5]))
        found = solve(
            problem, np.array([0.0, 0.9]), guess, Free(2.0), method=Gauss(2, Addition(PLANE)), steps=10, accuracy=1e-9
        )
        least = np.sqrt(2.81 - c**2) - 0.9 + c if c > 0 else c - 0.9 + np.sqrt((0.9 - c) ** 2 + 2 + 1.8 * c)
        assert found.horizon == pytest.approx(least, rel=1e-9)
        assert abs(found.states[-1, 0] - 1 - c * found.states[-1, 1]) < 1e-12
        assert switching_structure(problem, found).arcs == 1 + (c > 0)
        along = found.states[-1, 1] - c * (1 if c < 0 else -1)  # what the rate of the equation is at the end
        np.testing.assert_allclose(found.multipliers["line"], [-1 / along], rtol=1e-8)
        assert found.quantities.controls[0].name == "force"


NEAR = 1.0 + np.array([-1e-5, -1e-8, 1e-11, 1e-5, 1e-2])


@pytest.mark.parametrize("shares", [(1 - 5e-7,), pytest.param(tuple(NEAR), marks=pytest.mark.slow)])
def test_a_bound_of_the_horizon_holds_in_arcs_where_it_pulls(shares):
    """It passes the horizon in arcs, then that of the first mesh, which is too long; nearby it holds what it pulls
    alone."""
    least, _, _ = quickest(0.9)
    ends = np.array([0.0, 0.9]), np.array([1.0, 0.0])
    for share in shares:
        horizon = Free(3.0, lower=share * least)
        found = solve(QUICKEST, *ends, horizon, method=Gauss(2, Addition(PLANE)), steps=10, accuracy=1e-9)
        assert found.horizon == pytest.approx(max(share, 1.0) * least, rel=1e-10)  # a tenth of the accuracy
        np.testing.assert_allclose(found.states[-1], ends[1], atol=1e-9)


@pytest.mark.slow
def test_a_bound_a_little_beyond_the_least_time_leads_to_no_false_success():
    """All controls that arrive are optimal there, and there are hardly any: the accuracy is reached, or what is."""
    least, _, _ = quickest(0.9)
    for share in 1 + np.geomspace(1e-10, 1e-6, 5):
        ends = np.array([0.0, 0.9]), np.array([1.0, 0.0])
        found = solve(
            QUICKEST,
            *ends,
            Free(3.0, lower=share * least),
            method=Gauss(2, Addition(PLANE)),
            steps=10,
            accuracy=1e-9,
            throw=False,
        )
        assert found.horizon == pytest.approx(share * least, rel=1e-10)
        np.testing.assert_allclose(found.states[-1], ends[1], atol=1e-9)
        if found.success:
            assert found.checks.error <= 1e-9
        else:
            assert "not to the accuracy of 1.0e-09 that was asked for" in found.result


@pytest.mark.slow
def test_a_singular_arc_comes_and_goes():
    """To a singular arc and away from it, ``x = u = 0``, for which there is time only beyond 3/2."""
    method = Gauss(3, Addition(LINE))
    for horizon in (1.2, 1.49, 1.5, 1.51, 2.0, 5.0):
        lowest = max((1.5 - horizon) / 2, 0)
        cost = (1 + 1 / 8 - 2 * lowest**3) / 3
        found = solve(DECAY, np.ones(1), np.array([0.5]), horizon, method=method, steps=20, accuracy=1e-8, throw=False)
        assert found.success, found.result
        assert abs(found.cost - cost) < 1e-8
    assert switching_structure(DECAY, found).sides.tolist() == [[-1], [0], [1]]


def test_a_bound_that_becomes_inactive():
    """Least energy from rest to rest: the control is a line, cut off at its bounds, which hold it up to 6."""
    method = Gauss(2, Addition(PLANE))
    for limit in (4.2, 5.9, 6.1):
        problem = OptimalControlProblem(PLANE, cart, energy, 1, control_bounds=(-limit, limit))
        width = np.sqrt(3 * (0.25 - 1 / limit)) if limit < 6 else 0.5
        cost = limit**2 * (0.5 - 2 * width / 3) if limit < 6 else 6.0
        found = solve(problem, np.zeros(2), np.array([1.0, 0.0]), 1.0, method=method, steps=10, accuracy=1e-8)
        assert abs(found.cost / cost - 1) < 1e-8
        held = np.max([np.max(rows) for rows in found.multipliers.values()])
        assert (held > 1e-2) == (limit < 6)


def test_stages_are_added_where_all_steps_err_and_steps_where_few_do():
    smooth = solve(REGULATOR, np.ones(1), None, 1.0, method=Gauss(2, Addition(LINE)), steps=4, accuracy=1e-9)
    assert (smooth.steps, len(smooth.stage_times) > 8) == (4, True)
    entry = HYPERSENSITIVE
    layered = solve(entry.problem, entry.start, entry.end, 100.0, method=entry.discretization, steps=30, accuracy=1e-8)
    lengths = np.diff(layered.times)
    assert len(layered.stage_times) == 3 * layered.steps
    assert np.max(lengths) > 10 * np.min(lengths)


METHODS = Radau(1, FLAT), Radau(2, FLAT), Radau(4, FLAT), Gauss(1, FLAT), Gauss(3, FLAT), Midpoint(FLAT), Euler(FLAT)


@pytest.mark.parametrize("method", METHODS)
def test_steps_are_divided_by_the_order_of_the_method(method):
    """States that err by ``h^(p + 1)`` in each step meet the accuracy in so many parts, and in none fewer."""
    count, accuracy, order = 10, 1e-6, method.order
    asked = SimpleNamespace(method=method, accuracy=accuracy)
    mesh = SimpleNamespace(steps=count, stage_times=np.zeros(count * len(method.nodes)))
    for times in np.geomspace(0.3, 0.99 * MOST_PARTS_OF_STEP**order, 23):  # the accuracy
        each, zero = np.full(count, times * accuracy / count), np.zeros(count)
        parts = MeshRefinement._parts(asked, _MeshSolution(mesh, StepErrors(each, zero, zero, {})))
        assert np.sum(each / parts**order) <= accuracy
        fewer = np.maximum(parts - 1, 1)
        assert np.all(parts == 1) or np.sum(each / fewer**order) > accuracy


@pytest.mark.parametrize(
    ("stages", "rate"), [(2, -3.0), *(pytest.param(*of, marks=pytest.mark.slow) for of in ((3, 0.0), (2, 1.0)))]
)
def test_an_accuracy_is_met_by_a_radau_method_in_few_steps(stages, rate):
    """Against the closed form of Riccati's equation, and against equal steps with the stages of the refined mesh."""
    problem = OptimalControlProblem(LINE, lambda q, u: rate * q + u, lambda q, u: (q @ q + u @ u) / 2, 1)
    root = np.hypot(rate, 1.0)
    most = np.tanh(2 * root)
    given, optimum = (problem, np.ones(1), None, 2.0), most / (root - rate * most) / 2
    for accuracy in (1e-3, 1e-6):
        found = solve(*given, method=Radau(stages, FLAT), steps=5, accuracy=accuracy)
        assert max(found.checks.error, abs(found.cost / optimum - 1)) <= accuracy
        own = Radau(len(found.stage_times) // found.steps, FLAT)
        coarse = solve(*given, method=own, steps=found.steps // 2)
        errors = step_errors(problem, coarse)
        assert found.steps <= 5 or np.sum(np.maximum(errors.states, errors.controls)) > accuracy


def test_the_midpoint_rule_gets_more_steps():
    given, on = (REGULATOR, np.ones(1), None, 1.0), {"method": Midpoint(Addition(LINE)), "steps": 5}
    found = solve(*given, **on, accuracy=1e-5)
    assert found.steps > 20
    with pytest.raises(ConvergenceError, match="not to the accuracy"):
        solve(*given, **on, accuracy=1e-14)
    assert abs(found.cost / (np.tanh(1) / 2) - 1) < 1e-5


@pytest.mark.slow
def test_parameters_and_time_are_kept(tmp_path):
    """A free parameter and an explicit time beside a switch: the quickest way to a place that moves away."""

    def pulled(q, u, t, p):
        return jnp.stack([q[1], u[0] + p["pull"] * jnp.sin(t)])

    problem = OptimalControlProblem(
        PLANE, pulled, lambda q, u, t, p: 1.0 + p["offset"] ** 2, 1, control_bounds=(-1, 1), time_dependent=True
    )
    parameters = {"pull": 0.3, "offset": Free(0.5)}
    given, method = (problem, np.zeros(2), np.array([1.0, 0.0]), Free(2.0)), Gauss(3, Addition(PLANE))
    found = solve(*given, method=method, steps=8, parameters=parameters, accuracy=1e-9)
    structure = switching_structure(problem, found)
    assert structure.sides.tolist() == [[1], [-1]]
    s, T = structure.times[1:]
    speed, place = 2 * s - T + 0.3 * (1 - np.cos(T)), 2 * s * T - s**2 - T**2 / 2 + 0.3 * (T - np.sin(T))
    assert abs(speed) < 1e-8
    assert abs(place - 1) < 1e-8
    assert abs(found.parameters["offset"]) < 1e-9
    assert found.parameters["pull"] == 0.3
    assert set(found.multipliers) == {"control_bounds lower", "control_bounds upper"}
    exact = discretization_error(problem, Addition(PLANE), found, found.parameters)
    assert max(exact.largest.values()) < 1e-9
    found.save(tmp_path / "found.npz")
    assert load_solution(tmp_path / "found.npz").checks == found.checks
    assert "error of the discretization, summed over the steps" in str(found)


def test_a_solver_in_other_steps_is_the_same_solver():
    method, start, end = Gauss(2, Addition(PLANE)), np.zeros(2), np.array([1.0, 0.0])
    solver = Solver(QUICKEST, method, 10)
    first = solver.solve(start, end, Free(3.0))
    for steps in (7, np.array([1.0, 2.0, 3.0, 1.0])):
        other = solver.with_steps(steps)
        found, again = other.solve(start, end, Free(3.0)), Solver(QUICKEST, method, steps).solve(start, end, Free(3.0))
        np.testing.assert_allclose(found.controls, again.controls, atol=1e-11)
        np.testing.assert_allclose(found.times, again.times, rtol=1e-12)
    assert solver.steps == 10
    np.testing.assert_array_equal(solver.solve(start, end, Free(3.0)).controls, first.controls)


def test_what_accuracy_cannot_be():
    given, on = (REGULATOR, np.ones(1), None, 1.0), {"method": Gauss(2, Addition(LINE)), "steps": 4}
    for wrong in (0.0, -1e-8, np.nan, np.inf, 10**400, True, np.ones(2), "fine"):
        with pytest.raises(InvalidInputError, match="accuracy must be"):
            solve(*given, **on, accuracy=wrong)
    with pytest.raises(InvalidInputError, match="without control_bounds"):
        switching_structure(REGULATOR, solve(*given, **on))
    for looks in (switching_structure, step_errors):
        with pytest.raises(InvalidInputError, match=f"{looks.__name__} takes .* got 3; try what solve returns"):
            looks(REGULATOR, 3)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "steps", "stages"), [("betts", 20, 3), ("bilimoria-wie", 40, 2)])
def test_least_times_to_ten_digits(name, steps, stages):
    """On other meshes than those of the records."""
    entry = problems.get(name)
    found = entry.solve(steps, Gauss(stages, entry.discretization.retraction), accuracy=1e-9)
    assert abs(entry.distance(found.cost)) < 1e-9
    assert switching_structure(entry.problem, found).arcs == 6


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rest-to-rest-slew", "kinematic-slew"])
def test_curved_spaces(name):
    entry = problems.get(name)
    found = entry.solve(6, Gauss(2, entry.discretization.retraction), accuracy=1e-9)
    assert abs(entry.distance(found.cost)) < 1e-9
