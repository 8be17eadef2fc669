"""A solution between its nodes: orders of the polynomials, continuity, other meshes and methods, records from files."""

import pickle
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Solution, Solver, load_solution, solve
from retrax.manifolds import DomainError, Euclidean, InvalidInputError, Sphere, hat
from retrax.retractions import Cayley, Exponential, Gauss, Midpoint, Projection, Theta, default_retraction

from tests.support.cases import Ellipsoid
from tests.support.numerics import slope

from .problems import INERTIA, REST, RIGID, rotation

SPHERE, ELLIPSOID = Sphere(2), Ellipsoid()
HORIZON = 1.3
TIMES = np.linspace(0.0, HORIZON, 201)
PARTS = "states", "costates", "controls"


def body(q, u):
    """Rigid body with three torques."""
    return q[0] @ hat(q[1]), (u - jnp.cross(q[1], INERTIA * q[1])) / INERTIA


def turned(q, u):
    """A point, turned by controls and by a wind."""
    return jnp.cross(u + jnp.array([0, 0.1, 0.4]), q)


class Subject(NamedTuple):
    """A problem with a retraction and ends."""

    problem: OptimalControlProblem
    retraction: Any
    start: Any
    end: Any


SUBJECTS = {
    "SO(3) x R^3": Subject(
        OptimalControlProblem(RIGID, body, lambda q, u: u @ u / 2, 3),
        Cayley(RIGID),
        (np.eye(3), REST),
        (rotation([0.8, 0.6, -1.2]), REST),
    ),
    "S^2, controls on S^2": Subject(
        OptimalControlProblem(SPHERE, lambda q, u: turned(q, 1.3 * u), lambda q, u: 1 + q[2] ** 2 + u[0] / 3, SPHERE),
        Projection(SPHERE),
        np.array([1.0, 0, 0]),
        np.array([0.0, 0.8, 0.6]),
    ),
    "S^2": Subject(
        OptimalControlProblem(SPHERE, turned, lambda q, u: u @ u / 2 + 0.3 * u[0] ** 2 + 0.3 * q[2] ** 2, 3),
        Projection(SPHERE),
        np.array([1.0, 0, 0]),
        np.array([-0.6, 0, 0.8]),
    ),
}
# Of states and costates, and of controls.
METHODS = {
    "theta": (lambda r: Theta(r, 0.3), (20, 40), (1, 1)),
    "midpoint": (Midpoint, (16, 32), (2, 1)),
    "2 stages": (lambda r: Gauss(2, r), (8, 14), (3, 2)),
    "3 stages": (lambda r: Gauss(3, r), (6, 10), (4, 3)),
    "4 stages": (lambda r: Gauss(4, r), (5, 8), (5, 4)),
}


def often(*cases):
    """All pairs of a problem and a method, of which only these are tested each time."""
    pairs = [(name, method) for name in SUBJECTS for method in METHODS]
    return [pair if pair in cases else pytest.param(*pair, marks=pytest.mark.slow) for pair in pairs]


def entries(tree) -> np.ndarray:
    """All arrays of nested tuples, with their leading axis."""
    return np.concatenate([np.reshape(leaf, (len(leaf), -1)) for leaf in jax.tree.leaves(tree)], axis=1)


def found(subject: Subject, method, steps, **options) -> Solution:
    return Solver(subject.problem, method, steps).solve(subject.start, subject.end, HORIZON, **options)


@pytest.fixture(scope="module")
def fine():
    """Of a problem a solution whose polynomials are far more exact than those that are measured."""
    return cache(lambda name: found(SUBJECTS[name], Gauss(6, SUBJECTS[name].retraction), 12)(TIMES))


@pytest.mark.parametrize(
    ("name", "method"), often(("S^2", "midpoint"), ("S^2", "3 stages"), ("SO(3) x R^3", "2 stages"))
)
@pytest.mark.usual("S^2-3 stages", "S^2-midpoint")
def test_orders_between_the_nodes(fine, name, method):
    make, steps, (order, of_controls) = METHODS[method]
    exact = fine(name)
    solutions = [found(SUBJECTS[name], make(SUBJECTS[name].retraction), n)(TIMES) for n in steps]
    for part in PARTS:
        errors = [np.max(np.abs(entries(getattr(s, part)) - entries(getattr(exact, part)))) for s in solutions]
        expected = of_controls if part == "controls" else order
        assert slope(1 / np.array(steps), np.array(errors), 1e-12) > expected - 0.35, part


