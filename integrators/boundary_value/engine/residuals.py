"""How far an iterate is from satisfying its conditions, relative to what these are made of."""

from typing import NamedTuple, Self

import numpy as np
from jaxtyping import Float

from ....manifolds.numerics.tolerances import EPS, HALF
from .arrays import plain
from .extent import OF_POINTS
from .inequalities import VALUE, Surveyed
from .kkt_system import Assembled, Residuals
from .scaling import SHARE, Units

SHARES = VALUE, SHARE, EPS**HALF


class Appraisal(NamedTuple):
    """What gaps are measured by, how far the conditions are from being met, and what trials are compared by.

    An entry of a gap is measured by the spread of the trajectory in it, by a share of its value, or, where it rests, of
    its unit, or, where the manifold's equations hold it, of one; the derivative of the Lagrangian by the parts that
    cancel in it, coordinate by coordinate, or, where all parts vanish, as the costates do at an optimum of the cost
    itself, by its curvature in any coordinate of any phase.
    """

    along: Float[np.ndarray, "B n"]  # in the coordinates of the nodes
    entries: Float[np.ndarray, "B E"]
    residuals: Residuals
    infeasibility: Float[np.ndarray, " B"]  # the sum of what all nodes, points and inequalities lack, in units of steps
    cost: Float[np.ndarray, " B"]  # with its barrier, in its unit
    held: Float[np.ndarray, " B"]  # the multipliers on what is lacking, in the unit of the cost
    unmet: Float[np.ndarray, " B"]  # the most that a node or a point lacks in a coordinate, in units of success
    shortfall: Float[np.ndarray, " B"]  # the same in units of steps

    @classmethod
    def of(cls, along: np.ndarray, entries: np.ndarray, numbers: np.ndarray) -> Self:
        """From what the kernel finds."""
        return cls(along, entries, Residuals(*numbers[:RESIDUALS]), *numbers[RESIDUALS:])


RESIDUALS = len(Residuals._fields)
NUMBERS = RESIDUALS + len(Appraisal._fields) - 3  # that the kernel finds of each member


def appraisal(
    assembled: Assembled,
    units: tuple[Units, Units],
    mean: np.ndarray,
    limits: tuple[np.ndarray, np.ndarray, np.ndarray] | None,
) -> Appraisal:
    """The appraisal of iterates.

    ``units``: those that success is judged by, and those of steps; ``mean``: the mean steps; ``limits``: the survey of
    the inequalities, shape (10, B), their barrier and its unit, if there are any.
    """
    from . import extent_kernels

    extent, inner, (batch, n) = assembled.extent, assembled.blocks.inner, assembled.extent.missing.shape
    (judging, measured), numbers = units, np.zeros((NUMBERS, batch))
    along, entries = np.empty((batch, n)), np.empty(extent.highest.shape)
    points = np.zeros((batch, OF_POINTS, n)) if inner is None else inner.extent
    # With a barrier the curvature of the Hessian has no bound.
    least = judging.cost if limits is not None else np.zeros(batch) if assembled.curved is None else assembled.curved
    none = np.zeros((len(Surveyed._fields), batch)), np.zeros(batch), np.ones(batch)
    extent_kernels.measure(
        (*extent[:3], *extent[4:]),
        points,
        (assembled.distance, mean, assembled.cost),
        (plain(judging.nodes), judging.unknowns, least, plain(measured.nodes), measured.cost),
        none if limits is None else limits,
        SHARES,
        (along, entries, numbers),
    )
    return Appraisal.of(along, entries, numbers)
