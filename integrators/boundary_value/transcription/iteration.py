"""The report of Newton's method to a callback after each evaluation."""

from typing import Any, NamedTuple

import numpy as np

from ....former_names import former_field


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
