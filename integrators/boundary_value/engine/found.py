"""The result of Newton's method of the engine."""

from typing import NamedTuple, final

import numpy as np

from ..transcription.iterate import Iterate
from .kkt_system import Assembled, Residuals


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
