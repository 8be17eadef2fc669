"""Batches on the core: each member has a search of its own, in one of several threads."""

import threading
from collections import Counter
from typing import Any

import jax
import numpy as np
import pytest
from retrax.compute import threads
from retrax.integrators import Result
from retrax.integrators.boundary_value.transcription import core_search

from ..integrators.test_parts_of_a_batch import COUNT, HORIZON, START, assert_same, slews


@pytest.fixture
def seen(monkeypatch):
    """The threads of the searches."""
    names, alone = list[str](), core_search.search

    def search(*arguments: Any) -> Any:
        names.append(threading.current_thread().name)
        return alone(*arguments)

    monkeypatch.setattr(core_search, "search", search)
    monkeypatch.setattr("os.cpu_count", lambda: 3)
    return names


def test_members_are_those_of_single_solves_bit_by_bit(seen):
    solver, ends = slews()
    found = solver.solve_many(START, ends, HORIZON)
    assert len(seen) >= COUNT
    assert "MainThread" not in seen[:COUNT]
    assert list(found.success) == [True] * (COUNT - 1) + [False]
    for k in range(COUNT):
        alone = solver.solve(START, tuple(part[k] for part in ends), HORIZON, throw=False)
        assert_same(found[k], alone)
        if alone.success:
            both = (vars(solver.sensitivity(one).end) for one in (found[k], alone))
            for a, b in zip(*map(jax.tree.leaves, both), strict=True):
                np.testing.assert_array_equal(a, b)


def test_an_interrupt_leaves_every_member_with_what_it_has(seen, monkeypatch):
    begun, alone = threading.Event(), core_search.search

    def search(*arguments: Any) -> Any:
        begun.set()
        return alone(*arguments)

    def interrupted(*_: Any, **__: Any) -> None:
        begun.wait()
        raise KeyboardInterrupt

    monkeypatch.setattr(core_search, "search", search)
    monkeypatch.setattr(threads, "wait", interrupted)
    solver, ends = slews()
    found = solver.solve_many(START, ends, HORIZON)
    assert np.isfinite(found.cost).all()
    left = [words.startswith(Result[Result.stopped]) for words in found.result]
    assert list(found.success | left)[:-1] == [True] * (COUNT - 1)  # the last one contradicts itself at once
    assert any(left)


def test_an_error_of_a_member_is_raised_when_all_have_ended(seen, monkeypatch):
    ended, alone = list[int](), core_search.search

    def search(*arguments: Any) -> Any:
        if arguments[2] == 4:
            raise FloatingPointError("of one member")
        ended.append(arguments[2])
        return alone(*arguments)

    monkeypatch.setattr(core_search, "search", search)
    solver, ends = slews()
    with pytest.raises(FloatingPointError, match="of one member"):
        solver.solve_many(START, ends, HORIZON)
    assert ended


def test_a_callback_sees_each_member_and_can_stop_all(seen):
    solver, ends = slews()
    told = Counter[int]()

    def callback(iteration: Any) -> bool:
        told.update(iteration.members.tolist())
        return told[3] > 2

    found = solver.solve_many(START, ends, HORIZON, callback=callback)
    assert set(seen) == {"MainThread"}
    assert sorted(told) == list(range(4))
    assert list(found.success) == [True] * 3 + [False] * (COUNT - 3)
    assert found.result[3] == Result[Result.stopped]
