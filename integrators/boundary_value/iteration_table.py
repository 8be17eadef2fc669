"""The prints of ``verbose=True``: the table of iterations, and lines on long work before the table."""

from collections.abc import Callable
from typing import Any, final

import numpy as np

from .transcription.iteration import Iteration

ITERATION_TITLES = f"{'iteration':>9} {'cost':>16} {'defect':>9} {'stationarity':>12} {'shift':>8} {'step':>6}"
LIMITED_TITLES = f" {'violation':>9} {'barrier':>8}"  # with inequalities


@final
class IterationTable:
    """A callback that prints a line for each iteration, and then calls another one."""

    def __init__(self, callback: Callable[[Iteration], Any] | None) -> None:
        self._callback = callback

    def __call__(self, iteration: Iteration) -> Any:
        limited = bool(np.any(iteration.barrier > 0))
        if not iteration.number:
            print(ITERATION_TITLES + (LIMITED_TITLES if limited else ""))
        line = f"{iteration.number:>9} {iteration.cost[0]:>16.9g} {iteration.defect[0]:>9.1e}"
        line += f" {iteration.stationarity[0]:>12.1e} {iteration.shift[0]:>8.0e} {iteration.fraction[0]:>6.3g}"
        if limited:
            line += f" {iteration.violation[0]:>9.1e} {iteration.barrier[0]:>8.1e}"
        place = int(iteration.members[0])
        print(line + (f"  member {place}" if place else ""))
        return self._callback(iteration) if self._callback is not None else None


def tell(callback: Callable[[Iteration], Any] | None, iteration: Iteration, words: str) -> bool:
    """Show an iteration whose line is one of its own, and whether the user's callback wants it to be the last."""
    say(callback, words)
    own = callback._callback if isinstance(callback, IterationTable) else callback
    return own is not None and bool(own(iteration))


def say(callback: Callable[[Iteration], Any] | None, words: str) -> None:
    """Print a line on what is done now, if the callback is one that prints."""
    if isinstance(callback, IterationTable):
        print(words, flush=True)
