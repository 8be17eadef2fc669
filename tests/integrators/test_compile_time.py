"""Tracing and compiling are not counted as running."""

import time

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute.compile_time import Stopwatch, report_compile_time
from retrax.integrators import Free, OptimalControlProblem, Phase, Solver, solve, solve_phases
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Exponential, Midpoint


@pytest.mark.parametrize("seconds", [(), (0.02,), (0.02, 0.03)])
def test_programs_that_xla_compiles_are_counted_apart(seconds):
    with report_compile_time():
        time.sleep(0.02)  # outside: not heard
    with Stopwatch() as watch, Stopwatch() as other:
        for each in seconds:
            with report_compile_time():
                time.sleep(each)
        time.sleep(0.01)
        compiling, running = watch.seconds()
    with report_compile_time():
        time.sleep(0.02)
    assert sum(seconds) <= compiling <= sum(seconds) + 0.05
    assert 0.01 <= running < 0.06
    assert watch.seconds()[0] == other.seconds()[0] == compiling


@pytest.mark.parametrize("evaluator", ["tape", "xla"])
def test_the_seconds_of_a_solve_are_those_that_it_takes(evaluator):
    line = Euclidean(1)

    def cost(q, u):
        return jnp.cosh(u[0]) + q @ q / 2

    solver = Solver(OptimalControlProblem(line, lambda q, u: u, cost, 1), Midpoint(Exponential(line)), 7, evaluator)
    seconds = []
    for _ in range(2):
        began = time.perf_counter()
        spent = solver.solve(np.ones(1), None, 1.0).statistics
        seconds.append((spent.compile_seconds, spent.run_seconds, time.perf_counter() - began))
    (first_compiled, first_run, first), (compiled, run, second) = seconds
    assert first_compiled + first_run <= first
    assert compiled + run <= second
    if evaluator == "xla":
        assert first_compiled > 0.7 * first
        assert first_run < 0.3 * first
    assert compiled < 0.2 * first_compiled


@pytest.mark.parametrize("accuracy", [None, 1e-3, 1e-6])
def test_the_report_of_a_call_has_the_time_of_the_call(accuracy):
    line = Euclidean(1)
    problem = OptimalControlProblem(line, lambda q, u: u, lambda q, u: u @ u / 2 + jnp.cosh(q[0]), 1)
    began = time.perf_counter()
    spent = solve(
        problem, np.ones(1), None, 5.0, method=Midpoint(Addition(line)), steps=4, accuracy=accuracy
    ).statistics
    passed = time.perf_counter() - began
    assert 0.9 * passed <= spent.compile_seconds + spent.run_seconds <= passed


@pytest.mark.slow
def test_the_report_of_a_singular_problem_counts_its_classification():
    line = Euclidean(1)
    problem = OptimalControlProblem(line, lambda q, u: u, lambda q, u: q @ q / 2, 1)
    solver = Solver(problem, Midpoint(Addition(line)), 4)
    began = time.perf_counter()
    spent = solver.solve(None, None, 1.0).statistics
    passed = time.perf_counter() - began
    assert 0.9 * passed <= spent.compile_seconds + spent.run_seconds <= passed


@pytest.mark.parametrize("horizon", [1.0, Free(1.0, 0.9, 1.1)])
@pytest.mark.parametrize("count", [1, 2, 7])
@pytest.mark.usual(2)
def test_the_seconds_of_a_batch_are_shared_by_its_members(horizon, count):
    line = Euclidean(1)
    solver = Solver(OptimalControlProblem(line, lambda q, u: u, lambda q, u: u @ u / 2, 1), Midpoint(Addition(line)), 5)
    solver.solve_many(np.zeros((count, 1)), np.ones((count, 1)), horizon)
    began = time.perf_counter()
    found = solver.solve_many(np.zeros((count, 1)), np.ones((count, 1)), horizon)
    spent = time.perf_counter() - began
    assert 0 < sum(own.run_seconds + own.compile_seconds for own in found.statistics) <= spent


@pytest.mark.parametrize("compiling", [0.0, 1e3])
def test_the_seconds_of_phases_are_counted_once(compiling, monkeypatch):
    """By a clock that stands: what takes no time after the iteration adds nothing."""
    line = Euclidean(1)
    problem = OptimalControlProblem(line, lambda q, u: u, lambda q, u: u @ u / 2, 1)
    shown = iter([(compiling, 1.0)])  # by the stopwatch of the iteration, which is read first
    monkeypatch.setattr(Stopwatch, "seconds", lambda self: next(shown, (0.0, 0.0)))
    began = time.perf_counter()
    ends = {"start": np.zeros(1)}, {"end": np.ones(1)}
    found = solve_phases([Phase(problem, Midpoint(Addition(line)), 2, 1.0, **end) for end in ends])
    spent = time.perf_counter() - began
    for own in found.phases:
        assert own.statistics.run_seconds == 1.0
        assert compiling <= own.statistics.compile_seconds <= compiling + spent
