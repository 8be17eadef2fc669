"""How far an iterate is from satisfying its conditions, relative to what these are made of."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ....manifolds.numerics.tolerances import EPS, HALF
from .arrays import plain
from .inequalities import VALUE
from .kkt_system import Assembled
from .scaling import SHARE, Units


class Measures(NamedTuple):
    """What gaps are measured by, and the largest of what is left in each trajectory.

    An entry of a gap is measured by the spread of the trajectory in it, by a share of its value, or, where it rests, of
    its unit, or, where the manifold's equations hold it, of one; the derivative of the Lagrangian by the parts that
    cancel in it, coordinate by coordinate, or, where all parts vanish, as the costates do at an optimum of the cost
    itself, by its curvature in any coordinate.
    """

    along: Float[np.ndarray, "B n"]  # in the coordinates of the nodes
    entries: Float[np.ndarray, "B E"]
    gap: Float[np.ndarray, " B"]  # between ends that should meet, entry by entry of the ambient space
    stationarity: Float[np.ndarray, " B"]
    scale: Float[np.ndarray, " B"]  # of the parts of the derivative


def shortfall_of(assembled: Assembled, units: Units) -> np.ndarray:
    """The most that a node or a point of a step lacks in a coordinate, in its unit, whatever the trajectory is like."""
    inner, most = assembled.blocks.inner, (assembled.extent.lacking / units.nodes).max(axis=1, initial=0.0)
    if inner is None:
        return most
    return np.maximum(most, (np.abs(inner.defect) / units.nodes[:, None, None]).max(axis=(1, 2, 3), initial=0.0))


def measures(assembled: Assembled, units: Units, steps: np.ndarray, transcription: Any) -> Measures:
    """How far iterates are from meeting at their nodes and points, and from stationarity."""
    from . import extent_kernels

    extent, (batch, size), n = assembled.extent, assembled.distance.shape, assembled.gap.shape[2]
    found = Measures(np.empty((batch, n)), np.empty((batch, size)), *np.empty((3, batch)))
    # With a barrier the curvature of the Hessian has no bound.
    least = np.zeros(batch) if assembled.blocks.held is None else units.cost
    sizes = extent.highest, extent.lowest, extent.support, extent.parts, extent.slope, extent.curvature
    of = plain(units.nodes), units.unknowns, least
    extent_kernels.measure(sizes, assembled.distance, of, (VALUE, SHARE, EPS**HALF), found)
    return found if assembled.blocks.inner is None else _with_points(found, assembled, units, steps, transcription)


def _with_points(
    found: Measures, assembled: Assembled, units: Units, steps: np.ndarray, transcription: Any
) -> Measures:
    """The measures with what the points of the steps lack, which was condensed."""
    inner, d = assembled.blocks.inner, units.nodes
    missed = np.abs(inner.defect).sum(axis=2).max(axis=1) / np.where(found.along > 0, found.along, 1.0)
    weights = steps[:, :, None, None] * transcription.tableau.weights[:, None]
    scale = np.maximum(d * np.abs(inner.multipliers).max(axis=(1, 2)), SHARE * found.scale[:, None])
    slopes = d * (np.abs(inner.slope) / weights).max(axis=(1, 2)) / np.where(scale > 0, scale, 1.0)
    gap, stationarity = np.maximum(found.gap, missed.max(axis=1)), np.maximum(found.stationarity, slopes.max(axis=1))
    return found._replace(gap=gap, stationarity=stationarity)
