"""A callback that asks to stop ends what was asked for, wherever that is."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Solver, solve
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
    """Asks to stop at its call number ``at``, and counts those that follow."""

    def __init__(self, at):
        self.at, self.calls = at, 0

    def __call__(self, iteration):
        self.calls += 1
        return self.calls - 1 == self.at


@pytest.mark.long("arcs")
@pytest.mark.parametrize("name", CASES)
def test_no_mesh_follows_the_one_that_is_stopped(name):
    problem, start, end, horizon, steps, accuracy = CASES[name]
    method = Gauss(2, Addition(problem.manifold))

    def solved(at):
        stop = Stop(at)
        options = {"throw": False, "callback": stop, "accuracy": accuracy}
        return solve(problem, method, start, end, horizon, steps, **options), stop.calls

    whole, count = solved(-1)
    assert whole.success
    assert count > 8
    for at in range(0, count - 1, max(count // 20, 1)):
        found, calls = solved(at)
        assert calls == at + 1
        assert not found.success or found.checks.error <= accuracy
        assert found.success or "stopped" in found.result
    assert solved(count - 1)[0].success


def test_a_callback_of_a_batch_may_tell_of_each_member():
    solver = Solver(CUBIC, METHOD, 4)
    found = solver.solve_many(
        np.zeros(1), np.array([[1.0], [2.0]]), 1.0, callback=lambda iteration: iteration.number >= iteration.members
    )
    assert not found.success.any()
    assert solver.solve_many(
        np.zeros(1), np.array([[1.0], [2.0]]), 1.0, callback=lambda iteration: iteration.gap < 0
    ).success.all()
