"""The solver that a user holds: parameters, batches, unequal steps, callbacks, interrupts, evaluators."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Result, Solver, solve
from retrax.manifolds import Euclidean, InvalidInputError, Sphere, hat
from retrax.retractions import Exponential, Gauss, Midpoint, Projection, default_retraction

from tests.support.changing import WAYS, held

from .problems import INERTIA, REST, RIGID, rotation

PLANE = Euclidean(2)
START, END, HORIZON, STEPS = np.zeros(2), np.array([1.0, 0.0]), 1.5, 5
GIVEN = {"mass": 2.0, "drag": (np.array([0.3, 0.1]),)}
FEW = "attribute of a class", "slots", "jitted helper", "jitted helper of a derivative"  # others are traced as these
DEFAULT = np.finfo(float).eps ** 0.7


def cart(q, u, parameters):
    """A mass with linear and cubic drag under a force."""
    linear, cubic = parameters["drag"][0]
    return jnp.stack([q[1], (u[0] - linear * q[1] - cubic * q[1] ** 3) / parameters["mass"]])


def effort(q, u):
    """``|u|^2 / 2``."""
    return u @ u / 2


CART = OptimalControlProblem(PLANE, cart, effort, 1)
BOUND = OptimalControlProblem(PLANE, lambda q, u: cart(q, u, GIVEN), effort, 1)
MIDPOINT = Midpoint(Exponential(PLANE))


@pytest.fixture(scope="module")
def solver():
    return Solver(CART, MIDPOINT, STEPS)


@pytest.fixture(scope="module")
def bound():
    return Solver(BOUND, MIDPOINT, STEPS)


def assert_same(one, other, tolerance=0.0, controls=None):
    """The same states, costates, controls and cost."""
    for name in ("times", "states", "costates", "controls", "cost"):
        for a, b in zip(*(jax.tree.leaves(getattr(s, name)) for s in (one, other)), strict=True):
            own = controls if name in ("controls", "costates") and controls else tolerance
            np.testing.assert_allclose(a, b, rtol=0, atol=own * (1 + np.max(np.abs(b))), err_msg=name)


def with_mass(mass):
    return {**GIVEN, "mass": mass}


def test_a_solver_that_is_held_gives_what_solve_gives(bound):
    for end in (END, np.array([0.4, 0.7])):
        held_one, at_once = (
            bound.solve(START, end, HORIZON),
            solve(BOUND, START, end, HORIZON, method=MIDPOINT, steps=STEPS),
        )
        assert held_one.success
        assert_same(held_one, at_once)


def test_parameters_are_the_values_of_each_call(solver, bound):
    assert_same(solver.solve(START, END, HORIZON, parameters=GIVEN), bound.solve(START, END, HORIZON), 1e-13)
    for mass in (1.0, 10.0, 1.0):
        here = OptimalControlProblem(PLANE, lambda q, u, mass=mass: cart(q, u, with_mass(mass)), effort, 1)
        expected = solve(here, START, END, HORIZON, method=MIDPOINT, steps=STEPS)
        assert_same(solver.solve(START, END, HORIZON, parameters=with_mass(mass)), expected, 1e-12)


def test_parameters_of_another_structure_are_traced_anew():
    """``q' = k u`` with the sum of whatever is given for ``k``."""
    problem = OptimalControlProblem(
        Euclidean(1), lambda q, u, p: sum(jnp.sum(leaf) for leaf in jax.tree.leaves(p)) * u, effort, 1
    )
    solver = Solver(problem, Midpoint(Exponential(Euclidean(1))), 2)
    for parameters in (2.0, np.array([0.5, 1.5]), {"a": 1.0, "b": (0.5, np.array([0.25, 0.25]))}, 3, 2.0):
        total = sum(np.sum(leaf) for leaf in jax.tree.leaves(parameters))
        found = solver.solve(np.zeros(1), np.ones(1), 1.0, parameters=parameters)
        np.testing.assert_allclose(found.controls, 1 / total, rtol=1e-12)


