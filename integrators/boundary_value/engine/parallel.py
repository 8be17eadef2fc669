"""Batches: those that arrive in a compiled pass each, and all others in parts that are solved side by side, each in a
thread of its own."""

from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_EXCEPTION, wait
from threading import Event
from typing import Any, TypeVar

import numpy as np

from ....compute.threads import on_its_own, parts_of
from ....manifolds.numerics.ambient import joined, taken
from .found import Found
from .newton import newton
from .own_units import outgrown, own_units
from .pursuit import arrivals
from .trial import Arrivals

# Points that take as long as what is done under Python's lock: for a part, or for the passes of one.
OF_A_PART, OF_PASSES = 400.0, 40.0
MOST = 16_000  # points of a part: the numbers of more do not stay in a cache
TOGETHER = 16  # passes of a part: some take twice as long as others

R = TypeVar("R")


def newton_of_all(conditions: Any, guess: Any, shape: tuple[int, int], tolerance: float, max_iterations: int) -> Found:
    """What ``newton`` finds; ``shape``: number of members, and of the points of each."""
    count, points = shape
    if count == 1:
        return newton(conditions, guess, tolerance, max_iterations)
    stop = Event()

    def share(run: Callable[[range], Iterator[None]], count: int) -> None:
        def to_its_end(part: range) -> None:
            with np.errstate(all="ignore"):
                for _ in run(part):
                    if stop.is_set():
                        return

        _side_by_side(to_its_end, parts_of(count, OF_PASSES / points, TOGETHER), stop)

    options = tolerance, max_iterations
    ahead = arrivals(conditions, guess, *options, share)
    if ahead is None or not ahead.members.size:
        return _in_parts(conditions, guess, shape, options, stop)
    there = conditions.of(ahead.members)
    arrived = _arrived(there, ahead, max_iterations)
    at = arrived.iterate, arrived.assembled
    if (loose := outgrown(there, own_units(there, *at)[0], *at)).any():
        kept = np.flatnonzero(~loose)
        if not kept.size:
            return _in_parts(conditions, guess, shape, options, stop)
        ahead = taken(ahead, kept)
        there, arrived = there.of(kept), taken(arrived._replace(stopped=None), kept)._replace(stopped=False)
    rest = np.setdiff1d(np.arange(count), ahead.members)
    if not rest.size:
        return arrived._replace(stopped=stop.is_set())
    others = conditions.of(rest)
    left = _in_parts(others, taken(guess, rest), (len(rest), points), options, stop)
    order = np.argsort(np.concatenate([ahead.members, rest]))
    return _merged(conditions, [(there, arrived), (others, left)], order)._replace(stopped=left.stopped)


def _arrived(conditions: Any, ahead: Arrivals, max_iterations: int) -> Found:
    """What passes have found that have arrived; the conditions take their units."""
    conditions.units, conditions.wider = ahead.units, None
    (iterate, assembled, appraisal, _), trials = ahead.tried, ahead.trials
    yes, no = np.ones(len(trials), bool), np.zeros(len(trials), bool)
    ended = ahead.strict, trials, trials + 1 > max_iterations, yes, yes
    told = False, assembled.extent.lacking / ahead.units.nodes, no, ahead.units.cost, no
    return Found(iterate, assembled, appraisal.residuals, *ended, *told)


def _in_parts(conditions: Any, guess: Any, shape: tuple[int, int], options: tuple[float, int], stop: Event) -> Found:
    """What ``newton`` finds of a batch, all members of a part at once."""
    count, points = shape
    parts = parts_of(count, OF_A_PART / points, max(1, MOST // points))
    if len(parts) == 1:
        return newton(conditions, guess, *options, (lambda _: True) if stop.is_set() else None)

    def run(part: range) -> tuple[Any, Found]:
        members = np.arange(part.start, part.stop)
        own = conditions.of(members)
        with np.errstate(all="ignore"):
            return own, newton(own, taken(guess, members), *options, lambda _: stop.is_set())

    return _merged(conditions, _side_by_side(run, parts, stop), slice(None))._replace(stopped=stop.is_set())


def _merged(conditions: Any, parts: list[tuple[Any, Found]], order: np.ndarray | slice) -> Found:
    """What is found of parts, one after the other in this order; the conditions take their units."""
    conditions.adopt([own for own, _ in parts], order)
    arrays: Any = [found._replace(stopped=None) for _, found in parts]
    return taken(joined(arrays), order)


def _side_by_side(run: Callable[[range], R], parts: list[range], stop: Event) -> list[R]:
    """What is found of parts, in threads if there are several, which are to stop where somebody interrupts, or one
    fails."""
    going = []
    try:
        if len(parts) == 1:
            return [run(parts[0])]
        going = [on_its_own(run, part) for part in parts]
        wait(going, return_when=FIRST_EXCEPTION)
    except KeyboardInterrupt:
        stop.set()  # each part ends with what it has, as one does that is interrupted itself
    if any(own.done() and own.exception() for own in going):
        stop.set()
    for own in going:
        own.exception()  # until it has ended
    return [own.result() for own in going]
