"""Extremals along which a switching function vanishes: a success, with a sentence on the control that nothing
determines."""

import re
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax import problems
from retrax.integrators import Free, Guess, OptimalControlProblem, Solver, solve, switching_structure
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Gauss, Midpoint
from scipy.spatial.transform import Rotation

SPACE, LINE = Euclidean(4), Euclidean(1)
MEANINGS = "this is a singular arc|the extremal is not"
SAYS = re.compile(rf"A switching function vanishes, that of (\S+) from t = (\S+) to (\S+), where .*: ({MEANINGS})")


def said(solution: Any) -> tuple[str, ...]:
    """The control that is named, and the interval."""
    found = SAYS.search(solution.result)
    return found.groups() if found else ()


def carts(q: Array, u: Array) -> Array:
    return jnp.concatenate([q[2:], u])


@pytest.fixture(scope="module")
def race() -> Solver:
    """Two carts in least time: the nearer one has time to spare, and nothing determines its control."""
    names = {"controls": ("a", "b")}
    problem = OptimalControlProblem(SPACE, carts, lambda q, u: 1.0, 2, control_bounds=(-1.0, 1.0), labels=names)
    return Solver(problem, Gauss(2, Addition(SPACE)), 20)


def test_the_cart_with_time_to_spare_is_named(race):
    """Through the distance at which both arrive together."""
    for ahead in (-1.0, -0.5, -1e-2, -1e-3, -1e-6, 0.0, 1e-6, 1e-3, 0.1, 1.0):
        found = race.solve(np.zeros(4), np.array([1.0, 1.0 + ahead, 0.0, 0.0]), Free(2.5, lower=0.1))
        assert np.isclose(found.horizon, 2 * np.sqrt(max(1.0, 1.0 + ahead)), rtol=1e-5)
        name = () if abs(ahead) < 1e-4 else (("b",) if ahead < 0 else ("a",))
        assert said(found)[:1] == name, ahead
        if name:
            assert not found.checks.strict_minimum
            assert said(found)[3] == "the extremal is not"
            assert [float(t) for t in said(found)[1:3]] == pytest.approx([0.0, found.horizon], rel=1e-5)
    many = race.solve_many(np.zeros(4), np.array([[1.0, 1.2, 0.0, 0.0], [1.2, 1.0, 0.0, 0.0]]), Free(2.5, lower=0.1))
    assert [said(found)[0] for found in many] == ["a", "b"]


def test_a_turn_about_one_axis_is_said_to_be_only_stationary():
    """Half a turn of a sphere in least time: about its axis it takes 2 sqrt(pi), and 3.2431 with the other torques."""
    known = problems.get("bilimoria-wie")
    s = ((np.arange(10)[:, None] + np.array(known.method.nodes)) / 10).ravel()
    axis, angle = np.array([0.0, 0.0, 1.0]), np.pi * s**2 * (3 - 2 * s)
    states = Rotation.from_rotvec(np.outer(angle, axis)).as_matrix(), np.outer(np.pi * 6 * s * (1 - s) / 3.5, axis)
    guess = Guess(states, np.outer(0.6 * np.cos(np.pi * s), axis))
    found = solve(
        known.problem, known.start, known.end, Free(3.5, lower=0.1), method=known.method, steps=10, guess=guess
    )
    assert found.success
    assert np.isclose(found.horizon, 2 * np.sqrt(np.pi), rtol=1e-4)
    assert not found.checks.strict_minimum
    assert re.search(
        r"that of u\[0\] from t = 0 to 3.5449\d* and that of u\[1\] from t = 0 to 3.5449\d*, where", found.result
    )
    assert "may be one of many or only stationary, and another may cost less; try a guess in which this" in found.result


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_the_sentence_has_no_unit(unit):
    """Lengths, and the times with them, in other units."""

    def scaled(q: Array, u: Array) -> Array:
        return jnp.concatenate([q[2:], u * unit])

    problem = OptimalControlProblem(SPACE, scaled, lambda q, u: 1.0, 2, control_bounds=(-1.0, 1.0))
    solver = Solver(problem, Gauss(2, Addition(SPACE)), 20)
    for ahead, name in ((-1e-2, ("u[1]",)), (0.0, ()), (1e-2, ("u[0]",))):
        end = unit * np.array([1.0, 1.0 + ahead, 0.0, 0.0])
        assert said(solver.solve(np.zeros(4), end, Free(2.5, lower=0.1)))[:1] == name