def test_missing_superfluous_and_impossible_parameters_are_refused(solver, bound):
    words = "parameters, and none are given: dynamics has .*, one more than the 2 of one without parameters; try"
    with pytest.raises(InvalidInputError, match=words):
        solver.solve(START, END, HORIZON)
    with pytest.raises(InvalidInputError, match=r"parameters are given, .* and no function of the problem takes them"):
        bound.solve(START, END, HORIZON, parameters=GIVEN)
    for wrong in (np.nan, np.inf, "2", 1j):
        with pytest.raises(InvalidInputError, match="parameters must be finite real numbers"):
            solver.solve(START, END, HORIZON, parameters=with_mass(wrong))


def batch(count):
    """Ends, horizons and parameters of members that differ in all of them."""
    k = np.arange(count)
    ends = np.stack([0.5 + 0.4 * k, 0.3 * np.cos(k)], axis=1)
    parameters = {"mass": 1.0 + k, "drag": (np.stack([0.1 * k, 0.2 + 0.05 * k], axis=1),)}
    return ends, 1.0 + 0.3 * k, parameters


def test_a_batch_is_a_loop_over_its_members(solver):
    ends, horizons, parameters = batch(4)
    seen = []
    many = solver.solve_many(START, ends, horizons, parameters=parameters, callback=lambda i: seen.append(i.members))
    assert many.converged == len(many) == 4
    for k, found in enumerate(many):
        own = jax.tree.map(lambda leaf, k=k: leaf[k], parameters)
        one = solver.solve(START, ends[k], horizons[k], parameters=own)
        assert_same(found, one, 1e-12)
        assert found.statistics.iterations == one.statistics.iterations
    np.testing.assert_array_equal(many.cost, [found.cost for found in many])


def test_a_callback_sees_members_in_turn_and_one_that_cannot_be_solved_spoils_none(solver):
    """The second is at rest and linear; no force moves the third, whose mass is infinite to rounding."""
    ends, horizons, parameters = batch(4)
    parameters["drag"][0][1] = 0
    parameters["mass"][2] = 1e300
    seen = []
    many = solver.solve_many(
        START, ends, horizons, parameters=parameters, callback=lambda i: seen.append(list(i.members))
    )
    assert list(many.success) == [True, True, False, True]
    assert [len(places) for places in seen] == [1] * len(seen)
    assert sorted(seen) == seen
    assert {places[0] for places in seen} == {0, 1, 2, 3}
    for k in (0, 1, 3):
        own = jax.tree.map(lambda leaf, k=k: leaf[k], parameters)
        assert_same(many[k], solver.solve(START, ends[k], horizons[k], parameters=own), 1e-12)


@pytest.mark.parametrize("unequal", [(1, 2, 4, 3, 1), (4, 1, 1, 1, 3)])
def test_unequal_steps_keep_their_order(unequal):
    """Minimal effort of a double integrator: the costate of the velocity, and the control, are linear in time."""
    line = OptimalControlProblem(PLANE, lambda q, u: jnp.stack([q[1], u[0]]), effort, 1)
    found = solve(line, START, END, HORIZON, method=Gauss(2, Exponential(PLANE)), steps=np.array(unequal, float))
    times = np.concatenate([[0.0], np.cumsum(unequal)]) * HORIZON / np.sum(unequal)
    np.testing.assert_allclose(found.times, times, rtol=1e-14)
    t, stages = times / HORIZON, found.stage_times / HORIZON
    np.testing.assert_allclose(found.states[:, 0], 3 * t**2 - 2 * t**3, atol=1e-12)
    np.testing.assert_allclose(found.controls[:, 0], 6 * (1 - 2 * stages) / HORIZON**2, atol=1e-11)


def test_a_callback_sees_every_iteration_and_can_stop(bound):
    seen = []
    whole = bound.solve(START, END, HORIZON, callback=lambda i: seen.append(i))
    assert [i.number for i in seen] == list(range(whole.statistics.iterations + 1))
    assert seen[-1].defect[0] == whole.checks.defect <= DEFAULT
    for last in range(len(seen) - 1):
        stopped = bound.solve(START, END, HORIZON, callback=lambda i, last=last: i.number >= last, throw=False)
        assert not stopped.success
        assert stopped.result == Result[Result.stopped]
        assert (stopped.statistics.iterations, stopped.cost) == (last, seen[last].cost[0])


