"""Batches on the core: each member has a search of its own, in one of several threads."""

import threading
import time
from collections import Counter
from typing import Any

import numpy as np
import pytest
from retrax.compute import threads
from retrax.integrators import Result
from retrax.integrators.boundary_value import regular_extremals

from ..integrators.test_parts_of_a_batch import COUNT, HORIZON, START, slews


@pytest.fixture
def seen(monkeypatch):
    """The threads of the searches."""
    names, alone = list[str](), regular_extremals.search_member

    def search(*given: Any) -> Any:
        names.append(threading.current_thread().name)
        return alone(*given)

    monkeypatch.setattr(regular_extremals, "search_member", search)
    monkeypatch.setattr("os.cpu_count", lambda: 3)
    return names


def test_members_are_searched_in_several_threads(seen):
    solver, ends = slews()
    found = solver.solve_many(START, ends, HORIZON)
    assert len(seen) == COUNT
    assert "MainThread" not in seen
    assert list(found.success) == [True] * (COUNT - 1) + [False]


def test_an_interrupt_leaves_every_member_with_what_it_has(seen, monkeypatch):
    begun, alone = threading.Event(), regular_extremals.search_member

    def search(*given: Any) -> Any:
        begun.set()
        *_, watch, k = given
        while k == COUNT // 2 and not watch.stopped:
            time.sleep(0.001)
        return alone(*given)

    def interrupted(*_: Any, **__: Any) -> None:
        begun.wait()
        raise KeyboardInterrupt

    monkeypatch.setattr(regular_extremals, "search_member", search)
    monkeypatch.setattr(threads, "wait", interrupted)
    solver, ends = slews()
    found = solver.solve_many(START, ends, HORIZON)
    assert np.isfinite(found.cost).all()
    left = [words.startswith(Result[Result.stopped]) for words in found.result]
    assert list(found.success | left)[:-1] == [True] * (COUNT - 1)  # the last one contradicts itself at once
    assert any(left)


def test_an_error_of_a_member_is_raised_when_all_have_ended(seen, monkeypatch):
    ended, alone = list[int](), regular_extremals.search_member

    def search(*given: Any) -> Any:
        if given[-1] == 4:
            raise FloatingPointError("of one member")
        ended.append(given[-1])
        return alone(*given)

    monkeypatch.setattr(regular_extremals, "search_member", search)
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
