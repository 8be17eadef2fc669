"""Searches of phases, and of coupled ends, against closed forms and SciPy."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute.binding.multiphase import CoupledEnds, Multiphase
from retrax.compute.binding.tape_machine import MachineProgram
from retrax.compute.binding.transcription import Transcription
from retrax.integrators import Free, OptimalControlProblem, Phase, solve, solve_phases
from retrax.integrators.boundary_value.transcription import core_search
from retrax.integrators.boundary_value.transcription.discrete_phase import LinkedPhases
from retrax.manifolds import SO, Euclidean, InvalidInputError, Sphere, hat
from retrax.retractions import Addition, Cayley, Gauss, Midpoint, default_retraction
from scipy.optimize import minimize, minimize_scalar

LINE, PLANE, TURN, GLOBE = Euclidean(1), Euclidean(2), SO(3), Sphere(2)
AXIS = np.array([0.0, 0.6, 0.8])


def cart(q, u):
    return jnp.stack([q[1], u[0]])


def effort(q, u):
    return u @ u / 2


CART = OptimalControlProblem(PLANE, cart, effort, 1)


def bang_bang(**options: Any) -> Any:
    forced = OptimalControlProblem(
        PLANE, lambda q, u, force: jnp.stack([q[1], force + 0 * q[0]]), lambda q, u, force: 1.0, 0
    )
    method, end = Gauss(2, Addition(PLANE)), np.array([1.0, 0.0])
    first = Phase(forced, method, 2, Free(0.3), start=np.zeros(2), parameters=1.0)
    return solve_phases([first, Phase(forced, method, 2, Free(4.0), end=end, parameters=-1.0)], **options)


def shared_horizon(**options: Any) -> Any:
    """Three phases of other methods and meshes, whose durations have a sum; a gate halves the speed."""
    start, end = np.array([0.0, 1.0]), np.array([2.0, 0.0])
    gate = {"gate": lambda ends: ends[0].end[0] - 1}
    first = Phase(CART, Midpoint(Addition(PLANE)), 4, Free(0.6), start=start)
    second = Phase(CART, Gauss(2, Addition(PLANE)), 3, Free(0.7))
    third = Phase(CART, Gauss(3, Addition(PLANE)), 2, 0.7, end=end)
    links = [lambda q: q * np.array([1.0, 0.5]), True]
    return solve_phases([first, second, third], links=links, horizon=2.0, boundary_constraints=gate, **options)


def limited(**options: Any) -> Any:
    """A speed limit and bounds of the force in one of two phases."""
    bounded = OptimalControlProblem(
        PLANE, cart, effort, 1, control_bounds=(-3, 3), constraints={"fast": lambda q, u: q[1] - 1.2}
    )
    first = Phase(CART, Midpoint(Addition(PLANE)), 6, 1.0, start=np.zeros(2))
    last = Phase(bounded, Gauss(2, Addition(PLANE)), 5, 1.0, end=np.array([2.0, 0.0]))
    return solve_phases([first, last], **options)


def between_phases(**options: Any) -> Any:
    """A constraint between the ends of two phases that nothing else links."""
    along = OptimalControlProblem(LINE, lambda q, u: u, effort, 1)
    first, second = (
        Phase(along, Midpoint(Addition(LINE)), 3, 1.0, *ends)
        for ends in ((np.zeros(1),), (Free(np.ones(1)), np.full(1, 3.0)))
    )
    law = {"twice": lambda ends: ends[1].start ** 2 - ends[0].end - 1}
    return solve_phases([first, second], links=[False], boundary_constraints=law, **options)


def turned_start(**options: Any) -> Any:
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
    return solve(problem, Free(aside), Free(turn @ aside), 1.0, method=Gauss(2, Cayley(TURN)), steps=6, **options)


def on_a_set(**options: Any) -> Any:
    """From a point of the sphere to a circle on it."""
    problem = OptimalControlProblem(
        GLOBE, lambda q, u: jnp.cross(u, q), effort, 3, boundary_constraints={"circle": lambda a, b: b[2] - 0.5}
    )
    method = Midpoint(default_retraction(GLOBE))
    start, end = np.array([1.0, 0, 0]), np.array([0.0, 0.8, 0.6])
    return solve(problem, start, Free(end), 1.0, method=method, steps=5, **options)


CASES: dict[str, Callable[[], Any]] = {
    "bang-bang arcs of free durations": bang_bang,
    "three phases of one horizon": shared_horizon,
    "limits in one of two phases": limited,
    "a constraint between phases": between_phases,
    "an end linked to its start": turned_start,
    "an end on a set": on_a_set,
}


class Cart:
    """Steps of a cart by a Runge-Kutta method, whose positions and speeds are linear in the forces."""

    def __init__(self, stages: int, steps: int) -> None:
        self.method, self.steps = Gauss(stages, Addition(LINE)), steps
        self.size = stages * steps

    def run(self, q: np.ndarray, u: np.ndarray, duration: float) -> tuple[np.ndarray, float, np.ndarray]:
        """The end of a phase, its cost, and the speeds at the points."""
        a, b, h = self.method.matrix, self.method.weights, duration / self.steps
        cost, speeds = 0.0, []
        for force in u.reshape(self.steps, -1):
            speed = q[1] + h * a @ force
            q, cost = q + h * np.array([b @ speed, b @ force]), cost + h * b @ force**2 / 2
            speeds.append(speed)
        return q, cost, np.concatenate(speeds)


def least(carts: list[Cart], phases: Callable[[np.ndarray], tuple[float, Any, Any]], guess: Any, bounds: Any) -> float:
    """The least cost of phases by SciPy; ``phases``: cost, equations and inequalities ``>= 0``."""
    constraints = [{"type": kind, "fun": lambda z, k=k: phases(z)[k]} for k, kind in ((1, "eq"), (2, "ineq"))]
    options = {"ftol": 1e-13, "maxiter": 500}
    found = minimize(lambda z: phases(z)[0], guess, constraints=constraints, bounds=bounds, options=options)
    assert found.success, found.message
    return found.fun


def least_of_shared_horizon() -> float:
    carts = [Cart(1, 4), Cart(2, 3), Cart(3, 2)]
    cuts = np.cumsum([own.size for own in carts])

    def phases(z: np.ndarray) -> tuple[float, Any, Any]:
        first, second, third, durations = np.split(z, cuts)
        q, one, _ = carts[0].run(np.array([0.0, 1.0]), first, durations[0])
        gate = q[0] - 1
        q, two, _ = carts[1].run(q * np.array([1.0, 0.5]), second, durations[1])
        q, three, _ = carts[2].run(q, third, 0.7)
        return one + two + three, np.array([gate, *(q - [2.0, 0.0]), durations.sum() - 1.3]), np.zeros(1)

    guess = np.concatenate([np.zeros(cuts[-1]), [0.6, 0.7]])
    return least(carts, phases, guess, [(None, None)] * cuts[-1] + [(0.05, 1.25)] * 2)


def least_of_limited() -> float:
    carts = [Cart(1, 6), Cart(2, 5)]
    cut = carts[0].size

    def phases(z: np.ndarray) -> tuple[float, Any, Any]:
        q, one, _ = carts[0].run(np.zeros(2), z[:cut], 1.0)
        q, two, speeds = carts[1].run(q, z[cut:], 1.0)
        return one + two, q - [2.0, 0.0], 1.2 - speeds

    return least(carts, phases, np.zeros(cut + carts[1].size), [(None, None)] * cut + [(-3.0, 3.0)] * carts[1].size)


def least_between_phases() -> float:
    """From 0 to ``b^2 - 1`` and from ``b`` to 3, each in a unit of time at an even speed."""
    return minimize_scalar(lambda b: (b**2 - 1) ** 2 / 2 + (3 - b) ** 2 / 2, bracket=(0.5, 1.0, 2.0), tol=1e-12).fun


# The full turn costs (pi / 2)^2 / 2 whatever the start, and -trace is least at the identity; a sixth of pi on a sphere.
LEAST: dict[str, tuple[Callable[[], float], float]] = {
    "bang-bang arcs of free durations": (lambda: 2.0, 1e-9),
    "three phases of one horizon": (least_of_shared_horizon, 1e-7),
    "limits in one of two phases": (least_of_limited, 1e-6),
    "a constraint between phases": (least_between_phases, 1e-9),
    "an end linked to its start": (lambda: np.pi**2 / 8 - 3, 1e-5),
    "an end on a set": (lambda: np.pi**2 / 72, 1e-9),
}


@pytest.mark.parametrize("case", list(CASES))
def test_searches_end_at_the_least_cost(case):
    found, (expected, error) = CASES[case](), LEAST[case]
    assert found.success
    assert found.cost == pytest.approx(expected(), rel=error)


def linked(case: str, monkeypatch: Any) -> LinkedPhases:
    """The phases of a problem with their coupling."""
    seen, guess = [], LinkedPhases.guess
    with monkeypatch.context() as patch:
        patch.setattr(LinkedPhases, "guess", lambda own, parts: seen.append(own) or guess(own, parts))
        CASES[case]()
    return seen[0]


def test_the_multipliers_of_a_guess_fit_its_costates(monkeypatch):
    """With the costates of a solution they are the multipliers of the solution: a search from it takes no time."""
    found = CASES["three phases of one horizon"]()
    again = CASES["three phases of one horizon"](guess=found)
    assert again.success
    assert again.statistics.iterations <= 1
    assert again.cost == pytest.approx(found.cost, rel=1e-12)


@pytest.mark.parametrize("content", [np.nan, 1e300])
def test_the_memory_of_a_search_may_have_any_content(content, monkeypatch):
    expected = CASES["limits in one of two phases"]()
    take = Transcription.search_room

    def filled(own, size):
        room = take(own, size)
        room[...] = content
        return room

    monkeypatch.setattr(Transcription, "search_room", filled)
    found = CASES["limits in one of two phases"]()
    assert found.statistics.iterations == expected.statistics.iterations
    assert found.cost == expected.cost


def test_a_callback_stops_a_search():
    found = CASES["three phases of one horizon"](callback=lambda one: one.number == 2, throw=False)
    assert found.statistics.stopped
    assert not found.success
    assert found.statistics.iterations == 2


def test_what_does_not_fit_is_refused(monkeypatch):
    phases = linked("an end on a set", monkeypatch)
    of: Any = phases.coupling.function
    p = of.tape.program
    program = MachineProgram(p.codes, p.registers, p.values, p.inputs, p.outputs, p.size, None)
    ends = CoupledEnds(program, phases.coupling.count, [])
    made = [core_search.made(phase) for phase in phases.phases]
    Multiphase(made, ends)
    with pytest.raises(InvalidInputError, match="ends of 2 phases"):
        Multiphase(made * 2, ends)
    with pytest.raises(InvalidInputError, match="expected"):
        Multiphase(made, ends._replace(equations=ends.equations + 1))