def test_a_batch_is_stopped_in_any_iteration_also_where_members_leave(solver):
    """The first is at rest and linear: it arrives before the others."""
    ends, horizons, parameters = batch(4)
    parameters["drag"][0][0] = 0
    for last in range(8):
        stopped = solver.solve_many(
            START, ends, horizons, parameters=parameters, callback=lambda i, last=last: i.number >= last
        )
        assert len(stopped) == len(stopped.result) == 4
        assert np.isfinite(stopped.cost).all()
        words = [Result[Result.stopped], Result[Result.successful]]
        assert {*stopped.result} <= {*words}, stopped.result
    assert not any(solver.solve_many(START, ends, horizons, parameters=parameters, callback=lambda i: True).success)


def test_an_interrupt_returns_the_best_iterate(bound):
    """It comes after the second iteration; the third would have converged further."""
    seen = []

    def interrupt(iteration):
        seen.append(iteration)
        if iteration.number == 2:
            raise KeyboardInterrupt

    found = bound.solve(START, END, HORIZON, callback=interrupt, throw=False)
    assert not found.success
    assert found.result == Result[Result.stopped]
    assert found.checks.defect == seen[-1].defect[0] < seen[0].defect[0]
    many = bound.solve_many(START, np.stack([END, 2 * END]), HORIZON, callback=interrupt)
    assert not many.success.any()


def test_verbose_prints_a_line_for_each_iteration(bound, capsys):
    found = bound.solve(START, END, HORIZON, verbose=True)
    title, *lines = capsys.readouterr().out.splitlines()
    assert title.split() == ["iteration", "cost", "defect", "stationarity", "shift", "step"]
    assert len(lines) == found.statistics.iterations + 1
    assert float(lines[-1].split()[1]) == pytest.approx(found.cost, rel=1e-8)


@pytest.mark.parametrize("way", [way if way in FEW else pytest.param(way, marks=pytest.mark.slow) for way in WAYS])
def test_a_value_that_is_held_and_changes_is_never_ignored(way):
    """``q' = u`` at the cost ``k u^2``: the optimum costs ``k``, its costate is ``2 k``."""
    product, change = held(way, 1.0)
    line = Euclidean(1)
    for k in (1.0, 10.0, 1.0):
        change(k)
        problem = OptimalControlProblem(line, lambda q, u: u, lambda q, u: u @ product(u), 1)
        found = solve(problem, np.zeros(1), np.ones(1), 1.0, method=Midpoint(Exponential(line)), steps=2)
        assert found.cost == pytest.approx(k, rel=1e-12)
        np.testing.assert_allclose(found.costates, 2 * k, rtol=1e-12)


@pytest.mark.parametrize("factor", [2.0**k for k in range(-3, 4)])
def test_success_is_decided_by_the_tolerance(bound, factor):
    """One iteration fewer than are needed, and a tolerance about the residual reached by then."""
    seen = []
    bound.solve(START, END, HORIZON, callback=lambda i: seen.append(max(i.defect[0], i.stationarity[0])))
    steps = len(seen) - 2
    reached = seen[steps]
    found = bound.solve(START, END, HORIZON, tolerance=factor * reached, max_iterations=steps, throw=False)
    assert max(found.checks.defect, found.checks.stationarity) <= reached * (1 + 1e-12)
    assert found.success == (factor >= 1)


def oscillator(q, u):
    """The action of a unit oscillator: its extremals are conjugate after half a period."""
    return (u @ u - q @ q) / 2


def test_success_across_a_conjugate_point():
    """From 0 to 1 the action has the extremal ``sin t / sin T``, unless ``T = pi``; it is a minimum for ``T < pi``
    alone."""
    line, steps = Euclidean(1), 20
    solver = Solver(OptimalControlProblem(line, lambda q, u: u, oscillator, 1), Midpoint(Exponential(line)), steps)
    conjugate = 2 * steps * np.tan(np.pi / 2 / steps)  # of the midpoint rule
    for offset in (-0.3, -1e-3, -1e-6, 1e-6, 1e-3, 0.3):
        found = solver.solve(np.zeros(1), np.ones(1), conjugate * (1 + offset))
        angle = 2 * np.arctan(conjugate * (1 + offset) / steps / 2)
        expected = np.sin(angle * np.arange(steps + 1)) / np.sin(angle * steps)
        np.testing.assert_allclose(found.states[:, 0], expected, rtol=1e-6, atol=1e-9)
        assert found.checks.strict_minimum == (offset < 0)
    at = solver.solve(np.zeros(1), np.ones(1), conjugate, throw=False)
    assert not at.success
    assert not at.checks.strict_minimum


