"""Bounds of free parameters and horizons: no iterate leaves them, wherever the guess and the optimum are."""

import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Solver
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Gauss, Midpoint

LINE = Euclidean(1)
BEST = 1.5**0.25  # of 1 / (2 T^3) + T, which x' = T^2 u from 0 to 1 costs with T u^2 / 2 + T
PACED = OptimalControlProblem(LINE, lambda q, u, pace: pace**2 * u, lambda q, u, pace: pace * (u @ u) / 2 + pace, 1)
QUICK = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: u @ u / 2 + 1, 1)  # 1 / (2 T) + T
# x' = a b u costs 1 / (2 a^2 b^2) + a + b: best at a = b with a^5 = 1.
PAIR = OptimalControlProblem(
    LINE, lambda q, u, p: p["a"] * p["b"][0] * u, lambda q, u, p: u @ u / 2 + p["a"] + p["b"][0], 1
)
ENDS = np.zeros(1), np.ones(1)
METHODS = {"midpoint": (Midpoint(Addition(LINE)), 6), "gauss": (Gauss(2, Addition(LINE)), 3)}


def paced(t):
    return 1 / (2 * t**3) + t


@pytest.fixture(scope="module", params=METHODS)
def solver(request):
    return Solver(PACED, *METHODS[request.param])


@pytest.mark.parametrize("lower", [0.5, 0.9, 1.1, BEST, 1.2, 3.0])
@pytest.mark.usual(2)
def test_a_parameter_is_found_from_above_its_bound_to_far_off(solver, lower):
    best = max(lower, BEST)
    for guess in (1.0, 1 + 1e-9, 1.01, 1.5, 3.0, 10.0):
        found = solver.solve(*ENDS, 1.0, parameters=Free(guess * lower, lower=lower), max_iterations=200)
        assert found.cost == pytest.approx(paced(best), rel=1e-9)
        assert found.parameters >= lower


@pytest.mark.parametrize("lower", [1e-6, 1e-3, 1e-2, 0.1])
@pytest.mark.parametrize("guess", [1.1, 1.3, 2.0])
@pytest.mark.usual(2)
def test_no_iterate_leaves_a_bound(lower, guess):
    """The cost falls without end where the parameter is negative: iterates that left the bound went there."""
    solver, given = Solver(PACED, *METHODS["midpoint"]), Free(np.array([guess]), lower=np.array([lower]))
    for most in (1, 2, 5, 20, 36, 40, 60):
        reached = solver.solve_many(np.zeros((1, 1)), np.ones((1, 1)), 1.0, parameters=given, max_iterations=most)[0]
        assert reached.parameters > lower
    found = solver.solve(*ENDS, 1.0, parameters=Free(guess, lower=lower), max_iterations=300)
    assert found.cost == pytest.approx(paced(BEST), rel=1e-9)
    again = solver.solve(*ENDS, 1.0, parameters=Free(found.parameters, lower=lower), guess=found)
    assert again.statistics.iterations < 10
    assert again.cost == pytest.approx(found.cost, rel=1e-9)


GUESSES = np.geomspace(1e-6, 1e3, 149)


@pytest.mark.parametrize(("guesses", "most"), [(GUESSES[4::24], 0), pytest.param(GUESSES, 1, marks=pytest.mark.slow)])
def test_a_parameter_is_found_from_guesses_of_all_sizes(solver, guesses, most):
    """The cost at a guess is up to ``1e17`` times the least one, which is its unit to begin with; ``most``: failures,
    none of them a success elsewhere. One guess, .911 of Gauss 2, crawls to the iteration limit: the first step jumps to
    a hundredth of it, and in units of that no step is long."""
    each = [
        solver.solve(*ENDS, 1.0, parameters=Free(guess, lower=1e-9), max_iterations=300, throw=False)
        for guess in guesses
    ]
    assert sum(not found.success for found in each) <= most
    given = Free(guesses, lower=np.full(len(guesses), 1e-9))
    starts, ends = np.zeros((len(guesses), 1)), np.ones((len(guesses), 1))
    batch = solver.solve_many(starts, ends, 1.0, parameters=given, max_iterations=300)
    assert np.sum(~batch.success) <= most
    for found in filter(lambda found: found.success, [*each, *batch]):
        assert found.cost == pytest.approx(paced(BEST), rel=1e-9)
        assert found.parameters == pytest.approx(BEST, rel=1e-5)


@pytest.mark.parametrize("side", ["lower", "upper"])
@pytest.mark.parametrize("bound", [1e-3, 0.1, 0.5, 1.0, 3.0, 30.0])
@pytest.mark.usual(2)
def test_a_horizon_is_found_from_its_bound(side, bound):
    """The best horizon is ``1 / sqrt(2)``."""
    best = 0.5**0.5
    expected = max(bound, best) if side == "lower" else min(bound, best)
    solver = Solver(QUICK, *METHODS["gauss"])
    for guess in (bound, bound * (1 + (1e-9 if side == "lower" else -1e-9)), bound * (2 if side == "lower" else 0.5)):
        found = solver.solve(*ENDS, Free(guess, **{side: bound}), max_iterations=200)
        assert found.cost == pytest.approx(1 / (2 * expected) + expected, rel=1e-9)
        assert found.horizon == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("lower", [1e-3, 0.5, 0.999, 1.001, 2.0])
@pytest.mark.usual(1)
def test_several_parameters_are_found_from_their_bounds(lower):
    """Both at their lower bound to begin with, the second one with an upper bound too."""
    solver, best = Solver(PAIR, *METHODS["midpoint"]), max(lower, 1.0)
    given = {"a": Free(1.5 * lower, lower=lower), "b": Free(np.full(1, 2 * lower), lower, 10.0)}
    found = solver.solve(*ENDS, 1.0, parameters=given, max_iterations=300)
    assert found.cost == pytest.approx(1 / (2 * best**4) + 2 * best, rel=1e-9)
    assert found.parameters["a"] == pytest.approx(best, rel=1e-5)


@pytest.mark.parametrize("lower", [1.2, 2.0])
def test_a_solution_at_a_bound_is_its_own_guess(solver, lower):
    found = solver.solve(*ENDS, 1.0, parameters=Free(2 * lower, lower=lower))
    again = solver.solve(*ENDS, 1.0, parameters=Free(lower, lower=lower), guess=found)
    assert again.cost == pytest.approx(found.cost, rel=1e-9)
    assert again.statistics.iterations <= found.statistics.iterations
