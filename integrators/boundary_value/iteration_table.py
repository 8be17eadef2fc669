"""The table of iterations that ``verbose=True`` prints."""

from collections.abc import Callable
from typing import Any

import numpy as np

from .engine.found import Iteration

TITLES = f"{'iteration':>9} {'cost':>16} {'gap':>9} {'stationarity':>12} {'shift':>8} {'step':>6}"
LIMITED = f" {'violation':>9} {'barrier':>8}"  # with inequalities


def printed(callback: Callable[[Iteration], Any] | None) -> Callable[[Iteration], Any]:
    """A callback that prints a line for each iteration, and then calls another one."""

    def shown(iteration: Iteration) -> Any:
        limited = bool(np.any(iteration.barrier > 0))
        if not iteration.number:
            print(TITLES + (LIMITED if limited else ""))
        worst = int(np.argmax(np.maximum(iteration.gap, iteration.stationarity)))
        line = f"{iteration.number:>9} {iteration.cost[worst]:>16.9g} {iteration.gap[worst]:>9.1e}"
        line += (
            f" {iteration.stationarity[worst]:>12.1e} {iteration.shift[worst]:>8.0e} {iteration.fraction[worst]:>6.3g}"
        )
        if limited:
            line += f" {iteration.violation[worst]:>9.1e} {iteration.barrier[worst]:>8.1e}"
        more = len(iteration.members)
        print(line + (f"  the worst of {more} members" if more > 1 else ""))
        return callback(iteration) if callback is not None else None

    return shown
