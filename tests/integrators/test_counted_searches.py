"""The iterations of a solve are those of all its searches, whether their results are taken or not."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute.binding.search import Search
from retrax.integrators import OptimalControlProblem, Solver
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Midpoint

PLANE = Euclidean(2)


@pytest.mark.parametrize("speed", [0.9, 1.2])
def test_iterations_of_searches_without_success_are_counted(speed, monkeypatch):
    """One metre in a second takes a mean speed of 1: below, every search fails."""
    counts, run, restore = [], Search.run, Search.restore

    def counted(search):
        status = run(search)
        counts.append(search.read().facts.iterations)
        return status

    def counted_phase(search, most):
        found = restore(search, most)
        counts.append(found.trials)
        return found

    monkeypatch.setattr(Search, "run", counted)
    monkeypatch.setattr(Search, "restore", counted_phase)
    problem = OptimalControlProblem(
        PLANE,
        lambda q, u: jnp.stack([q[1], u[0]]),
        lambda q, u: u @ u / 2,
        controls=1,
        constraints={"speed": lambda q, u: q[1:] - speed},
    )
    found = Solver(problem, Midpoint(Addition(PLANE)), 16).solve(np.zeros(2), np.array([1.0, 0.0]), 1.0, throw=False)
    assert found.success == (speed > 1)
    assert (len(counts) > 1) == (speed < 1)
    assert found.statistics.iterations == sum(counts)
