"""Members of a batch that arrive in a compiled pass each are what they are alone, to the last bit."""

import threading
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import jax
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Solver
from retrax.integrators.boundary_value.engine import parallel
from retrax.integrators.boundary_value.engine.trial import Arrivals, Trial
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Cayley, Gauss, Midpoint, Theta, default_retraction

from tests.integrators.engine.test_trial import pendulum, sphere_problem
from tests.integrators.problems import IDENTITY, REST, RIGID, SLEW, SPHERE, half_square, rotation

COUNT = 9
DRAW = np.random.default_rng(3)
AXES = DRAW.normal(size=(COUNT, 3))
ANGLES = np.linspace(0.3, 2.8, COUNT)
TURNS = np.stack([rotation(a * x / np.linalg.norm(x)) for a, x in zip(ANGLES, AXES, strict=True)])
AROUND = AXES / np.linalg.norm(AXES, axis=1, keepdims=True)
PLANE = Euclidean(2)

Batch = tuple[Solver, Any, Any, Any, Any]  # starts, ends, horizons, parameters


def slews(method: Any, steps: Any) -> Batch:
    """To different attitudes in different times."""
    return Solver(SLEW, method, steps), (IDENTITY, REST), (TURNS, np.zeros((COUNT, 3))), 40.0 + 5.0 * ANGLES, None


CASES: dict[str, Callable[[], Batch]] = {
    "slews": lambda: slews(Midpoint(Cayley(RIGID)), 20),
    "slews by collocation": lambda: slews(Gauss(3, Cayley(RIGID)), 8),
    "slews in unequal steps": lambda: slews(Theta(Cayley(RIGID), 0.3), np.linspace(1.0, 2.0, 12)),
    "directions with parameters": lambda: (
        Solver(sphere_problem(), Gauss(2, default_retraction(SPHERE)), 6),
        np.array([0.0, 0.0, 1.0]), AROUND, 1.0, np.linspace(0.5, 2.0, COUNT)
    ),
    "one step": lambda: (
        Solver(OptimalControlProblem(PLANE, pendulum, half_square, 1), Gauss(4, Addition(PLANE)), 1),
        np.zeros((COUNT, 2)), np.stack([np.linspace(0.1, 2.0, COUNT), np.zeros(COUNT)], axis=1), 1.5, None
    ),
}  # fmt: skip


@pytest.fixture
def arrived(monkeypatch):
    """What arrived in passes."""
    seen, each = list[Arrivals](), Trial.set_out_each

    def set_out_each(*arguments):
        seen.append(each(*arguments))
        return seen[-1]

    monkeypatch.setattr(Trial, "set_out_each", set_out_each)
    return seen


def member(given: Any, k: int, axes: int) -> Any:
    """What a member is given, where there is a leading axis more than ``axes``."""
    return jax.tree.map(lambda leaf: leaf[k] if np.ndim(leaf) > axes else leaf, given)


def alone(batch: Batch, k: int, **options: Any) -> Any:
    """The member solved by itself."""
    solver, starts, ends, horizons, parameters = batch
    start, end = (
        tuple(part[k] if part.shape[:1] == (COUNT,) and part.ndim > kind.ndim else part
              for part, kind in zip(given, (IDENTITY, REST), strict=True))
        if isinstance(given, tuple) else given[k] if given.ndim > 1 else given
        for given in (starts, ends)
    )  # fmt: skip
    own = None if parameters is None else parameters[k]
    return solver.solve(start, end, float(member(horizons, k, 0)), parameters=own, **options)


def assert_same(one: Any, other: Any) -> None:
    """Records that are equal to the last bit, but for their times."""
    for name in {field.name for field in fields(one)} - {"statistics", "interpolant", "quantities"}:
        left, right = jax.tree.leaves(getattr(one, name)), jax.tree.leaves(getattr(other, name))
        for a, b in zip(left, right, strict=True):
            assert type(a) is type(b)
            if isinstance(a, np.ndarray):
                np.testing.assert_array_equal(a, b, err_msg=name)
            else:
                assert a == b
    assert one.statistics.iterations == other.statistics.iterations


@pytest.mark.parametrize("name", CASES)
def test_a_batch_is_a_loop_over_its_members_to_the_last_bit(name, arrived):
    batch = CASES[name]()
    found = batch[0].solve_many(*batch[1:4], parameters=batch[4])
    assert found.success.all()
    assert len(arrived[0].members) >= COUNT - 1
    for k in arrived[0].members.tolist():
        single = alone(batch, k)
        assert_same(found[k], single)
        one, other = (jax.tree.leaves(vars(batch[0].sensitivity(own).end)) for own in (found[k], single))
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)


def test_members_that_do_not_arrive_in_passes_are_found_as_before(arrived):
    """Turns through nearly half a turn in two steps, whose ends are far apart, among others; each has its own units."""
    solver, start, ends, horizons, _ = batch = slews(Midpoint(Cayley(RIGID)), 2)
    found = solver.solve_many(start, ends, horizons)
    assert 0 < len(arrived[0].members) < COUNT
    for k in range(COUNT):
        single = alone(batch, k)
        assert found[k].success == single.success
        assert found[k].cost == pytest.approx(single.cost, rel=1e-10)
        np.testing.assert_allclose(found[k].states[0], single.states[0], atol=1e-8)
        one, other = (jax.tree.leaves(vars(solver.sensitivity(own).end)) for own in (found[k], single))
        for a, b in zip(one, other, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-8 * np.max(np.abs(b)))


@pytest.mark.parametrize("most", range(1, 9))
def test_success_is_that_of_members_alone_whatever_the_limit_of_iterations(most, arrived):
    """Through the number of iterations that members take."""
    batch = slews(Midpoint(Cayley(RIGID)), 20)
    found = batch[0].solve_many(*batch[1:4], max_iterations=most)
    singles = [alone(batch, k, max_iterations=most, throw=False) for k in range(COUNT)]
    assert list(found.success) == [own.success for own in singles]
    assert found.result == [own.result for own in singles]
    assert all(found.success[k] for k in arrived[0].members)


@pytest.mark.parametrize("after", [0, 1, 4, COUNT - 1])
def test_an_interrupt_leaves_what_has_arrived(after, monkeypatch):
    batch, run, calls = slews(Midpoint(Cayley(RIGID)), 20), Trial._run, []

    def interrupted(*arguments):
        calls.append(threading.current_thread())
        if len(calls) == after + 1:
            raise KeyboardInterrupt
        return run(*arguments)

    monkeypatch.setattr(parallel, "parts_of", lambda count, *_: [range(count)])
    monkeypatch.setattr(Trial, "_run", interrupted)
    found = batch[0].solve_many(*batch[1:4])
    assert list(found.success[:after]) == [True] * after
    assert all("stopped" in words.lower() or "interrupt" in words.lower() for words in found.result[after:])


def test_passes_are_run_side_by_side(monkeypatch, arrived):
    names = set()
    run = Trial._run

    def noted(*arguments):
        names.add(threading.current_thread().name)
        return run(*arguments)

    monkeypatch.setattr(parallel, "parts_of", lambda count, *_: [range(4), range(4, 5), range(5, count)])
    monkeypatch.setattr(Trial, "_run", noted)
    batch = slews(Gauss(2, Cayley(RIGID)), 10)
    found = batch[0].solve_many(*batch[1:4])
    assert "MainThread" not in names
    assert found.success.all()
    for k in (0, 4, 8):
        assert_same(found[k], alone(batch, k))
