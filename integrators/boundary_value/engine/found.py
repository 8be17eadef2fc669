"""What Newton's method tells on its way, and what it has found."""

from typing import Any, NamedTuple, final

import numpy as np

from ....former_names import former_field
from .kkt_system import Assembled, Iterate, Residuals


class Iteration(NamedTuple):
    """What a callback sees after each evaluation, with one entry for each member that is still on its way.

    Of a singular problem the ``stationarity`` is the norm of the conditions of shooting, and the ``shift`` the damping;
    its cost, which is not known on the way, is NaN.
    """

    number: int
    members: np.ndarray  # their places in the batch
    cost: np.ndarray
    defect: np.ndarray  # relative, as in ``Checks``
    stationarity: np.ndarray
    shift: np.ndarray  # of the Hessian's diagonal, relative to it
    fraction: np.ndarray  # of the step that was tried
    accepted: np.ndarray
    violation: np.ndarray  # of the inequalities, relative
    barrier: np.ndarray  # relative to the unit of the cost rate; zero without inequalities
    gap = former_field("Iteration", "gap", "defect")


@final
class Found(NamedTuple):
    """The last accepted iterate of each member with its KKT system, and how the iteration ended.

    ``strict_minimum``: the Hessian of the Lagrangian is positive definite on the null space of the constraints there.
    """

    iterate: Iterate
    assembled: Assembled
    residuals: Residuals
    strict_minimum: np.ndarray
    iterations: np.ndarray  # of the search that led here, and of those before it
    limited: np.ndarray  # that search has made as many as one may
    claimed: np.ndarray
    solvable: np.ndarray
    stopped: bool
    missing: np.ndarray  # what the nodes lack in each coordinate, in units, shape (B, n)
    contradictory: np.ndarray  # the inequalities, or they and the ends
    unit: np.ndarray  # of the cost, in which success was judged, shape (B,)
    falling: np.ndarray  # without success: the cost, as if it had no lower bound
    boundary: dict[str, np.ndarray] | None = None  # multipliers of boundary constraints by their names, each (B, k)
    notes: list[str] | None = None  # what is to be said of each member beside its result


def stops(told: Any) -> bool:
    """Whether a callback that returned this asks to stop: by something true, or by an array that is true throughout."""
    return bool(np.all(told) if isinstance(told, np.ndarray) else told)
