"""Large batches in parts that are solved side by side, each in a thread of its own."""

from concurrent.futures import FIRST_EXCEPTION, wait
from threading import Event
from typing import Any

import numpy as np

from ....manifolds.numerics.ambient import joined, taken
from ....threads import on_its_own, parts_of
from .found import Found
from .newton import newton

LOCKED = 400.0  # points that take as long as what a part does under Python's lock
MOST = 16_000  # points of a part: the numbers of more do not stay in a cache


def newton_in_parts(
    conditions: Any, guess: Any, shape: tuple[int, int], tolerance: float, max_iterations: int
) -> Found:
    """What ``newton`` finds; ``shape``: number of members, and of the points of each."""
    count, points = shape
    if count == 1 or len(parts := parts_of(count, LOCKED / points, max(1, MOST // points))) == 1:
        return newton(conditions, guess, tolerance, max_iterations)
    stop = Event()

    def run(part: range) -> tuple[Any, Found]:
        members = np.arange(part.start, part.stop)
        own = conditions.of(members)
        with np.errstate(all="ignore"):
            return own, newton(own, taken(guess, members), tolerance, max_iterations, lambda _: stop.is_set())

    going, interrupted = [on_its_own(run, part) for part in parts], False
    try:
        wait(going, return_when=FIRST_EXCEPTION)
    except KeyboardInterrupt:
        interrupted = True  # each part ends with what it has, as one does that is interrupted itself
    stop.set()
    found = [own.result() for own in going]
    conditions.adopt([own for own, _ in found])
    arrays: Any = [own._replace(stopped=None) for _, own in found]
    return joined(arrays)._replace(stopped=interrupted)
