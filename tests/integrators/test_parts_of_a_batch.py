"""Members of a batch, solved side by side: nobody can tell from the results."""

import os
import subprocess
import sys
from dataclasses import fields
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute import threads
from retrax.integrators import Free, OptimalControlProblem, Result, Solver
from retrax.manifolds import Euclidean, hat
from retrax.retractions import Cayley, Gauss, Midpoint, default_retraction

from .problems import INERTIA, REST, RIGID, rotation

HORIZON, STEPS, COUNT = 3.0, 10, 11
START = np.eye(3), REST
PLANE = Euclidean(2)


def body(q, u):
    return q[0] @ hat(q[1]), (u - jnp.cross(q[1], INERTIA * q[1])) / INERTIA


@cache
def slews():
    """Limited torques, and a member whose limits contradict its ends: the last."""
    problem = OptimalControlProblem(RIGID, body, lambda q, u: u @ u / 2, 3, control_bounds=(-1.0, 1.0))
    axes = np.random.default_rng(1).normal(size=(COUNT, 3))
    angles = np.append(np.linspace(0.2, 1.2, COUNT - 1), 3.0)
    targets = np.stack([rotation(a * x / np.linalg.norm(x)) for a, x in zip(angles, axes, strict=True)])
    return Solver(problem, Midpoint(Cayley(RIGID)), STEPS), (targets, np.zeros((COUNT, 3)))


@cache
def levels():
    """Ends on a line, whose place is a parameter: coupled conditions."""
    problem = OptimalControlProblem(
        PLANE,
        lambda q, u, level: jnp.stack([q[1], u[0] - q[0]]),
        lambda q, u, level: (u[0] - 1.0) ** 2 / 2 + (q[0] - 0.3) ** 2,
        1,
        boundary_constraints={"level": lambda start, end, level: end[0] - level},
    )
    return Solver(problem, Gauss(2, default_retraction(PLANE)), 6)


@pytest.fixture(autouse=True)
def processors(monkeypatch):
    """Three threads, whatever the machine."""
    monkeypatch.setattr("os.cpu_count", lambda: 3)


def assert_same(one, other):
    """Records that are equal to the last digit."""
    left, right = ({f.name: getattr(s, f.name) for f in fields(s)} for s in (one, other))
    for name in ("states", "costates", "controls", "cost", "success", "result", "multipliers", "checks"):
        for a, b in zip(*(jax.tree.leaves(own[name]) for own in (left, right)), strict=True):
            np.testing.assert_array_equal(np.asarray(a), np.asarray(b), err_msg=name)
    assert one.statistics.iterations == other.statistics.iterations


def test_limited_slews_are_those_of_single_solves():
    solver, ends = slews()
    found = solver.solve_many(START, ends, HORIZON)
    assert list(found.success) == [True] * (COUNT - 1) + [False]
    for k, one in enumerate(found):
        other = solver.solve(START, tuple(part[k] for part in ends), HORIZON, throw=False)
        assert_same(one, other)
        if other.success:
            both = (vars(solver.sensitivity(solution).start) for solution in (one, other))
            for a, b in zip(*map(jax.tree.leaves, both), strict=True):
                np.testing.assert_array_equal(a, b)


def test_ends_on_a_set_are_those_of_single_solves():
    solver, given = levels(), np.linspace(0.2, 1.4, COUNT)
    found = solver.solve_many(np.zeros(2), Free(np.zeros(2)), 1.5, parameters=given)
    for solution, level in zip(found, given, strict=True):
        alone = solver.solve(np.zeros(2), Free(np.zeros(2)), 1.5, parameters=level)
        assert solution.states[-1, 0] == pytest.approx(level, abs=1e-9)
        assert_same(solution, alone)


def test_an_interrupt_is_not_lost_where_all_members_have_ended(monkeypatch):
    ended = threads.wait

    def interrupted(*arguments, **options):
        ended(*arguments, **options)
        raise KeyboardInterrupt

    monkeypatch.setattr(threads, "wait", interrupted)
    solver, ends = slews()
    found = solver.solve_many(START, ends, HORIZON, max_iterations=1)
    assert (found.converged, found.distinct) == (0, 0)
    assert f"{len(found)}, 0 of them converged, 0 distinct" in repr(found)
    assert found.result == [Result[Result.stopped]] * COUNT


IN_A_FORK = """
import os
import warnings

import jax
jax.config.update("jax_enable_x64", True)
import numpy as np
from tests.integrators.test_parts_of_a_batch import HORIZON, START, slews

os.cpu_count = lambda: 2
solver, ends = slews()
whole = solver.solve_many(START, ends, HORIZON)
warnings.simplefilter("ignore")  # JAX warns of forks
if os.fork() == 0:
    again = solver.solve_many(START, ends, HORIZON)
    print(np.array_equal(whole.states[0], again.states[0]), flush=True)
    os._exit(0)
os.wait()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.slow
def test_a_fork_has_threads_of_its_own():
    path = Path(__file__).parents[2]
    ran = subprocess.run([sys.executable, "-c", IN_A_FORK], cwd=path, capture_output=True, text=True, timeout=120)
    assert ran.stdout == "True\n", ran.stderr
