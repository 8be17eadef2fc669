"""The effort that an accuracy takes: iterations on all meshes beside those on the first."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax import problems
from retrax.integrators import Free, Guess, OptimalControlProblem, solve, step_errors
from retrax.integrators.stages.explicit_runge_kutta import mesh_times
from retrax.manifolds import Euclidean, Product
from retrax.retractions import Addition, Gauss, default_retraction

PLANE, SPACE, SIX = Euclidean(2), Euclidean(4), Euclidean(6)
MOST = 5  # times the iterations on the first mesh
# Known exceptions, both with singular arcs: at most 12 times, and 10.1 times at 1e-7.
MORE = {"turnpike": 12, "fuller": 12}


def cart(q, u):
    return jnp.stack([q[1], u[0]])


def least_thrust():
    """From rest to rest at distance 1 in the time 4 with least |u|, in two parts: ``T - sqrt(T^2 - 4)``."""
    problem = OptimalControlProblem(
        PLANE, lambda q, u: cart(q, u[:1] - u[1:]), lambda q, u: jnp.sum(u), 2, control_bounds=([0, 0], [1, 1])
    )
    ends = np.zeros(2), np.array([1.0, 0.0])
    return (problem, *ends, 4.0), {"method": Gauss(2, Addition(PLANE)), "steps": 20}, 4 - np.sqrt(12)


def held_back(distance):
    """A cart turned round within a distance, with least energy: ``4 / (9 l)`` [Bryson, Denham 1963]."""
    wall = {"wall": lambda q, u: q[0] - distance}
    problem = OptimalControlProblem(PLANE, cart, lambda q, u: u @ u / 2, 1, control_bounds=(-9, 9), constraints=wall)
    ends = np.array([0.0, 1.0]), np.array([0.0, -1.0])
    return (problem, *ends, 1.0), {"method": Gauss(2, Addition(PLANE)), "steps": 20}, 4 / 9 / distance


def descent():
    """To rest on Mars with least fuel, by a thrust between two sizes."""
    space = Product(SIX, Euclidean(1))
    weight = jnp.array([0.0, 0.0, -3.71])

    def dynamics(q, u):
        return jnp.concatenate([q[0][3:], u[:3] / q[1] + weight]), -5e-4 * u[3:]

    limits = {
        "cone": lambda q, u: u[:3] @ u[:3] - u[3] ** 2,
        "ground": lambda q, u: -q[0][2],
        "least": lambda q, u: 4.97 - u[3],
        "most": lambda q, u: u[3] - 13.26,
    }
    problem = OptimalControlProblem(space, dynamics, lambda q, u: u[3], 4, constraints=limits)
    start = np.array([450.0, -330.0, 2400.0, -40.0, 10.0, -10.0]), np.array([1.905])
    on = {"method": Gauss(2, default_retraction(space)), "steps": 40}
    return (problem, start, (np.zeros(6), None), 50.0), on, 412.42538


def of_library(name):
    """A problem of the library, with its optimum."""
    entry = problems.get(name)
    on = {"method": entry.discretization, "steps": entry.steps, "guess": entry.guess}
    return (entry.problem, entry.start, entry.end, entry.horizon), on, entry.optimum


CASES = {
    "least-thrust": (least_thrust, 9),
    "turnpike": (lambda: of_library("turnpike"), 9),
    "held-back-8": (lambda: held_back(0.08), 6),
    "held-back-10": (lambda: held_back(0.1), 6),
    "held-back-12": (lambda: held_back(0.12), 6),
    "fuller": (lambda: of_library("fuller"), 7),
    "descent": (descent, 6),
}
QUICK = "held-back-8", "held-back-10", "held-back-12"


@pytest.mark.parametrize("name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in CASES])
def test_an_accuracy_takes_few_iterations_more_than_the_first_mesh(name):
    """Of problems whose controls switch, are singular, or are held by a limit of the state."""
    make, digits = CASES[name]
    given, on, optimum = make()
    first = solve(*given, **on).statistics.iterations
    for accuracy in 10.0 ** -np.arange(3, digits + 1):
        found = solve(*given, **on, accuracy=accuracy, throw=False)
        assert found.success, (accuracy, found.result)
        assert found.checks.error <= accuracy
        assert abs(found.cost / optimum - 1) <= accuracy, accuracy
        assert found.statistics.iterations <= MORE.get(name, MOST) * first, (accuracy, first)


@pytest.mark.parametrize("rest", [0.0, 0.1, 0.3, 0.9])
def test_errors_of_controls_are_relative_to_the_cost(rest):
    """Whatever part of it is theirs: beside ``tanh(1) / 2`` a rest that no trajectory changes."""
    line = Euclidean(1)
    problem = OptimalControlProblem(line, lambda q, u: u, lambda q, u: (q @ q + u @ u) / 2 + rest, 1)
    found = solve(problem, np.ones(1), None, 1.0, method=Gauss(2, Addition(line)), steps=16)
    error = abs(found.cost / (np.tanh(1) / 2 + rest) - 1)
    assert 1 < np.sum(step_errors(problem, found).controls) / error < 4


@pytest.mark.parametrize("steps", [20, 80])
def test_controls_that_alternate_along_a_limit_err_by_the_square_of_a_step(steps):
    """Least time at a speed limit that holds at the nodes: alternating controls gain as much as a longer step."""
    problem = OptimalControlProblem(
        PLANE, cart, lambda q, u: 1.0, 1, control_bounds=(-1, 1), node_constraints={"speed": lambda q: q[1] - 0.4}
    )
    found = solve(problem, np.zeros(2), np.array([1.0, 0.0]), Free(3.0), method=Gauss(2, Addition(PLANE)), steps=steps)
    assert np.ptp(found.controls) == pytest.approx(2.0)
    errors = step_errors(problem, found)
    assert np.all(errors.controls <= (1 + 1e-6) / (steps**2 * np.mean(found.controls**2)))


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
    found = solve(disc, *ends, Free(3.0), method=method, steps=20, accuracy=1e-6, throw=False)
    assert found.success, found.result
    assert found.steps < 100
    at = found(mesh_times(np.full(80, found.horizon / 80), method.nodes)[1])
    controls = np.unwrap(np.arctan2(at.controls[:, 1], at.controls[:, 0]))[:, None]
    known = solve(angle, *ends, Free(float(found.horizon)), method=method, steps=80, guess=Guess(at.states, controls))
    assert found.horizon == pytest.approx(known.horizon, rel=1e-6)
