"""Room for frames, and garbage that is left alone meanwhile."""

import gc
import resource
from concurrent.futures import ThreadPoolExecutor

import pytest
from retrax.undisturbed import undisturbed, with_room


def deep(levels: int, run):
    """Call a function below so many frames."""
    return run() if levels == 0 else deep(levels - 1, run)


def leaf(a, b, c, d):
    """A frame that is left at once."""
    return a + b + c + d


def calls(count: int = 200) -> None:
    """Calls that return at once."""
    for _ in range(count):
        leaf(1, 2, 3, 4)


def faults(levels: int, run) -> int:
    """How often the system gives a page of memory while a function runs below so many frames."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    deep(levels, run)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


def most_faults() -> tuple[int, int]:
    """At the depth where calls cross the end of a chunk: without room, and with it."""
    found = []
    for levels in range(400):
        found.append(faults(levels, calls))
    return max(found), faults(found.index(max(found)), lambda: with_room(calls))


def test_calls_across_the_end_of_a_chunk_of_frames_ask_for_none_where_there_is_room():
    """In a thread, whose frames begin anew."""
    with ThreadPoolExecutor(1) as pool:
        without, there = pool.submit(most_faults).result()
    assert without >= 200  # else Python keeps frames otherwise by now, and needs no room
    assert there < 20


def test_arguments_and_what_is_returned_pass():
    assert with_room(lambda a, b=0: (a, b), 1, b=2) == (1, 2)
    with pytest.raises(KeyError, match="missing"):
        with_room({}.__getitem__, "missing")


@pytest.mark.parametrize("enabled", [True, False])
def test_garbage_is_collected_again_afterwards_if_it_was_before(enabled):
    before = gc.isenabled()
    try:
        (gc.enable if enabled else gc.disable)()
        assert undisturbed(gc.isenabled)() is False
        assert gc.isenabled() == enabled
        with pytest.raises(ZeroDivisionError):
            undisturbed(lambda: 1 / 0)()
        assert gc.isenabled() == enabled
    finally:
        (gc.enable if before else gc.disable)()
