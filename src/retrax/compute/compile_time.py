"""Who is told how long programs take to compile by XLA, which nothing in JAX says in a way that can be taken back."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_listeners: list[Callable[[float], None]] = []


@contextmanager
def report_compile_time() -> Iterator[None]:
    """Tell all that listen how many seconds the body takes."""
    began = time.perf_counter()
    try:
        yield
    finally:
        seconds = time.perf_counter() - began
        for listener in list(_listeners):
            listener(seconds)


def listen(listener: Callable[[float], None]) -> None:
    """Have a function called with the seconds of each compilation, of any thread."""
    _listeners.append(listener)


def stop_listening(listener: Callable[[float], None]) -> None:
    """Stop calling a listener."""
    _listeners.remove(listener)
