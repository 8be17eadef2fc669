"""The reports of an iteration: to a callback, and the prints of ``verbose=True``."""

from collections.abc import Callable
from typing import Any, NamedTuple, final

import numpy as np

from ...former_names import former_field

ITERATION_TITLES = f"{'iteration':>9} {'cost':>16} {'defect':>9} {'stationarity':>12} {'shift':>8} {'step':>6}"
LIMITED_TITLES = f" {'violation':>9} {'barrier':>8}"  # with inequalities


class Iteration(NamedTuple):
    """The facts that a callback sees after each evaluation: arrays with one entry, of the member that is searched.

    The members of a batch follow one another, each with all its searches. Of a singular problem the ``stationarity`` is
    the norm of the conditions of shooting, and the ``shift`` the damping; its cost, which is not known on the way, is
    NaN.
    """

    number: int
    members: np.ndarray  # its place in the batch
    cost: np.ndarray
    defect: np.ndarray  # relative, as in ``Checks``
    stationarity: np.ndarray
    shift: np.ndarray  # of the Hessian's diagonal, relative to it
    fraction: np.ndarray  # of the step that was tried
    accepted: np.ndarray
    violation: np.ndarray  # of the inequalities, relative
    barrier: np.ndarray  # relative to the unit of the cost rate; zero without inequalities
    gap = former_field("Iteration", "gap", "defect")


def stops(told: Any) -> bool:
    """Whether a callback that returned this asks to stop: by something true, or by an array that is true throughout."""
    return bool(np.all(told) if isinstance(told, np.ndarray) else told)


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