def test_a_singular_arc_between_bangs_is_named_with_its_interval():
    """``q^2`` is driven to zero by a bounded rate, and stays there: the arc is a strict minimum."""
    problem = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: q @ q, 1, control_bounds=(-1.0, 1.0))
    solver = Solver(problem, Gauss(1, Addition(LINE)), 60)
    for width in (0.0, 0.3, 0.9, 1.5):
        found = solver.solve(np.ones(1), np.ones(1) * 1.0, 2.0 + width)
        if width == 0.0:
            assert not said(found)
        else:
            name, begin, end, meaning = said(found)
            assert (name, meaning) == (
                "u[0]",
                "this is a singular arc" if found.checks.strict_minimum else "the extremal is not",
            )
            assert [float(begin), float(end)] == pytest.approx([1.0, 1.0 + width], abs=2.5 * found.horizon / 60)


@pytest.mark.parametrize("weight", [0.0, 1e-3, 1e-1])
@pytest.mark.parametrize("fastest", [0.4, 0.8, 2.0])
@pytest.mark.usual(2)
def test_a_control_that_chatters_at_a_limit_of_the_speed_is_named(weight, fastest):
    """The cart is faster than 0.8 only if nothing limits it; a cost of the control ends the chattering."""
    names = {"controls": ("push",)}
    problem = OptimalControlProblem(
        Euclidean(2),
        lambda q, u: jnp.stack([q[1], u[0]]),
        lambda q, u: 1.0 + weight * u @ u,
        1,
        control_bounds=(-1.0, 1.0),
        labels=names,
        constraints={"speed": lambda q, u: q[1] - fastest},
    )
    method = Gauss(2, Addition(Euclidean(2)))
    found = solve(problem, np.zeros(2), np.array([1.0, 0.0]), Free(3.0, lower=0.1), method=method, steps=20)
    chatters = found.success and weight == 0.0 and fastest < 1.0
    assert ("A control chatters, push from t = " in found.result) == chatters
    if chatters:
        begin, end = map(float, re.search(r"from t = (\S+) to (\S+), where", found.result).groups())
        assert [begin, end] == pytest.approx([fastest, found.horizon - fastest], abs=3 * found.horizon / 20)


@pytest.mark.parametrize("weight", [0.0, 1e-12, 1e-6, 1.0])
def test_curvature_determines_a_control_whose_bounds_do_not_hold_it(weight):
    def price(q: Array, u: Array, weight: Array) -> Array:
        return q @ q + weight * u @ u

    problem = OptimalControlProblem(LINE, lambda q, u, weight: u, price, 1, control_bounds=(-1.0, 1.0))
    found = solve(
        problem, np.ones(1), np.ones(1), 3.0, method=Gauss(1, Addition(LINE)), steps=60, parameters=weight, throw=False
    )
    assert bool(said(found)) == (weight == 0.0)


def test_the_turn_about_the_axis_itself_is_slower_than_the_least_time():
    """Betts' spacecraft about its first axis, from a guess that stays on it: 34.3112 s, where 28.6304 s are enough."""
    entry = problems.get("betts")
    found = solve(entry.problem, entry.start, entry.end, entry.horizon, method=entry.discretization, steps=60)
    angle, torque, inertia = np.deg2rad(150), 50.0, 5621.0
    assert found.horizon == pytest.approx(2 * np.sqrt(angle * inertia / torque), rel=1e-5)
    assert found.horizon == pytest.approx(34.3112, rel=1e-5)
    assert "that of u[1] from t = 0 to 34.3112 and that of u[2] from t = 0 to 34.3112" in found.result
    assert "another may cost less" in found.result
    assert not found.checks.strict_minimum


