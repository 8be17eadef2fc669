"""Discrete extremals: the result of a search, for records, audits and derivatives alike."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, final

import numpy as np

from .functions.steps import AtStages
from .kkt_system import KKTSystem


@final
class Residuals(NamedTuple):
    """Relative residuals of the first-order conditions, shape (B,); ``retrax_core.h`` explains them."""

    defect: np.ndarray
    stationarity: np.ndarray
    violation: np.ndarray
    excess: np.ndarray
    complementarity: np.ndarray
    largest: np.ndarray  # of the problem with its barrier


@final
class Inequalities(NamedTuple):
    """Inequalities ``g <= 0`` along trajectories, shape (B, N, r, c), in rows of points and then of ends of a step."""

    values: np.ndarray
    weights: np.ndarray  # zero where nothing is asked for
    slacks: np.ndarray
    multipliers: np.ndarray
    sizes: np.ndarray  # scaling, shape (B, 1, 1, c)
    rate: np.ndarray  # scaling of the cost rate, shape (B,)

    @property
    def active(self) -> np.ndarray:
        """Whether a multiplier exceeds the slack, in units of the scaling."""
        return self.multipliers / (self.rate[:, None, None, None] / self.sizes) > self.slacks / self.sizes


@final
class DiscreteExtremals(NamedTuple):
    """The last iterates of the searches of a batch, and how the searches ended; members lie along the leading axis.

    ``at_stages``: states, controls and costates at the stages, (B, N s, ...), from the covectors at the nodes;
    ``system``: the KKT matrix of a member.
    """

    nodes: np.ndarray  # (B, N + 1, E)
    costates: np.ndarray  # (B, N + 1, E)
    cost: np.ndarray
    residuals: Residuals
    missing: np.ndarray  # largest defect of the nodes in each coordinate, in units of the scaling, (B, n)
    inequalities: Inequalities | None
    strict_minimum: np.ndarray  # positive definite Hessian of the Lagrangian on the null space of the constraints
    convex: np.ndarray  # whether the cost of an extremal is strictly convex in the controls at each point
    iterations: np.ndarray  # of the search that led here, and of those before it
    limited: np.ndarray  # that search has made as many as one may
    converged: np.ndarray  # the first-order conditions hold
    solvable: np.ndarray
    infeasible: np.ndarray  # the inequalities contradict each other, or the ends
    falling: np.ndarray  # without success: the cost, as if it had no lower bound
    at_stages: Callable[[np.ndarray], AtStages]
    system: Callable[[int], KKTSystem]
    stopped: bool
    boundary: dict[str, np.ndarray] | None = None  # multipliers of boundary constraints by their names, each (B, k)
    notes: Sequence[str] | None = None  # to be said of each member beside its result
