"""The effort that an accuracy takes: iterations on all meshes beside those on the first, and memory of a step."""

import tracemalloc

import jax.numpy as jnp
import numpy as np
import pytest
from retrax import problems
from retrax.integrators import Free, Guess, OptimalControlProblem, Solver, solve
from retrax.integrators.boundary_value.guess import stage_places
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Gauss

PLANE, SPACE = Euclidean(2), Euclidean(4)
MOST = 5  # times the iterations on the first mesh


def cart(q, u):
    return jnp.stack([q[1], u[0]])


def least_thrust():
    """From rest to rest at distance 1 in the time 4 with least |u|, in two parts: ``T - sqrt(T^2 - 4)``."""
    problem = OptimalControlProblem(
        PLANE, lambda q, u: cart(q, u[:1] - u[1:]), lambda q, u: jnp.sum(u), 2, control_bounds=([0, 0], [1, 1])
    )
    return (problem, Gauss(2, Addition(PLANE)), np.zeros(2), np.array([1.0, 0.0]), 4.0, 20), 4 - np.sqrt(12)


def held_back():
    """A cart turned round within a distance of .1, with least energy: ``4 / (9 l)`` [Bryson, Denham 1963]."""
    problem = OptimalControlProblem(
        PLANE, cart, lambda q, u: u @ u / 2, 1, control_bounds=(-8, 8), constraints={"wall": lambda q, u: q[0] - 0.1}
    )
    return (problem, Gauss(2, Addition(PLANE)), np.array([0.0, 1.0]), np.array([0.0, -1.0]), 1.0, 20), 4 / 0.9


def of_library(name):
    """A problem of the library, with its optimum."""
    entry = problems.get(name)
    given = entry.problem, entry.discretization, entry.start, entry.end, entry.horizon, entry.steps, entry.guess
    return given, entry.optimum


CASES = {
    "least-thrust": (least_thrust, 9),
    "turnpike": (lambda: of_library("turnpike"), 9),
    "held-back": (held_back, 7),
    "fuller": (lambda: of_library("fuller"), 7),
    "fishing": (lambda: of_library("fishing"), 6),
    "catalyst-mixing": (lambda: of_library("catalyst-mixing"), 6),
}
QUICK = "least-thrust"


@pytest.mark.parametrize("name", [n if n == QUICK else pytest.param(n, marks=pytest.mark.slow) for n in CASES])
def test_an_accuracy_takes_few_iterations_more_than_the_first_mesh(name):
    """Of problems whose controls switch, are singular, or are held by a limit of the state."""
    make, digits = CASES[name]
    given, optimum = make()
    first = solve(*given).statistics.iterations
    for accuracy in 10.0 ** -np.arange(3, digits + 1):
        found = solve(*given, accuracy=accuracy, throw=False)
        assert found.success, (accuracy, found.result)
        assert found.checks.error <= accuracy
        assert abs(found.cost / optimum - 1) <= 2 * accuracy, accuracy
        assert found.statistics.iterations <= MOST * first, (accuracy, first)


@pytest.mark.parametrize(
    "turned", [pytest.param(-0.5, marks=pytest.mark.slow), 0.0, pytest.param(0.8, marks=pytest.mark.slow)]
)
def test_an_inequality_that_is_held_all_along_is_no_error_of_the_steps(turned):
    """Least time to rest with a thrust in a disc, at the rim of which it always is; beside the same with its angle as
    the control."""
    method, ends = Gauss(2, Addition(SPACE)), (np.array([0.0, 0.0, 0.5, turned]), np.array([1.0, 1.0, 0.0, 0.0]))

    def pushed(q, u):
        return jnp.concatenate([q[2:], u])

    disc = OptimalControlProblem(SPACE, pushed, lambda q, u: 1.0, 2, constraints={"disc": lambda q, u: u @ u - 1})
    angle = OptimalControlProblem(
        SPACE, lambda q, u: pushed(q, jnp.stack([jnp.cos(u[0]), jnp.sin(u[0])])), lambda q, u: 1.0, 1
    )
    found = solve(disc, method, *ends, Free(3.0), 20, accuracy=1e-6, throw=False)
    assert found.success, found.result
    assert found.steps < 100
    at = found(found.horizon * stage_places(method, np.full(80, 1 / 80)))
    controls = np.unwrap(np.arctan2(at.controls[:, 1], at.controls[:, 0]))[:, None]
    known = solve(angle, method, *ends, Free(float(found.horizon)), 80, Guess(at.states, controls))
    assert found.horizon == pytest.approx(known.horizon, rel=1e-6)


def test_a_system_of_a_step_is_held_twice_at_most():
    """The system that was accepted, and that of the trial: 37 kB each for a slew with limits and three stages."""
    entry = problems.get("limited-slew")
    solver, peaks = Solver(entry.problem, entry.discretization, 100), []
    given = entry.start, entry.end, entry.horizon
    solver.solve(*given)  # once for what is traced
    tracemalloc.start(1)
    try:
        for steps in (100, 400):
            tracemalloc.reset_peak()
            assert solver.with_steps(steps).solve(*given).success
            peaks.append(tracemalloc.get_traced_memory()[1])
    finally:
        tracemalloc.stop()
    assert (peaks[1] - peaks[0]) / 300 < 120e3
