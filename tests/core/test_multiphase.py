"""Searches of phases, and of coupled ends, by the core beside those of the engine."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute.binding.multiphase import CoupledEnds, Multiphase
from retrax.compute.binding.transcription import Transcription
from retrax.integrators import Free, OptimalControlProblem, Phase, Solver, solve, solve_phases
from retrax.integrators.boundary_value import regular_extremals
from retrax.integrators.boundary_value.engine.conditions import Conditions
from retrax.integrators.boundary_value.engine.descent import Descent
from retrax.integrators.boundary_value.engine.joint import JointConditions
from retrax.integrators.boundary_value.engine.joint_system import JointIterate
from retrax.integrators.boundary_value.reformulations import restarts
from retrax.integrators.boundary_value.transcription.core_search import coupled_ends, iterate_of, transcription_of
from retrax.integrators.boundary_value.transcription.member_search import MemberSearch, MultiphaseProblem, Watch
from retrax.manifolds import SO, Euclidean, InvalidInputError, Sphere, hat
from retrax.retractions import Addition, Cayley, Gauss, Midpoint, default_retraction

from .test_problem_functions import called

LINE, PLANE, TURN, GLOBE = Euclidean(1), Euclidean(2), SO(3), Sphere(2)
AXIS = np.array([0.0, 0.6, 0.8])


def cart(q, u):
    return jnp.stack([q[1], u[0]])


def effort(q, u):
    return u @ u / 2


CART = OptimalControlProblem(PLANE, cart, effort, 1)


def bang_bang() -> Any:
    forced = OptimalControlProblem(
        PLANE, lambda q, u, force: jnp.stack([q[1], force + 0 * q[0]]), lambda q, u, force: 1.0, 0
    )
    method, end = Gauss(2, Addition(PLANE)), np.array([1.0, 0.0])
    first = Phase(forced, method, 2, Free(0.3), start=np.zeros(2), parameters=1.0)
    return solve_phases([first, Phase(forced, method, 2, Free(4.0), end=end, parameters=-1.0)])


def shared_horizon() -> Any:
    """Three phases of other methods and meshes, whose durations have a sum; a gate halves the speed."""
    start, end = np.array([0.0, 1.0]), np.array([2.0, 0.0])
    gate = {"gate": lambda ends: ends[0].end[0] - 1}
    first = Phase(CART, Midpoint(Addition(PLANE)), 4, Free(0.6), start=start)
    second = Phase(CART, Gauss(2, Addition(PLANE)), 3, Free(0.7))
    third = Phase(CART, Gauss(3, Addition(PLANE)), 2, 0.7, end=end)
    return solve_phases(
        [first, second, third], links=[lambda q: q * np.array([1.0, 0.5]), True], horizon=2.0, boundary_constraints=gate
    )


def limited() -> Any:
    """A speed limit and bounds of the force in one of two phases."""
    bounded = OptimalControlProblem(
        PLANE, cart, effort, 1, control_bounds=(-3, 3), constraints={"fast": lambda q, u: q[1] - 1.2}
    )
    first = Phase(CART, Midpoint(Addition(PLANE)), 6, 1.0, start=np.zeros(2))
    return solve_phases([first, Phase(bounded, Gauss(2, Addition(PLANE)), 5, 1.0, end=np.array([2.0, 0.0]))])


def between_phases() -> Any:
    """A constraint between the ends of two phases that nothing else links."""
    along = OptimalControlProblem(LINE, lambda q, u: u, effort, 1)
    first, second = (
        Phase(along, Midpoint(Addition(LINE)), 3, 1.0, *ends)
        for ends in ((np.zeros(1),), (Free(np.ones(1)), np.full(1, 3.0)))
    )
    law = {"twice": lambda ends: ends[1].start ** 2 - ends[0].end - 1}
    return solve_phases([first, second], links=[False], boundary_constraints=law)


def turned_start() -> Any:
    """Attitudes whose end is the start turned by a fixed angle: a link of a phase, and a cost of the end."""
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    problem = OptimalControlProblem(
        TURN,
        lambda q, u: q @ hat(u),
        effort,
        3,
        terminal_cost=lambda q: -jnp.trace(q @ turn.T),
        periodic=lambda q: turn @ q,
    )
    aside = np.eye(3) + hat(0.2 * AXIS)
    aside = np.linalg.qr(aside)[0] * np.sign(np.diag(np.linalg.qr(aside)[1]))
    return solve(problem, Free(aside), Free(turn @ aside), 1.0, method=Gauss(2, Cayley(TURN)), steps=6)


def on_a_set() -> Any:
    """From a point of the sphere to a circle on it."""
    problem = OptimalControlProblem(
        GLOBE, lambda q, u: jnp.cross(u, q), effort, 3, boundary_constraints={"circle": lambda a, b: b[2] - 0.5}
    )
    method = Midpoint(default_retraction(GLOBE))
    start, end = np.array([1.0, 0, 0]), np.array([0.0, 0.8, 0.6])
    return solve(problem, start, Free(end), 1.0, method=method, steps=5)


CASES: dict[str, Callable[[], Any]] = {
    "bang-bang arcs of free durations": bang_bang,
    "three phases of one horizon": shared_horizon,
    "limits in one of two phases": limited,
    "a constraint between phases": between_phases,
    "an end linked to its start": turned_start,
    "an end on a set": on_a_set,
}


Posed = tuple[MultiphaseProblem, Any]


def posed(case: str, monkeypatch: Any) -> Posed:
    """The conditions of a problem, and its guess."""
    seen, search = [], restarts.search_all

    def searched(*given: Any) -> Any:
        seen.append(given[:2])
        return search(*given)

    monkeypatch.setattr(regular_extremals, "search_all", searched)
    CASES[case]()
    monkeypatch.undo()
    return seen[0]


def told_to(told: list[Any]) -> Callable[[Any], Any]:
    """A callback that keeps what a search tells of its iterations.

    But for the stationarity: where points have defects, the engine measures the slope by which these are mended.
    """
    return lambda one: told.append([one.cost[0], one.defect[0], one.shift[0], one.fraction[0], one.barrier[0]])


def by_engine(problem: MultiphaseProblem, guess: Any) -> tuple[Any, JointConditions, np.ndarray]:
    """The result of a search of the engine, its conditions, and its iterations."""
    phases = tuple(Conditions(own.transcription, own.at_nodes, own.ends, own.data) for own in problem.phases)
    joint, told = JointConditions(phases, problem.coupling), []
    with np.errstate(all="ignore"):
        return Descent(joint, 1e-10, 100, told_to(told)).ended(JointIterate(*guess)), joint, np.array(told)


def by_core(problem: MultiphaseProblem, guess: Any, callback: Any = None) -> Any:
    """The result of a search of the core."""
    return MemberSearch(problem, guess, 0, (1e-10, 100), Watch(callback)).from_guess()


@pytest.mark.parametrize("case", list(CASES))
def test_searches_go_and_end_where_those_of_the_engine_do(case, monkeypatch):
    problem, guess = posed(case, monkeypatch)
    expected, of_engine, way = by_engine(problem, guess)
    own_way = list[Any]()
    found = by_core(problem, guess, told_to(own_way))
    assert found.claimed
    assert expected.claimed.all()
    assert found.strict == expected.strict_minimum[0]
    assert found.iterations == expected.iterations
    np.testing.assert_allclose(np.array(own_way), way, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found.multipliers, expected.iterate.multipliers[0], rtol=1e-7, atol=1e-9)
    for own, phase, like in zip(found.phases, problem.phases, expected.iterate.parts, strict=True):
        part = iterate_of(own.iterate, like, phase.transcription)
        for array, other in zip((part.costates, *part.unknowns), (like.costates, *like.unknowns), strict=True):
            np.testing.assert_allclose(array, other, rtol=1e-7, atol=1e-8)
        if like.slacks is not None:
            for array, other in zip(part.slacks, like.slacks, strict=True):
                np.testing.assert_allclose(array, other, rtol=1e-5, atol=1e-9)
    lacking, residuals = expected.missing[0], expected.residuals
    np.testing.assert_allclose(found.missing, lacking, rtol=1e-3, atol=1e-12)
    np.testing.assert_allclose(found.residuals[:2], [residuals.gap[0], residuals.stationarity[0]], atol=1e-11)
    np.testing.assert_allclose(found.jacobian, expected.assembled.coupled.jacobian[0], rtol=1e-7, atol=1e-8)
    for own, like in zip(found.phases, of_engine.phases, strict=True):
        for array, other in zip(own.judging, like.units, strict=True):
            np.testing.assert_allclose(array, np.ravel(other), rtol=1e-7)


def test_a_search_from_what_it_has_found_takes_no_time(monkeypatch):
    problem, guess = posed("three phases of one horizon", monkeypatch)
    member = MemberSearch(problem, guess, 0, (1e-10, 100), Watch(None))
    again = member.from_iterate(member.from_guess().iterate)
    assert again.claimed
    assert again.iterations <= 1


@pytest.mark.parametrize("content", [np.nan, 1e300])
def test_the_memory_of_a_search_may_have_any_content(content, monkeypatch):
    problem, guess = posed("limits in one of two phases", monkeypatch)
    expected = by_core(problem, guess)
    take = Transcription.search_room

    def filled(own, size):
        room = take(own, size)
        room[...] = content
        return room

    monkeypatch.setattr(Transcription, "search_room", filled)
    found = by_core(problem, guess)
    assert found.iterations == expected.iterations
    assert found.cost == expected.cost


def test_a_callback_stops_a_search(monkeypatch):
    found = by_core(*posed("three phases of one horizon", monkeypatch), lambda one: one.number == 2)
    assert found.stopped
    assert not found.claimed
    assert found.iterations == 2


UNTRACEABLE = {  # a constraint of the ends, and a cost of an end, that no tape computes
    "constraint": {"boundary_constraints": {"sine": lambda a, b: called(b[0]) - 0.5 + b[1]}},
    "cost": {"boundary_constraints": {"line": lambda a, b: b[0] - 1}, "terminal_cost": lambda q: called(q[1]) + q @ q},
}


@pytest.mark.parametrize("name", UNTRACEABLE)
def test_ends_without_a_tape_are_called_back(name):
    """The same iterations, costs and multipliers as where a tape computes them."""
    options = UNTRACEABLE[name]
    found = []
    for sine in (called, jnp.sin):
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(globals(), "called", sine)
            problem = OptimalControlProblem(PLANE, cart, effort, 1, **options)
            solver = Solver(problem, Gauss(2, Addition(PLANE)), 5)
            found.append(solver.solve(np.zeros(2), Free(np.array([1.0, 0.2])), 1.0, tolerance=1e-10))
        assert solver.evaluator == ("xla" if sine is called else "tape"), solver.reason
    one, other = found
    assert one.statistics.iterations == other.statistics.iterations
    assert one.cost == pytest.approx(other.cost, rel=1e-12)
    assert one.checks.strict_minimum == other.checks.strict_minimum
    for constraint, multipliers in other.multipliers.items():
        np.testing.assert_allclose(one.multipliers[constraint], multipliers, rtol=1e-9)


def test_what_does_not_fit_is_refused(monkeypatch):
    problem, _ = posed("an end on a set", monkeypatch)
    ends, phases = coupled_ends(problem.coupling), list(map(transcription_of, problem.phases))
    with pytest.raises(InvalidInputError, match="ends of 2 phases"):
        Multiphase(phases * 2, ends)
    with pytest.raises(InvalidInputError, match="expected"):
        Multiphase(phases, CoupledEnds(ends.program, ends.equations + 1, ends.links))
