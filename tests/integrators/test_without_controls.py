"""Problems without controls: a trajectory is found from its ends, and nothing stops at arrays without entries."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import (
    Free,
    Guess,
    OptimalControlProblem,
    Phase,
    Solver,
    discretization_error,
    solve,
    solve_phases,
    step_errors,
)
from retrax.manifolds import ConvergenceError, Euclidean
from retrax.retractions import Exponential, Gauss, Midpoint
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

PLANE = Euclidean(2)
METHOD = Gauss(2, Exponential(PLANE))
START = np.array([1.0, -2.0])
DECAYED = (1 - np.exp(-2.0)) / 2  # int_0^1 exp(-2 t) dt


def decaying(controls, **more):
    def dynamics(q, u):
        return -q + jnp.sum(u)

    return OptimalControlProblem(PLANE, dynamics, lambda q, u: q @ q + 1e9 * u @ u, controls, **more)


@pytest.mark.parametrize("controls", [2, 1, 0, Euclidean(0)])
@pytest.mark.usual(1)
def test_controls_that_hardly_help_and_no_controls_give_the_same(controls):
    problem, m = decaying(controls), getattr(controls, "dimension", controls)
    solver = Solver(problem, METHOD, 8)
    solution = solver.solve(START, None, 1.0)
    sensitivity = solver.sensitivity(solution)
    assert solution.checks.strict_minimum
    assert solution.cost == pytest.approx(5 * DECAYED, rel=1e-6)
    np.testing.assert_allclose(sensitivity.start.cost, 2 * DECAYED * START, rtol=1e-6)
    assert sensitivity.start.controls.shape == (2, 16, m)
    assert solution.controls.shape == (16, m)
    assert discretization_error(problem, METHOD.retraction, solution).largest["R^2"] < 1e-5
    assert step_errors(problem, solution).largest < 1e-5


@pytest.mark.parametrize("accuracy", [1e-4, 1e-8])
def test_without_controls_an_accuracy_is_met(accuracy):
    solution = solve(decaying(0), START, None, 1.0, method=METHOD, steps=5, accuracy=accuracy)
    assert solution.checks.error <= accuracy
    assert solution.cost == pytest.approx(5 * DECAYED, rel=accuracy)


@pytest.mark.parametrize("off", [0.0, 1e-3, 1.0])
def test_without_controls_only_the_end_of_the_trajectory_is_reached(off):
    end = solve(decaying(0), START, None, 1.0, method=METHOD, steps=8).states[-1]
    if not off:
        assert solve(decaying(0), START, end, 1.0, method=METHOD, steps=8).cost == pytest.approx(5 * DECAYED, rel=1e-6)
        return
    with pytest.raises(ConvergenceError, match="cannot be reached"):
        solve(decaying(0), START, end + off, 1.0, method=METHOD, steps=8)


@pytest.mark.parametrize("place", [0.5, 2.0])
def test_without_controls_a_start_and_a_horizon_are_found(place):
    settled = decaying(0, initial_cost=lambda q: (q - place) @ (q - place))
    begun = solve(
        settled,
        None,
        None,
        1.0,
        method=METHOD,
        steps=8,
        guess=solve(decaying(0), START, None, 1.0, method=METHOD, steps=8),
    )
    np.testing.assert_allclose(begun.states[0], place / (1 + DECAYED), rtol=1e-6)
    halved = solve(decaying(0), START, START / 2, Free(1.0, 0.1, 3.0), method=METHOD, steps=8)
    assert halved.horizon == pytest.approx(np.log(2), rel=1e-6)


def falling(measured):
    """The square of what an end misses a measured height by."""
    return lambda q: (q[0] - measured) ** 2


@pytest.mark.parametrize("count", [2, 3, 5])
@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("noise", [0.0, 1e-9, 1.0])
@pytest.mark.usual(2)
def test_a_line_through_measured_points(count, size, noise):
    """A phase between each two of them; where all points are on the line all costates vanish."""
    times = np.linspace(0.0, 1.0, count)
    heights = size * (1 + 2 * times + noise * np.cos(7 * np.arange(count)))
    expected, *_ = np.linalg.lstsq(np.stack([np.ones(count), times], axis=1), heights)
    method, phases = Gauss(2, Exponential(PLANE)), []
    for k in range(count - 1):
        first = {"initial_cost": falling(heights[0])} if k == 0 else {}
        problem = OptimalControlProblem(
            PLANE,
            lambda q, u: jnp.stack([q[1], 0 * q[1]]),
            lambda q, u: 0.0,
            0,
            terminal_cost=falling(heights[k + 1]),
            **first,
        )
        start = Free(np.zeros(2)) if k == 0 else None
        phases.append(Phase(problem, method, 1, times[k + 1] - times[k], start=start))
    found = solve_phases(phases)
    np.testing.assert_allclose(found.phases[0].states[0], expected, rtol=1e-8)
    assert found.phases[0].statistics.iterations < 15  # a second search looks for a minimum


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("noise", [0.0, 1e-9, 1.0])
@pytest.mark.usual(2)
def test_a_slope_and_a_start_are_fitted_at_an_end(size, noise):
    """All measured points as a cost of the end, from which the line goes back: there its costate vanishes."""
    times, line = np.linspace(0.0, 1.0, 5), Euclidean(1)
    heights = size * (1 + 2 * times + noise * np.cos(7 * np.arange(5)))
    expected, *_ = np.linalg.lstsq(np.stack([np.ones(5), times], axis=1), heights)

    def missed(q, slope):
        return jnp.sum((q[0] - slope * (1 - times) - heights) ** 2) / 2

    problem = OptimalControlProblem(
        line, lambda q, u, slope: jnp.reshape(slope, (1,)), lambda q, u, slope: 0.0, 0, terminal_cost=missed
    )
    method = Gauss(2, Exponential(line))
    found = solve(problem, Free(np.zeros(1)), None, 1.0, method=method, steps=2, parameters=Free(0.5))
    np.testing.assert_allclose([found.states[0, 0], found.parameters], expected, rtol=1e-8)


RAISED = Euclidean(6)  # populations, and their rates
RATES, POPULATION = np.array([1.0, 0.5, 0.8, 0.3]), np.array([2.0, 1.0])
OFF = {"one half": (np.full(2, 2.0), np.full(4, 0.5)), "one": (np.ones(2), np.ones(4))}


def preying(q, rates):
    """Growth of prey and predators, Lotka and Volterra's."""
    return [rates[0] * q[0] - rates[1] * q[0] * q[1], -rates[2] * q[1] + rates[3] * q[0] * q[1]]


