"""Gauss collocation: methods of order 2, 4, 6, ..."""

from functools import cache
from typing import final

from numpy.polynomial.legendre import leggauss

from .collocation import CollocationMethod, Tableau
from .discretization import DiscretizationMap, Midpoint


@final
class Gauss(CollocationMethod):
    """Collocation at ``s`` Gauss-Legendre nodes in the chart of a retraction around a point in the middle of the step.

    Parameters
    ----------
    stages : int
        The number ``s`` of nodes, at least 1. The order is ``2 s``.
    retraction : Retraction
        The retraction ``R``; the method acts on its manifold.

    Raises
    ------
    InvalidInputError
        For other arguments.

    Notes
    -----
    The chart is centred in the middle of the step, so that the step is symmetric. One stage is the midpoint rule,
    ``Midpoint(R)``. ``CollocationMethod`` has the formulas.

    References
    ----------
    Hairer, Lubich, Wanner, Geometric Numerical Integration, 2006, II.1.3.

    Examples
    --------
    >>> Gauss(3, Exponential(SO(3))).order
    6
    """

    @property
    def order(self) -> int:
        return 2 * self.stages

    @property
    def tableau(self) -> Tableau:
        return _tableau(self.stages)

    @property
    def discretization_map(self) -> DiscretizationMap:
        return Midpoint(self.retraction)


@cache
def _tableau(stages: int) -> Tableau:
    return Tableau.of(leggauss(stages)[0])
