"""Parts of a batch, solved side by side: nobody can tell from what is found."""

import os
import subprocess
import sys
import threading
from dataclasses import fields
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute.threads import one_thread, parts_of
from retrax.integrators import Free, OptimalControlProblem, Result, Solver
from retrax.integrators.boundary_value.engine import parallel
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


@pytest.fixture
def in_parts(monkeypatch):
    """Three parts of a batch, whatever the machine; of each the thread in which it was solved, which may be that of
    another that has ended."""
    seen, alone = [], parallel.newton

    def newton(*arguments):
        seen.append(threading.current_thread().name)
        return alone(*arguments)

    parts = [range(4), range(4, 7), range(7, COUNT)]
    monkeypatch.setattr(parallel, "parts_of", lambda count, *_: parts if count == COUNT else [range(count)])
    monkeypatch.setattr(parallel, "newton", newton)
    return seen


def assert_same(one, other):
    """Records that are equal to the last digit."""
    left, right = ({f.name: getattr(s, f.name) for f in fields(s)} for s in (one, other))
    for name in ("states", "costates", "controls", "cost", "success", "result", "multipliers", "checks"):
        for a, b in zip(*(jax.tree.leaves(own[name]) for own in (left, right)), strict=True):
            np.testing.assert_array_equal(np.asarray(a), np.asarray(b), err_msg=name)
    assert one.statistics.iterations == other.statistics.iterations


def test_limited_slews_are_the_same_in_parts(in_parts):
    solver, ends = slews()
    found = solver.solve_many(START, ends, HORIZON)
    assert len(in_parts) == 3
    assert "MainThread" not in in_parts
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parallel, "parts_of", lambda count, *_: [range(count)])
        whole = solver.solve_many(START, ends, HORIZON)
    assert list(whole.success) == [True] * (COUNT - 1) + [False]
    for one, other in zip(found, whole, strict=True):
        assert_same(one, other)
    # The units that a part has found belong to its members.
    for k in (0, 5, 9):
        one, other = (vars(solver.sensitivity(many[k]).start) for many in (found, whole))
        for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
            np.testing.assert_array_equal(a, b)


def test_ends_on_a_set_are_the_same_in_parts(in_parts):
    solver, given = levels(), np.linspace(0.2, 1.4, COUNT)
    found = solver.solve_many(np.zeros(2), Free(np.zeros(2)), 1.5, parameters=given)
    assert len(in_parts) == 3
    for solution, level in zip(found, given, strict=True):
        alone = solver.solve(np.zeros(2), Free(np.zeros(2)), 1.5, parameters=level)
        assert solution.states[-1, 0] == pytest.approx(level, abs=1e-9)
        assert_same(solution, alone)


def test_an_interrupt_leaves_every_part_with_what_it_has(in_parts, monkeypatch):
    begun = threading.Event()

    def interrupted(*_, **__):
        begun.wait()
        raise KeyboardInterrupt

    monkeypatch.setattr(parallel, "wait", interrupted)
    solver, ends = slews()
    alone = parallel.newton

    def newton(*arguments):
        begun.set()
        return alone(*arguments)

    monkeypatch.setattr(parallel, "newton", newton)
    found = solver.solve_many(START, ends, HORIZON)
    assert len(found) == COUNT
    assert np.isfinite(found.cost).all()
    left = [words == Result[Result.stopped] for words in found.result]
    assert list(found.success | left) == [True] * COUNT
    assert any(left)


def test_an_interrupt_is_not_lost_where_all_parts_have_ended(in_parts, monkeypatch):
    ended = parallel.wait

    def interrupted(*arguments, **options):
        ended(*arguments, **options)
        raise KeyboardInterrupt

    monkeypatch.setattr(parallel, "wait", interrupted)
    solver, ends = slews()
    found = solver.solve_many(START, ends, HORIZON, max_iterations=1)
    assert (found.converged, found.distinct) == (0, 0)
    assert f"{len(found)}, 0 of them converged, 0 distinct" in repr(found)
    assert found.result == [Result[Result.stopped]] * COUNT


def test_what_a_part_raises_ends_the_others(in_parts, monkeypatch):
    seen, alone = [], parallel.newton

    def newton(conditions, guess, tolerance, iterations, callback):
        if len(guess.costates) == 3:
            raise FloatingPointError("of one part")
        seen.append(alone(conditions, guess, tolerance, iterations, callback))
        return seen[-1]

    monkeypatch.setattr(parallel, "newton", newton)
    solver, ends = slews()
    with pytest.raises(FloatingPointError, match="of one part"):
        solver.solve_many(START, ends, HORIZON)
    assert all(own.stopped or own.claimed.any() for own in seen)


def test_a_callback_sees_the_whole_batch(in_parts):
    solver, ends = slews()
    seen = []
    solver.solve_many(START, ends, HORIZON, callback=lambda iteration: seen.append(len(iteration.members)))
    assert seen[0] == COUNT
    assert not in_parts


@pytest.mark.parametrize("locked", [0.01, 4.0])
@pytest.mark.parametrize("count", [1, 7, 8, 9, 16, 100, 1000])
def test_parts_are_all_items_in_their_order_and_as_many_as_are_fast(count, locked, monkeypatch):
    for processors in (1, 2, 3, 64):
        monkeypatch.setattr("os.cpu_count", lambda processors=processors: processors)
        parts = parts_of(count, locked, 100)
        assert [k for part in parts for k in part] == list(range(count))
        assert max(map(len, parts)) <= 100
        if len(parts) <= processors:
            times = [count / n + locked * n for n in range(1, min(processors, count) + 1)]
            assert times[len(parts) - 1] <= 1.1 * min(times) or len(parts) == -(-count // 100)
        with one_thread():
            assert parts_of(count, locked, 100) == [range(count)]


def test_the_system_is_not_asked_for_processors_where_there_is_one_part(monkeypatch):
    monkeypatch.setattr("os.cpu_count", None)
    assert parts_of(7, 4.0, 100) == [range(7)]


IN_A_FORK = """
import os
import warnings

import jax
jax.config.update("jax_enable_x64", True)
import numpy as np
from retrax.integrators.boundary_value.engine import parallel
from tests.integrators.test_parts_of_a_batch import HORIZON, START, slews

parallel.parts_of = lambda count, *_: [range(0, 5), range(5, count)]
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
def test_a_fork_has_threads_of_its_own():
    path = Path(__file__).parents[2]
    ran = subprocess.run([sys.executable, "-c", IN_A_FORK], cwd=path, capture_output=True, text=True, timeout=120)
    assert ran.stdout == "True\n", ran.stderr