def stepped(begin, rates):
    """Nodes by the midpoint rule at the measured times, its equations by iteration."""
    found = [np.array(begin)]
    for _ in range(9):
        q, h = found[-1], 5 / 36
        for _ in range(4):
            middle = q
            for _ in range(40):
                middle = q + h / 2 * np.array(preying(middle, rates))
            q = 2 * middle - q
        found.append(q)
    return np.stack(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    [Gauss(2, Exponential(RAISED)), Gauss(3, Exponential(RAISED)), Midpoint(Exponential(RAISED))],
    ids=["two", "three", "midpoint"],
)
@pytest.mark.parametrize("name", OFF)
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_predators_and_prey_are_fitted_from_a_constant_guess(name, noise, method):
    """Four rates and both beginnings from ten measurements, as `scipy.optimize.least_squares` finds them."""
    times, (stages, moved) = np.linspace(0.0, 5.0, 10), (1, stepped)

    def integrated(begin, rates):
        options = {"t_eval": times, "rtol": 1e-10, "atol": 1e-12}
        return solve_ivp(lambda _, q: preying(q, rates), (0, 5), begin, **options).y.T

    if isinstance(method, Gauss):
        stages, moved = method.stages, integrated
    data = integrated(POPULATION, RATES) + noise * np.random.default_rng(1).standard_normal((10, 2))
    guess = np.concatenate(OFF[name])
    judge = least_squares(lambda z: (moved(z[:2], z[2:]) - data).ravel(), guess)

    def met(place):
        return lambda q: jnp.sum((q[:2] - data[place]) ** 2) / 2

    phases = []
    for k in range(9):
        first = {"initial_cost": met(0)} if k == 0 else {}
        problem = OptimalControlProblem(
            RAISED,
            lambda q, u: jnp.stack([*preying(q, q[2:]), *(0 * q[2:])]),
            lambda q, u: 0.0,
            0,
            terminal_cost=met(k + 1),
            **first,
        )
        constant = Guess(np.tile(guess, (4 * stages, 1)), np.zeros((4 * stages, 0)))
        start = Free(guess) if k == 0 else None
        phases.append(Phase(problem, method, 4, 5 / 9, start=start, guess=constant))
    found = solve_phases(phases)
    assert found.status == "minimum"
    assert found.cost == pytest.approx(judge.cost, rel=1e-5, abs=1e-11)
    np.testing.assert_allclose(found.phases[0].states[0], judge.x, rtol=1e-5)
