"""Continuation from an easy problem to a hard one, its predictor, and where it ends."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Solver, continuation
from retrax.integrators.boundary_value.drivers.continuation import Predictor, problem_at
from retrax.manifolds import ConvergenceError, Euclidean, InvalidInputError, Sphere, hat
from retrax.retractions import Cayley, Exponential, Gauss, Midpoint, Projection

from tests.support.numerics import slope

from .problems import REST, RIGID, rotation

PLANE, SPHERE = Euclidean(2), Sphere(2)
PENDULUM = OptimalControlProblem(
    PLANE, lambda q, u, g: jnp.stack([q[1], u[0] - g * jnp.sin(q[0])]), lambda q, u: u @ u / 2, controls=1
)
TURNED = OptimalControlProblem(SPHERE, lambda q, u: jnp.cross(u, q), lambda q, u: u @ u / 2, controls=3)


def body(q, u, inertia):
    """Rigid body with three torques."""
    return q[0] @ hat(q[1]), (u - jnp.cross(q[1], inertia * q[1])) / inertia


SLEW = OptimalControlProblem(RIGID, body, lambda q, u: u @ u / 2, controls=3)


def swing_up(place):
    """From rest below to rest above in 4 s, against a gravity that grows to 20 m/s^2 for a length of 1 m."""
    return {"start": REST[:2], "end": np.array([np.pi, 0.0]), "horizon": 4.0, "parameters": 20 * place}


def slew(place):
    """A thin body, thinner and thinner: inertias up to 1 to 30."""
    inertia = np.array([1.0, 30.0**place, 30.0 ** (1.02 * place)])
    target = rotation(np.array([2.0, 0.6, -1.2]))
    return {"start": (np.eye(3), REST), "end": (target, REST), "horizon": 1.0, "parameters": inertia}


def everything(place):
    """Ends, horizon and parameters change at once."""
    end = rotation(np.array([0.4, 0.3, -0.2]) * (1 + place)), REST + 0.1 * place
    start = rotation(np.array([0.0, 0.2, 0.0]) * place), REST
    return {"start": start, "end": end, "horizon": 1 + place / 2, "parameters": np.array([1.0, 1.5 + place, 2.0])}


def arc(angle):
    """The way to an end whose angle from the start grows from 1 rad."""

    def path(place):
        a = 1 + (angle - 1) * place
        return {"start": np.array([1.0, 0, 0]), "end": np.array([np.cos(a), np.sin(a), 0.0]), "horizon": 1.0}

    return path


@pytest.mark.parametrize(
    ("solver", "path"),
    [
        (lambda: Solver(PENDULUM, Gauss(3, Exponential(PLANE)), 20), swing_up),
        (lambda: Solver(SLEW, Gauss(3, Cayley(RIGID)), 12), slew),
    ],
    ids=["swing-up", "slew"],
)
@pytest.mark.slow
def test_a_hard_problem_is_reached_from_an_easy_one(solver, path):
    solver, seen = solver(), []
    found = continuation(solver, path, callback=lambda place, solution: seen.append((place, solution)))
    assert found.success
    assert found.places[0] == 0
    assert found.places[-1] == 1
    assert len(found.places) <= 40
    assert [place for place, _ in seen] == list(found.places)
    assert all(one is other for (_, one), other in zip(seen, found.solutions, strict=True))
    assert all(solution.success and solution.checks.strict_minimum for solution in found.solutions)
    again = solver.solve(**path(1.0), guess=found.solution)
    assert again.statistics.iterations <= 1
    assert again.cost == pytest.approx(found.solution.cost, rel=1e-11)


@pytest.mark.parametrize(("solver", "path", "at"), [
    (lambda: Solver(PENDULUM, Midpoint(Exponential(PLANE)), 20), swing_up, 0.1),
    pytest.param(lambda: Solver(SLEW, Gauss(2, Cayley(RIGID)), 5), everything, 0.3, marks=pytest.mark.slow),
], ids=["swing-up", "everything"])  # fmt: skip
def test_what_is_predicted_is_right_to_first_order(solver, path, at):
    """Nodes, costates and controls; the stages, interpolated, to what the steps leave."""
    solver = solver()
    solution, predictor = solver.solve(**path(at)), Predictor(solver)
    sizes, errors = np.array([0.02, 0.01, 0.005]), []
    for size in sizes:
        guess = predictor(solution, problem_at(path, at), problem_at(path, at + size))
        exact = solver.solve(**path(at + size), guess=guess).guess()
        pairs = zip(*(jax.tree.leaves((g.nodes, g.costates, g.controls)) for g in (guess, exact)), strict=True)
        errors.append(max(np.max(np.abs(a - b)) / np.max(np.abs(b)) for a, b in pairs))
    assert slope(sizes, np.array(errors), 1e-10) > 1.8


@pytest.fixture(scope="module")
def sphere():
    return Solver(TURNED, Midpoint(Projection(SPHERE)), 12)


@pytest.mark.parametrize("angle", [0.3, 2.0, 3.0, 3.1, 3.14, 3.1415, 3.1417, 3.15, 3.2, 4.0, 6.0])
@pytest.mark.usual(2)
def test_the_way_ends_at_a_conjugate_point(sphere, angle):
    """Great circles are shortest up to half a turn: behind it the extremals go on, and are no minima."""
    found = continuation(sphere, arc(angle), smallest_step=1e-5)
    reached = 1 + (angle - 1) * found.places[-1]
    assert found.success == (angle < np.pi)
    assert found.solution.checks.strict_minimum
    assert found.solution.cost == pytest.approx(reached**2 / 2, rel=0.02)
    if found.success:
        assert found.result == "The end of the path was reached."
    else:
        assert np.pi - 2e-5 * angle < reached < np.pi
        assert "not strict minima any more" in found.result


def test_it_stops_where_it_is_told_to_and_says_where(sphere):
    found = continuation(sphere, arc(3.0), callback=lambda place, solution: place > 0.05)
    assert not found.success
    assert found.places[-1] == pytest.approx(0.1)
    assert found.result == "The way was stopped at 0.1 of the path."
    assert "reached 0.1 of the path by 1 steps" in repr(found)


@pytest.mark.parametrize("steps", range(4))
def test_an_interrupt_ends_the_way_where_it_is(sphere, monkeypatch, steps):
    """Ctrl-C while the next step is predicted."""
    predict, whole, calls = Predictor.__call__, continuation(sphere, arc(3.0)), []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) > steps:
            raise KeyboardInterrupt
        return predict(*arguments)

    monkeypatch.setattr(Predictor, "__call__", interrupted)
    found = continuation(sphere, arc(3.0))
    assert not found.success
    np.testing.assert_array_equal(found.places, whole.places[: steps + 1])
    assert len(found.solutions) == steps + 1
    assert found.result == f"The way was stopped at {found.places[-1]:.6g} of the path."


def test_an_end_that_is_not_there_is_not_reached(sphere):
    """The path breaks in its middle: with any step the next extremal is far from the prediction."""

    def broken(place):
        return arc(2.0)(place) if place < 0.5 else arc(-2.0)(place)

    found = continuation(sphere, broken, smallest_step=1e-3)
    assert not found.success
    assert found.places[-1] < 0.5
    assert found.result.startswith("No step beyond 0.49")


@pytest.mark.parametrize(
    ("path", "words"),
    [
        (lambda place: (1, 2), r"the path returned \(1, 2\) at 0, expected a dictionary with start, end, horizon"),
        (lambda place: {"start": 0, "end": 1}, r"the path returned \['end', 'start'\] at 0"),
        (lambda place: {**arc(2.0)(place), "mass": 3}, r"\['end', 'horizon', 'mass', 'start'\]"),
        (lambda place: {**arc(2.0)(place), "horizon": -1.0}, "horizon must be a positive finite time"),
        (3, "continuation takes a Solver and a path"),
    ],
)
def test_a_path_is_a_function_that_returns_a_problem(sphere, path, words):
    with pytest.raises(InvalidInputError, match=words):
        continuation(sphere, path)
    for smallest in (0, 2, "small"):
        with pytest.raises(InvalidInputError, match="smallest_step must be a number in"):
            continuation(sphere, arc(2.0), smallest_step=smallest)


def test_its_beginning_must_be_solved():
    """No control moves the second coordinate."""
    stuck = OptimalControlProblem(PLANE, lambda q, u: jnp.stack([u[0], 0 * q[1]]), lambda q, u: u @ u / 2, controls=1)
    with pytest.raises(ConvergenceError):
        continuation(
            Solver(stuck, Midpoint(Exponential(PLANE)), 4),
            lambda place: {**swing_up(place), "end": np.array([np.pi, 1.0]), "parameters": None},
        )


def test_a_free_horizon_is_followed():
    """In the time T a motion by d costs ``T + 6 d^2 / T^3``, least where ``T^4 = 18 d^2``."""
    moved = OptimalControlProblem(PLANE, lambda q, u: jnp.stack([q[1], u[0]]), lambda q, u: 1 + u @ u / 2, controls=1)
    solver = Solver(moved, Gauss(2, Exponential(PLANE)), 4)

    def further(place):
        return {"start": REST[:2], "end": np.array([1 + 30 * place, 0.0]), "horizon": Free(2.0, lower=0.1)}

    found = continuation(solver, further)
    assert found.success
    for place, solution in zip(found.places, found.solutions, strict=True):
        assert solution.horizon == pytest.approx((18 * (1 + 30 * place) ** 2) ** 0.25, rel=1e-9)


def test_limits_that_begin_to_hold_are_passed():
    """A pendulum swings up within bounds, which hold it for ever longer: from where derivatives lead astray the last
    solution is the guess."""

    def swung(q, u, t, weight):
        return jnp.stack([q[1], u[0] - weight * jnp.sin(q[0]) + 0.1 * jnp.sin(t)])

    bounded = OptimalControlProblem(
        PLANE, swung, lambda q, u, t, weight: u @ u / 2, 1, control_bounds=(-1.5, 1.5), time_dependent=True
    )
    solver = Solver(bounded, Gauss(2, Exponential(PLANE)), 30)

    def heavier(place):
        return {"start": np.zeros(2), "end": np.array([2 + 1.1 * place, 0.0]), "horizon": 4.0, "parameters": 2 * place}

    found = continuation(solver, heavier)
    assert found.success, found.result
    assert found.solution.cost == pytest.approx(solver.solve(**heavier(1.0)).cost, rel=1e-8)
