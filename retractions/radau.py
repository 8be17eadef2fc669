"""Radau collocation: stiffly accurate methods of order 1, 3, 5, ..."""

from functools import cache
from typing import final

import numpy as np
from numpy.polynomial.legendre import legder, legroots, legval

from .collocation import CollocationMethod, Tableau
from .discretization import DiscretizationMap, Theta

POLISHING = 3  # Newton steps from the eigenvalues of a companion matrix to the rounding of double precision


@final
class Radau(CollocationMethod):
    """Collocation at ``s`` Radau nodes, the last of which is the end of the step (Radau IIA).

    Parameters
    ----------
    stages : int
        The number ``s`` of nodes, at least 1. The order is ``2 s - 1``.
    retraction : Retraction
        The retraction ``R``; the method acts on its manifold.

    Raises
    ------
    InvalidInputError
        For other arguments.

    Notes
    -----
    The method is L-stable and stiffly accurate: a fast motion that decays is gone after a step, where a Gauss method
    lets it swing on. The step is not symmetric, and one of Gauss has an order more with as many stages; so it is a
    method for stiff dynamics. ``CollocationMethod`` has the formulas.

    References
    ----------
    Hairer, Wanner, Solving Ordinary Differential Equations II, 1996, IV.5.

    Examples
    --------
    >>> method = Radau(2, Exponential(SO(3)))
    >>> method.order, method.nodes.round(6).tolist()
    (3, [0.333333, 1.0])
    """

    @property
    def order(self) -> int:
        return 2 * self.stages - 1

    @property
    def tableau(self) -> Tableau:
        return _tableau(self.stages)

    @property
    def discretization_map(self) -> DiscretizationMap:
        return Theta(self.retraction, 1.0)


@cache
def _tableau(stages: int) -> Tableau:
    """The tableau of the roots of ``P_s - P_{s-1}``."""
    series = np.zeros(stages + 1)
    series[-2:] = -1.0, 1.0
    x, slope = np.sort(legroots(series)), legder(series)
    for _ in range(POLISHING):
        x = x - legval(x, series) / legval(x, slope)
    x[-1] = 1.0
    return Tableau.of(x)