@pytest.mark.parametrize(("name", "method"), often(("S^2, controls on S^2", "3 stages"), ("SO(3) x R^3", "theta")))
@pytest.mark.usual("S^2, controls on S^2-3 stages")
def test_states_and_costates_meet_at_the_nodes_and_all_is_that_of_the_stages(name, method):
    """To rounding from both sides, also in steps of very unequal lengths; states are on the manifold everywhere."""
    subject = SUBJECTS[name]
    made = METHODS[method][0](subject.retraction)
    solution = found(subject, made, [1, 3, 0.01, 2, 5], guess=found(subject, made, 5))
    at_nodes, before = solution(solution.times), solution(np.nextafter(solution.times[1:], 0.0))
    for part in ("states", "costates"):
        own, limit = entries(getattr(solution, part)), 1e-13 * (1 + np.max(np.abs(entries(getattr(solution, part)))))
        np.testing.assert_allclose(entries(getattr(at_nodes, part)), own, rtol=0, atol=limit)
        np.testing.assert_allclose(entries(getattr(before, part)), own[1:], rtol=0, atol=limit)
    at_stages = solution(solution.stage_times)
    np.testing.assert_allclose(entries(at_stages.states), entries(solution.stage_states), rtol=0, atol=1e-13)
    np.testing.assert_allclose(entries(at_stages.controls), entries(solution.controls), rtol=0, atol=1e-12)
    for value in jax.vmap(subject.problem.manifold.violations)(solution(TIMES).states).values():
        assert np.max(value) < 1e-14


def test_a_time_is_a_number_or_an_array_within_the_horizon():
    subject = SUBJECTS["SO(3) x R^3"]
    solution = found(subject, Midpoint(subject.retraction), 7)
    one, table = solution(0.4), solution(np.array([[0.4, 0.5, 0.6], [0.0, HORIZON, 1]]))
    assert (one.states[0].shape, one.controls.shape, one.times.shape) == ((3, 3), (3,), ())
    assert (table.states[0].shape, table.costates[1].shape) == ((2, 3, 3, 3), (2, 3, 3))
    np.testing.assert_array_equal(table.states[0][0, 0], one.states[0])
    np.testing.assert_allclose(table.states[0][1, 1], subject.end[0], atol=1e-13)
    for wrong in (-1e-6, HORIZON + 1e-6, [0.1, 9.0]):
        with pytest.raises(InvalidInputError, match=r"outside the horizon of the solution, expected one in \[0, 1.3\]"):
            solution(wrong)
    for wrong in (np.nan, "noon", None, 1j):
        with pytest.raises(InvalidInputError, match="the time must be a finite real number, or an array of them"):
            solution(wrong)


def test_a_step_that_leaves_its_chart_says_so():
    """The sphere's projection covers half of it: a step of a solution that jumps further has no polynomial there."""
    subject = SUBJECTS["S^2"]
    solution = found(subject, Gauss(2, subject.retraction), 4)
    jumps = np.array(solution.states)
    jumps[2] = -jumps[1]
    changed = replace(solution, states=jumps)
    assert np.all(np.isfinite(changed(0.1).states))
    with pytest.raises(DomainError, match=r"the step of the solution at t = 0\.5 does not fit into one chart"):
        changed(0.5)


@pytest.mark.parametrize("name", ["S^2, controls on S^2", pytest.param("SO(3) x R^3", marks=pytest.mark.slow)])
def test_its_own_solution_is_a_guess_that_is_right_at_once(name):
    """And so are records from a file, what another process had, and the guess made of it; for each kind of method."""
    subject = SUBJECTS[name]
    for method, steps in ((Midpoint(subject.retraction), 6), (Gauss(3, subject.retraction), [2, 1, 1, 3])):
        solver = Solver(subject.problem, method, steps)
        first = solver.solve(subject.start, subject.end, HORIZON)
        again = solver.solve_many(
            subject.start, subject.end, [HORIZON] * 3, [first, pickle.loads(pickle.dumps(first)), first.guess()]
        )
        assert all(one.statistics.iterations <= 1 and one.success for one in again)
        np.testing.assert_allclose(again.cost, first.cost, rtol=1e-13)


