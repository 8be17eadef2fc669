"""Searches of phases, and of coupled ends, by the core; closed forms and SciPy judge their costs."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute.binding.multiphase import CoupledEnds, Multiphase
from retrax.compute.binding.search import Search
from retrax.compute.binding.transcription import Transcription
from retrax.integrators import Free, OptimalControlProblem, Phase, Solver, solve, solve_phases
from retrax.integrators.boundary_value import regular_extremals
from retrax.integrators.boundary_value.transcription.core_transcription import coupled_ends, transcription_of
from retrax.integrators.boundary_value.transcription.discrete_phase import LinkedPhases
from retrax.integrators.boundary_value.transcription.member_search import MemberSearch, Watch
from retrax.manifolds import SO, Euclidean, InvalidInputError, Sphere, hat
from retrax.retractions import Addition, Cayley, Gauss, Midpoint, default_retraction
from scipy.optimize import minimize, minimize_scalar

from .test_problem_functions import called

FINE = 10_000  # steps of the midpoint rule: its effort is off by 1e-9
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


def least_effort(steps: int, duration: float, start: Any, end: Any) -> Any:
    """The least effort of a cart by the midpoint rule; Gauss methods have the effort of the continuous problem."""
    h = duration / steps
    places = duration * (1 - (np.arange(steps) + 0.5) / steps)
    moments = np.array([[duration, h * places.sum()], [h * places.sum(), h * places @ places]])
    asked = np.array([end[1] - start[1], end[0] - start[0] - duration * start[1]])
    return asked @ np.linalg.solve(moments, asked) / 2


def of_shared_horizon() -> float:
    """The least effort over what the links leave free."""

    def effort(z: np.ndarray) -> float:
        duration, speed, *middle = z
        first = least_effort(4, duration, (0.0, 1.0), (1.0, speed))
        second = least_effort(FINE, 1.3 - duration, (1.0, speed / 2), middle)
        return first + second + least_effort(FINE, 0.7, middle, (2.0, 0.0))

    found = minimize(effort, [0.6, 0.5, 1.5, 0.5], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-13})
    return float(minimize(effort, found.x, tol=1e-12).fun)


def of_limited() -> float:
    """The least effort of forces of both phases: six steps of the midpoint rule, then five of two stages."""
    root = np.sqrt(3) / 6
    inside = np.array([[0.25, 0.25 - root], [0.25 + root, 0.25]])

    def path(u: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        q, v, speeds = 0.0, 0.0, []
        for force in u[:6]:
            q, v = q + (v + force / 12) / 6, v + force / 6
        for pair in u[6:].reshape(5, 2):
            stages = v + inside @ pair / 5
            q, v = q + stages.mean() / 5, v + pair.mean() / 5
            speeds.append(stages)
        return np.array([q - 2, v]), speeds

    rules: Any = [
        {"type": "eq", "fun": lambda u: path(u)[0]},
        {"type": "ineq", "fun": lambda u: 1.2 - np.concatenate(path(u)[1])},
    ]
    bounds = [(None, None)] * 6 + [(-3, 3)] * 10
    found = minimize(
        lambda u: (u[:6] @ u[:6] / 6 + u[6:] @ u[6:] / 10) / 2, np.zeros(16), bounds=bounds, constraints=rules,
        method="SLSQP", options={"ftol": 1e-14, "maxiter": 500},
    )  # fmt: skip
    return float(found.fun)


CASES: dict[str, Callable[[], Any]] = {
    "bang-bang arcs of free durations": bang_bang,
    "three phases of one horizon": shared_horizon,
    "limits in one of two phases": limited,
    "a constraint between phases": between_phases,
    "an end linked to its start": turned_start,
    "an end on a set": on_a_set,
}


COSTS: dict[str, tuple[Callable[[], float], float]] = {  # and relative differences, by which trajectories are discrete
    "bang-bang arcs of free durations": (lambda: 2.0, 1e-9),
    "three phases of one horizon": (of_shared_horizon, 1e-7),
    "limits in one of two phases": (of_limited, 1e-6),
    "a constraint between phases": (
        lambda: minimize_scalar(lambda b: ((b * b - 1) ** 2 + (3 - b) ** 2) / 2, (0.0, 3.0), tol=1e-12).fun, 1e-9
    ),
    "an end linked to its start": (lambda: (np.pi / 2) ** 2 / 2 - 3, 1e-5),
    "an end on a set": (lambda: (np.pi / 6) ** 2 / 2, 1e-9),
}  # fmt: skip


def posed(case: str, monkeypatch: Any) -> tuple[LinkedPhases, Any]:
    """The phases of a problem, and its guess."""
    seen, search = [], regular_extremals.search_all

    def searched(*given: Any) -> Any:
        seen.append(given[:2])
        return search(*given)

    monkeypatch.setattr(regular_extremals, "search_all", searched)
    CASES[case]()
    monkeypatch.undo()
    return seen[-1]


def searched(problem: LinkedPhases, guess: Any, callback: Any = None) -> Any:
    """The result of a search from the guess."""
    return MemberSearch(problem, guess, 0, (1e-10, 100), Watch(callback)).from_guess()


@pytest.mark.parametrize("case", list(CASES))
@pytest.mark.usual(2)
def test_searches_end_at_the_minima_of_the_discrete_problems(case, monkeypatch):
    problem, guess = posed(case, monkeypatch)
    found, (cost, off) = searched(problem, guess), COSTS[case]
    assert found.facts.converged
    assert found.facts.strict
    assert found.cost == pytest.approx(cost(), rel=off)
    assert np.max(found.missing) < 1e-9
    assert np.max(found.residuals[:2]) < 1e-10
    ends = [own.nodes.reshape(-1, phase.at_nodes.layout.size)[[0, -1]] for own, phase in zip(
        found.phases, problem.phases, strict=True)]  # fmt: skip
    given = [phase.data.parameters for phase in problem.phases]
    linked = problem.coupling([end[None] for pair in ends for end in pair], given, found.multipliers[None])
    np.testing.assert_allclose(linked.values, 0.0, atol=1e-8)
    np.testing.assert_allclose(found.jacobian, linked.jacobian[0], rtol=1e-7, atol=1e-8)


def test_a_search_from_what_it_has_found_takes_no_time(monkeypatch):
    problem, guess = posed("three phases of one horizon", monkeypatch)
    member = MemberSearch(problem, guess, 0, (1e-10, 100), Watch(None))
    again = member.from_iterate(member.from_guess().iterate)
    assert again.facts.converged
    assert again.facts.iterations <= 1


@pytest.mark.parametrize("content", [np.nan, 1e300])
def test_the_memory_of_a_search_may_have_any_content(content, monkeypatch):
    problem, guess = posed("limits in one of two phases", monkeypatch)
    expected = searched(problem, guess)
    take = Transcription.search_room

    def filled(own, size):
        room = take(own, size)
        room[...] = content
        return room

    monkeypatch.setattr(Transcription, "search_room", filled)
    found = searched(problem, guess)
    assert found.facts.iterations == expected.facts.iterations
    assert found.cost == expected.cost


def test_a_callback_stops_a_search(monkeypatch):
    found = searched(*posed("three phases of one horizon", monkeypatch), lambda one: one.number == 2)
    assert found.facts.stopped
    assert not found.facts.converged
    assert found.facts.iterations == 2


UNTRACEABLE = {  # a constraint of the ends, and a cost of an end, that no tape computes
    "constraint": {"boundary_constraints": {"sine": lambda a, b: called(b[0]) - 0.5 + b[1]}},
    "cost": {"boundary_constraints": {"line": lambda a, b: b[0] - 1}, "terminal_cost": lambda q: called(q[1]) + q @ q},
}


@pytest.mark.parametrize("name", UNTRACEABLE)
@pytest.mark.usual(1)
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


def test_the_first_iterate_of_a_search_is_kept_with_the_multipliers_between_phases(monkeypatch):
    run, kept = Search.run, []

    def twice(search):
        run(search)
        known = search.multipliers().copy()
        status = run(search)
        kept.append((known, search.multipliers(first=True).copy()))
        return status

    monkeypatch.setattr(Search, "run", twice)
    assert limited().success
    known, first = kept[0]
    assert np.all(known != 0)
    np.testing.assert_array_equal(first, known)