def body(q, u):
    """Rigid body with three torques."""
    return q[0] @ hat(q[1]), (u - jnp.cross(q[1], INERTIA * q[1])) / INERTIA


def gravity(q, u):
    """Effort, with a potential."""
    return u @ u / 2 + 0.3 * q[2] ** 2 + 0.1 * q[0]


SPHERE = Sphere(2)
ON_SPHERE = OptimalControlProblem(
    SPHERE, lambda q, u: jnp.cross(u, q) + jnp.cross(jnp.array([0, 0, 0.4]), q), gravity, 3
)
SLEW = OptimalControlProblem(RIGID, body, lambda q, u: u @ u / 2 + 0.1 * q[1] @ q[1], 3)
EVALUATED = {
    "S2": (ON_SPHERE, Projection(SPHERE), np.array([1.0, 0, 0]), np.array([0.6, 0.0, 0.8])),
    "SO3*R3": (SLEW, default_retraction(RIGID), (np.eye(3), REST), (rotation([0.5, 0.3, -0.8]), REST)),
}


@pytest.mark.long("S2-1")
@pytest.mark.parametrize(
    ("name", "stages"), [("S2", 1), ("SO3*R3", 1), ("S2", 2), pytest.param("SO3*R3", 2, marks=pytest.mark.slow)]
)
@pytest.mark.usual("S2-1", "S2-2")
def test_both_evaluators_give_the_same_numbers(name, stages):
    problem, retraction, start, end = EVALUATED[name]
    method = Midpoint(retraction) if stages == 1 else Gauss(stages, retraction)
    found = []
    for evaluator in ("tape", "xla"):
        solver = Solver(problem, method, 3, evaluator=evaluator)
        assert solver.evaluator == evaluator
        found.append(solver.solve(start, end, 1.0))
    assert_same(*found, 1e-10)
    if stages == 1:
        assert_same(found[0], solve(problem, start, end, 1.0, method=Gauss(1, retraction), steps=3), 1e-14)


def test_a_function_that_has_no_scalars_is_evaluated_by_xla(bound):
    """The largest singular value of a diagonal matrix is its largest entry."""
    line = Euclidean(1)

    def cost(q, u):
        return jnp.linalg.svd(jnp.diag(jnp.stack([1 + u[0] ** 2, 0.5 + 0 * u[0]])), compute_uv=False)[0]

    solver = Solver(OptimalControlProblem(line, lambda q, u: u, cost, 1), Midpoint(Exponential(line)), 2)
    assert solver.evaluator == "xla"
    assert "svd" in solver.reason
    assert solver.solve(np.zeros(1), np.ones(1), 1.0).cost == pytest.approx(2.0, rel=1e-12)
    assert (bound.evaluator, bound.reason) == ("tape", "all functions are traced to scalar operations")


def test_ends_may_be_shared_and_free_in_a_batch(solver):
    """One start and horizon for all; and ends of which only the terminal cost asks something."""
    free = OptimalControlProblem(PLANE, cart, effort, 1, terminal_cost=lambda q, p: p["mass"] * (q - 1) @ (q - 1))
    starts = np.array([[0.0, 0.0], [0.2, -0.1], [0.0, 0.7]])
    several = Solver(free, Gauss(2, Exponential(PLANE)), 3)
    parameters = {"mass": np.array([0.5, 1.0, 4.0]), "drag": (np.tile(GIVEN["drag"][0], (3, 1)),)}
    many = several.solve_many(starts, None, HORIZON, parameters=parameters)
    for k, found in enumerate(many):
        own = jax.tree.map(lambda leaf, k=k: leaf[k], parameters)
        assert_same(found, several.solve(starts[k], None, HORIZON, parameters=own), 1e-12)
        slope = 2 * own["mass"] * (found.states[-1] - 1)
        np.testing.assert_allclose(found.costates[-1], -slope, rtol=1e-10)
    with pytest.raises(InvalidInputError, match="one length B"):
        several.solve_many(starts, None, [1.0, 2.0], parameters=parameters)