def test_a_solution_on_another_mesh_or_by_another_method_is_a_guess():
    """It takes fewer iterations than none, from any of them to any, to the same solution; in another horizon too."""
    subject = SUBJECTS["S^2"]
    r = subject.retraction
    ways = [(Theta(r, 0.2), 16), (Midpoint(r), 10), (Gauss(3, Exponential(SPHERE)), [1, 2, 1, 1, 2]), (Gauss(4, r), 3)]
    solvers = [Solver(subject.problem, *way) for way in ways]
    cold = [solver.solve(subject.start, subject.end, HORIZON) for solver in solvers]
    for solver, own in zip(solvers, cold, strict=True):
        for other in cold:
            warm = solver.solve(subject.start, subject.end, HORIZON, other)
            assert warm.statistics.iterations < own.statistics.iterations
            assert warm.cost == pytest.approx(own.cost, rel=1e-12)
        longer = solver.solve(subject.start, subject.end, 1.1 * HORIZON, cold[0])
        assert longer.success
        assert longer.times[-1] == pytest.approx(1.1 * HORIZON)


def test_a_solution_on_another_manifold_is_no_guess():
    point, plane = SUBJECTS["S^2"], Euclidean(2)
    solution = found(point, Midpoint(point.retraction), 4)
    flat = OptimalControlProblem(plane, lambda q, u: u, lambda q, u: u @ u / 2, 2)
    with pytest.raises(InvalidInputError, match=r"guess: states have the shapes \(3,\) each, expected \(2,\)"):
        solve(flat, np.zeros(2), np.ones(2), 1.0, method=Midpoint(Exponential(plane)), steps=4, guess=solution)
    guess = solution.guess()
    for wrong, words in (
        (guess._replace(nodes=None), "come together"),
        (guess._replace(nodes=guess.states), "guess: nodes must"),
    ):
        with pytest.raises(InvalidInputError, match=words):
            found(point, Midpoint(point.retraction), 4, guess=wrong)


@pytest.mark.parametrize("name", ["S^2, controls on S^2", pytest.param("SO(3) x R^3", marks=pytest.mark.slow)])
def test_a_record_from_a_file_knows_itself_between_the_nodes(name, tmp_path):
    subject = SUBJECTS[name]
    solution = found(subject, Gauss(2, subject.retraction), 5)
    solution.save(tmp_path / "solution.npz")
    loaded = load_solution(tmp_path / "solution.npz")
    for part in PARTS:
        np.testing.assert_array_equal(entries(getattr(loaded(TIMES), part)), entries(getattr(solution(TIMES), part)))


@pytest.mark.slow
def test_a_record_on_a_manifold_of_ones_own_is_told_its_retraction(tmp_path):
    """A file has names of classes of the library and numbers only; such a record is a guess all the same."""
    space = ELLIPSOID * Euclidean(3)
    drifting = OptimalControlProblem(
        space, lambda q, u: (ELLIPSOID.projection(q[0], q[1]), u - q[1] / 3), lambda q, u: u @ u / 2 + q[0][0], 3
    )
    start = np.array([1.0, 0, 0]), np.zeros(3)
    end = np.array([0.6, 0.4, 0.2]) / np.sqrt(0.36 + 2 * 0.16 + 3 * 0.04), None
    retraction = default_retraction(space)
    solution = solve(drifting, start, end, 1.0, method=Midpoint(retraction), steps=6)
    solution.save(tmp_path / "own.npz")
    loaded = load_solution(tmp_path / "own.npz")
    with pytest.raises(
        InvalidInputError, match=r"says nothing of its retraction.*try load_solution\(path, retraction, controls\)"
    ):
        loaded(0.5)
    told = load_solution(tmp_path / "own.npz", retraction)
    np.testing.assert_array_equal(entries(told(TIMES / 2).states), entries(solution(TIMES / 2).states))
    assert (
        solve(drifting, start, end, 1.0, method=Midpoint(retraction), steps=9, guess=loaded).statistics.iterations <= 3
    )
    for wrong, words in ((Cayley(RIGID), "states have the shapes"), ("Cayley", "with a retraction and the manifold")):
        with pytest.raises(InvalidInputError, match=words):
            load_solution(tmp_path / "own.npz", wrong)
