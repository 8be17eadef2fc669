"""A callback that asks to stop ends what was asked for, wherever that is."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Phase, Solver, continuation, solve, solve_phases
from retrax.integrators.boundary_value.drivers.mesh_refinement import StepErrorEstimator
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Gauss

LINE, PLANE = Euclidean(1), Euclidean(2)
METHOD = Gauss(2, Addition(LINE))
CUBIC = OptimalControlProblem(LINE, lambda q, u: u - q**3, lambda q, u: (q @ q + u @ u) / 2, 1)
# From rest to rest with a bounded force, whose price is its size: it jumps.
THRIFTY = OptimalControlProblem(
    PLANE,
    lambda q, u: jnp.stack([q[1], u[0] - u[1]]),
    lambda q, u: jnp.sum(u),
    2,
    control_bounds=(np.zeros(2), np.ones(2)),
)
CASES = {
    "steps": (CUBIC, np.ones(1), np.full(1, 1.5), 5.0, 20, 1e-8),
    "arcs": (THRIFTY, np.zeros(2), np.array([1.0, 0.0]), 3.0, 12, 1e-8),
}


class Stop:
    """Asks to stop at its call number ``at``, or is interrupted there, and counts those that follow."""

    def __init__(self, at, interrupted=False):
        self.at, self.calls, self.interrupted = at, 0, interrupted

    def __call__(self, *arguments):
        self.calls += 1
        if self.calls - 1 == self.at and self.interrupted:
            raise KeyboardInterrupt
        return self.calls - 1 == self.at


@pytest.mark.usual("steps-True")
@pytest.mark.parametrize("interrupted", [False, True])
@pytest.mark.parametrize("name", CASES)
def test_no_mesh_follows_the_one_that_is_stopped(name, interrupted):
    problem, start, end, horizon, steps, accuracy = CASES[name]
    method = Gauss(2, Addition(problem.manifold))

    def solved(at):
        stop = Stop(at, interrupted)
        options = {"throw": False, "callback": stop, "accuracy": accuracy}
        return solve(problem, start, end, horizon, method=method, steps=steps, **options), stop.calls

    whole, count = solved(-1)
    assert whole.success
    assert count > 8
    for at in range(0, count - 1, max(count // 20, 1)):
        found, calls = solved(at)
        assert calls == at + 1
        assert not found.success or found.checks.error <= accuracy
        assert found.success or "stopped" in found.result
        assert found.statistics.stopped
    assert solved(count - 1)[0].success


def test_an_interrupt_between_two_meshes_leaves_the_last_solution(monkeypatch):
    problem, start, end, horizon, steps, accuracy = CASES["steps"]
    estimate = StepErrorEstimator.__call__

    def solved(at):
        stop = Stop(at, interrupted=True)
        monkeypatch.setattr(StepErrorEstimator, "__call__", lambda *given: (stop(), estimate(*given))[1])
        return solve(
            problem, start, end, horizon, method=METHOD, steps=steps, accuracy=accuracy, throw=False
        ), stop.calls

    whole, count = solved(-1)
    assert whole.success
    assert not whole.statistics.stopped
    assert count > 2
    stopped = [solved(at) for at in range(count)]
    assert [calls for _, calls in stopped] == list(range(1, count + 1))
    for found, _ in stopped:
        assert not found.success
        assert found.statistics.stopped
        assert "stopped" in found.result
        assert found.checks.defect < 1e-9
    errors = [found.checks.error for found, _ in stopped]
    assert errors[0] is None
    assert errors[1:] == sorted(errors[1:], reverse=True)
    assert errors[-1] > accuracy


PRICED = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: 1 + u @ u / 2 + q @ q / 10, 1)
FAR = {  # searches that begin again where a horizon is far from its guess
    "horizon": lambda stop: solve(
        PRICED, np.zeros(1), np.full(1, 2.0), Free(100.0), method=METHOD, steps=3, callback=stop, throw=False
    ),
    "batch": lambda stop: Solver(PRICED, METHOD, 3).solve_many(
        np.zeros(1), np.array([[1.0], [2.0], [3.0]]), Free(100.0), callback=stop
    ),
    "phases": lambda stop: solve_phases(
        [Phase(PRICED, METHOD, 3, Free(40.0), start=np.zeros(1)), Phase(PRICED, METHOD, 3, 1.0, end=np.full(1, 2.0))],
        callback=stop,
        throw=False,
    ),
}


@pytest.mark.parametrize("interrupted", [False, True])
@pytest.mark.parametrize("name", FAR)
@pytest.mark.slow
def test_no_search_follows_the_one_that_is_stopped(name, interrupted):
    whole = Stop(-1)
    assert np.all(FAR[name](whole).success)
    searches = [0]
    for at in range(whole.calls):
        stop = Stop(at, interrupted)
        found = FAR[name](stop)
        spent = found.statistics if name == "batch" else [found.statistics]
        assert stop.calls == at + 1
        assert spent[-1].stopped
        searches.append(sum(np.atleast_1d(found.success)))
    assert searches[-1] == np.size(found.success)
    assert searches[1] == 0


@pytest.mark.parametrize("at", range(3))
def test_an_interrupt_in_the_last_iteration_ends_a_continuation(at):
    """It leaves a solution with success, of which ``statistics`` have the interrupt."""
    solver, seen = Solver(CUBIC, METHOD, 10), []
    path = {"start": np.ones(1), "horizon": 2.0}

    def told(place, solution):
        seen.append(solution)

    whole = continuation(solver, lambda s: {**path, "end": np.full(1, 1 + s)}, callback=told)
    assert whole.success
    assert len(seen) == len(whole.places) > 3
    kept, solved = Solver.solve, []

    def interrupted(self, *arguments, **options):
        found = kept(self, *arguments, **options)
        solved.append(found)
        object.__setattr__(found, "statistics", replace(found.statistics, stopped=len(solved) == at + 1))
        return found

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Solver, "solve", interrupted)
        stopped = continuation(solver, lambda s: {**path, "end": np.full(1, 1 + s)})
    assert not stopped.success
    np.testing.assert_array_equal(stopped.places, whole.places[: at + 1])


def test_a_callback_of_a_batch_may_tell_of_each_member():
    solver = Solver(CUBIC, METHOD, 4)
    found = solver.solve_many(
        np.zeros(1), np.array([[1.0], [2.0]]), 1.0, callback=lambda iteration: iteration.number >= iteration.members
    )
    assert not found.success.any()
    assert solver.solve_many(
        np.zeros(1), np.array([[1.0], [2.0]]), 1.0, callback=lambda iteration: iteration.defect < 0
    ).success.all()