QUADROTOR = Euclidean(6)  # position, attitude angle, velocity and rate
MASS, ARM, INERTIA, GRAVITY = 0.6, 0.15, 0.004, 9.81  # kg, m, kg m^2, m/s^2


def quadrotor(q: Array, u: Array) -> Array:
    """The planar quadrotor with two thrusts [Hehn, Ritz, D'Andrea 2012]."""
    lift = (u[0] + u[1]) / MASS
    force = jnp.array([-lift * jnp.sin(q[2]), lift * jnp.cos(q[2]) - GRAVITY])
    return jnp.concatenate([q[3:], force, (u[:1] - u[1:]) * ARM / INERTIA])


def fastest_flight(price: float, method: Any, steps: int, **options: Any) -> tuple[OptimalControlProblem, Any]:
    """5 m to the side and 1 m up in least time, with a price of the controls."""
    bounds = {"control_bounds": (0.3, 6.0), "labels": {"controls": ("right", "left")}}
    problem = OptimalControlProblem(QUADROTOR, quadrotor, lambda q, u: 1.0 + price * u @ u, 2, **bounds)
    end, horizon = np.array([5.0, 1.0, 0.0, 0.0, 0.0, 0.0]), Free(2.0, 0.2, 10.0)
    return problem, solve(problem, np.zeros(6), end, horizon, method=method, steps=steps, throw=False, **options)


@pytest.mark.parametrize("steps", [60, 120, pytest.param(240, marks=pytest.mark.slow)])
def test_singular_arcs_on_which_thrusts_chatter_are_named_whole(steps):
    """A thrust is singular where the other one is at its bound, and its discrete values chatter there."""
    problem, found = fastest_flight(0.0, Midpoint(Addition(QUADROTOR)), steps)
    assert found.success
    assert found.horizon == pytest.approx(1.2523, abs=1.5e-3)
    structure = switching_structure(problem, found)
    assert "free" not in str(structure)
    assert structure.singular is not None
    for entry, name in enumerate(("right", "left")):
        arcs = np.flatnonzero(structure.singular[:, entry])
        assert arcs.size
        longest = arcs[np.argmax(np.diff(structure.times)[arcs])]
        begin, end = structure.times[longest : longest + 2]
        assert re.search(rf"that of {name} from t = ", found.result)
        within = (found.stage_times > begin) & (found.stage_times < end)
        assert np.all(found.u[within, 1 - entry] > 6.0 - 1e-3)
        assert np.ptp(found.u[within, entry]) > 1.0  # it chatters
    assert "1e-3 * u @ u" in found.result


@pytest.mark.parametrize(("stages", "steps"), [(2, 240), pytest.param(3, 90, marks=pytest.mark.slow)])
def test_a_failure_near_a_singular_extremal_says_how_near_and_why(stages, steps):
    _, found = fastest_flight(0.0, Gauss(stages, Addition(QUADROTOR)), steps)
    assert not found.success
    assert "out of reach" not in found.result
    assert found.result.startswith("The iteration limit came near an extremal")
    named = re.search(r"Its largest residual is (\S+), and the tolerance (\S+)\. A switching function", found.result)
    assert named is not None
    assert 1e-11 < float(named[1]) < 1e-4
    assert "try a small running cost of this control, such as 1e-3 * u @ u" in found.result


@pytest.mark.slow
@pytest.mark.parametrize("steps", [60, 120, 240, 320])
@pytest.mark.parametrize("stages", [2, 3])
@pytest.mark.parametrize(("price", "options"), [(1e-4, {}), (0.0, {"tolerance": 1e-8})])
def test_what_is_tried_against_slow_convergence_helps(steps, stages, price, options):
    _, found = fastest_flight(price, Gauss(stages, Addition(QUADROTOR)), steps, **options)
    assert found.success
    assert found.horizon == pytest.approx(1.2522, abs=5e-4)
