"""Searches of phases, and of coupled ends, by the core beside those of the engine."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute.binding.multiphase import CoupledEnds, Multiphase
from retrax.compute.binding.transcription import Transcription
from retrax.integrators import Free, OptimalControlProblem, Phase, solve, solve_phases
from retrax.integrators.boundary_value.engine import core_phases
from retrax.integrators.boundary_value.engine.conditions import Conditions
from retrax.integrators.boundary_value.engine.core_phases import CorePhases
from retrax.integrators.boundary_value.engine.descent import Descent
from retrax.integrators.boundary_value.engine.joint import JointConditions
from retrax.manifolds import SO, Euclidean, InvalidInputError, Sphere, hat
from retrax.retractions import Addition, Cayley, Gauss, Midpoint, default_retraction

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


def fresh(joint: JointConditions) -> JointConditions:
    """The conditions before a search."""
    phases = tuple(Conditions(own.transcription, own.at_nodes, own.ends, own.data) for own in joint.phases)
    return JointConditions(phases, joint.coupling)


def posed(case: str, monkeypatch: Any) -> tuple[JointConditions, Any]:
    """The conditions of a problem, and its guess."""
    seen = []
    for search in (Descent, CorePhases):
        ended = search.ended

        def watched(self: Any, guess: Any, ended: Any = ended) -> Any:
            seen.append((fresh(self.conditions), guess))
            return ended(self, guess)

        monkeypatch.setattr(search, "ended", watched)
    CASES[case]()
    monkeypatch.undo()
    return seen[0]


def watched(search: Any, joint: JointConditions, guess: Any) -> tuple[Any, JointConditions, np.ndarray]:
    """What a search finds, its conditions, and what it tells of its iterations.

    But for the stationarity: where points have defects, the engine measures the slope by which these are mended.
    """
    told, joint = [], fresh(joint)

    def see(one: Any) -> None:
        told.append([one.cost[0], one.defect[0], one.shift[0], one.fraction[0], one.barrier[0]])

    with np.errstate(all="ignore"):
        return search(joint, 1e-10, 100, see).ended(guess), joint, np.array(told)


@pytest.mark.parametrize("case", list(CASES))
def test_searches_go_and_end_where_those_of_the_engine_do(case, monkeypatch):
    joint, guess = posed(case, monkeypatch)
    assert core_phases.is_on_core(joint)
    expected, of_engine, way = watched(Descent, joint, guess)
    found, of_core, own_way = watched(CorePhases, joint, guess)
    assert found.claimed.all()
    assert expected.claimed.all()
    assert found.strict_minimum == expected.strict_minimum
    assert found.iterations == expected.iterations
    np.testing.assert_allclose(own_way, way, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found.iterate.multipliers, expected.iterate.multipliers, rtol=1e-7, atol=1e-9)
    for part, like in zip(found.iterate.parts, expected.iterate.parts, strict=True):
        for array, own in zip((part.costates, *part.unknowns), (like.costates, *like.unknowns), strict=True):
            np.testing.assert_allclose(array, own, rtol=1e-7, atol=1e-8)
        if like.slacks is not None:
            for array, own in zip(part.slacks, like.slacks, strict=True):
                np.testing.assert_allclose(array, own, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(of_core.units.nodes, of_engine.units.nodes, rtol=1e-7)
    for phase, like in zip(of_core.phases, of_engine.phases, strict=True):
        for array, own in zip(phase.units, like.units, strict=True):
            np.testing.assert_allclose(array, own, rtol=1e-7)


def test_a_search_from_what_it_has_found_takes_no_time(monkeypatch):
    joint, guess = posed("three phases of one horizon", monkeypatch)
    found, *_ = watched(CorePhases, joint, guess)
    again, *_ = watched(CorePhases, joint, found.iterate)
    assert again.claimed.all()
    assert again.iterations <= 1


@pytest.mark.parametrize("content", [np.nan, 1e300])
def test_the_memory_of_a_search_may_have_any_content(content, monkeypatch):
    joint, guess = posed("limits in one of two phases", monkeypatch)
    expected = CorePhases(fresh(joint), 1e-10, 100, None).ended(guess)
    take = Transcription.search_room

    def filled(own, size):
        room = take(own, size)
        room[...] = content
        return room

    monkeypatch.setattr(Transcription, "search_room", filled)
    found = CorePhases(fresh(joint), 1e-10, 100, None).ended(guess)
    assert found.iterations == expected.iterations
    np.testing.assert_array_equal(found.assembled.cost, expected.assembled.cost)


def test_a_callback_stops_a_search(monkeypatch):
    joint, guess = posed("three phases of one horizon", monkeypatch)
    found = CorePhases(fresh(joint), 1e-10, 100, lambda one: one.number == 2).ended(guess)
    assert found.stopped
    assert not found.claimed.any()
    assert found.iterations == 2


def test_what_does_not_fit_is_refused(monkeypatch):
    joint, _ = posed("an end on a set", monkeypatch)
    ends = core_phases._coupled_ends(joint.coupling)
    phases = [core_phases._transcription_of(phase) for phase in joint.phases]
    with pytest.raises(InvalidInputError, match="ends of 2 phases"):
        Multiphase(phases * 2, ends)
    with pytest.raises(InvalidInputError, match="expected"):
        Multiphase(phases, CoupledEnds(ends.program, ends.equations + 1, ends.links))
