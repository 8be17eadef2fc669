"""Python's own work put off, or saved, where very many objects are made at once and many functions call one another."""

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import ParamSpec, TypeVar

ROOM = 70_000  # places on the stack, of 8 bytes

P = ParamSpec("P")
R = TypeVar("R")


@contextmanager
def pause_garbage_collection() -> Iterator[None]:
    """No garbage is collected meanwhile: each collection goes through all that JAX holds, and finds next to nothing."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def with_room(run: Callable[P, R], *arguments: P.args, **options: P.kwargs) -> R:
    """Call a function that traces.

    CPython keeps frames in chunks of 16 kB, asks the system for one where calls cross the end of the last, and gives it
    back where they return: where that end lies within a trace, thousands of times, and the trace takes twice as long.
    The frame of this function is so large that it has a chunk of its own, with room behind it for all that is called.
    """
    return run(*arguments, **options)


with_room.__code__ = with_room.__code__.replace(co_stacksize=ROOM)


def undisturbed(function: Callable[P, R]) -> Callable[P, R]:
    """The function, while which no garbage is collected, with room for the frames of all that it calls."""

    @wraps(function)
    def run(*arguments: P.args, **options: P.kwargs) -> R:
        with pause_garbage_collection():
            return with_room(function, *arguments, **options)

    return run
