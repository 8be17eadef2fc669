"""How far an iterate is from satisfying its conditions, relative to what these are made of."""

from typing import Any

import numpy as np

from .inequalities import VALUE
from .scaling import SHARE, Units
from .system import Assembled


def measures(assembled: Assembled, units: Units) -> tuple[np.ndarray, np.ndarray]:
    """By what gaps are measured: in the coordinates of the nodes, (B, n), and entry by entry, (B, E)."""
    extent = assembled.extent
    own = np.maximum(extent.spreads, VALUE * extent.values)
    along = np.maximum(extent.along(own), SHARE * units.nodes)
    return along, np.maximum(own, np.max(extent.support * along[:, :, None], axis=1, initial=0.0))


def gap_of(assembled: Assembled, units: Units) -> np.ndarray:
    """Largest distance between ends that should meet, entry by entry of the ambient space.

    An entry is measured by the spread of the trajectory in it, by a share of its value, or, where it rests, of its
    unit.
    """
    along, entries = measures(assembled, units)
    gap = (assembled.distance / np.where(entries > 0, entries, 1.0)).max(axis=1)
    inner = assembled.blocks.inner
    if inner is None:
        return gap
    missed = np.abs(inner.defect).sum(axis=2).max(axis=1) / np.where(along > 0, along, 1.0)
    return np.maximum(gap, missed.max(axis=1))


def shortfall_of(assembled: Assembled, units: Units) -> np.ndarray:
    """The most that a node or a point of a step lacks in a coordinate, in its unit, whatever the trajectory is like."""
    inner, most = assembled.blocks.inner, (assembled.extent.lacking / units.nodes).max(axis=1, initial=0.0)
    if inner is None:
        return most
    return np.maximum(most, (np.abs(inner.defect) / units.nodes[:, None, None]).max(axis=(1, 2, 3), initial=0.0))


def stationarity_of(assembled: Assembled, units: Units, steps: np.ndarray, transcription: Any) -> np.ndarray:
    """Largest entry of the Lagrangian's derivative relative to the parts that cancel in it, coordinate by coordinate.

    Where all parts vanish, as the costates do at an optimum of the cost itself, its curvature in any coordinate sets
    the scale.
    """
    blocks, extent, d = assembled.blocks, assembled.extent, units.unknowns
    parts = d * extent.parts
    # With a barrier that of the Hessian has no bound.
    curvature = (d * d * extent.curvature).max(axis=1) if blocks.held is None else units.cost
    largest = np.maximum(parts.max(axis=1), curvature)
    scale = np.maximum(parts, SHARE * largest[:, None])
    found = (extent.slope * d / np.where(scale > 0, scale, 1.0)).max(axis=1)
    inner = blocks.inner
    if inner is None:
        return found
    weights = steps[:, :, None, None] * transcription.tableau.weights[:, None]
    d = units.nodes
    scale = np.maximum(d * np.abs(inner.multipliers).max(axis=(1, 2)), SHARE * largest[:, None])
    slopes = d * (np.abs(inner.slope) / weights).max(axis=(1, 2))
    return np.maximum(found, (slopes / np.where(scale > 0, scale, 1.0)).max(axis=1))
