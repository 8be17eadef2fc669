"""How large a trajectory and the parts of its KKT system are, found in one pass."""

from typing import Any, NamedTuple, final

import numpy as np
from jaxtyping import Bool, Float

from ....compute.threads import in_threads
from ....manifolds.numerics.tolerances import EPS, HALF
from ...problem.point_layout import PointLayout
from .arrays import plain
from .transcription import Blocks

MET = 1e-6  # of the largest entry of the states: ends that are no farther apart meet
APART = 1e-3  # of the largest entry of an array: those that are farther do not
OF_POINTS = 6  # rows of the survey of points that are condensed


@final
class Extent(NamedTuple):
    """What is largest along the nodes and the steps of trajectories."""

    highest: Float[np.ndarray, "B E"]  # of the entries of the nodes
    lowest: Float[np.ndarray, "B E"]  # of these with the other sign
    support: Float[np.ndarray, "B n E"]  # of the entries of the frames
    sizes: Float[np.ndarray, "B n"]  # of the values of the entries, in the coordinates of the nodes
    missing: Float[np.ndarray, "B n"]  # the sum of what the nodes lack
    lacking: Float[np.ndarray, "B n"]  # the largest of that
    held: Float[np.ndarray, " B"]  # the sum of the multipliers on it
    parts: Float[np.ndarray, "B z"]  # of the parts that cancel in the derivative of the Lagrangian
    slope: Float[np.ndarray, "B z"]  # of this derivative
    curvature: Float[np.ndarray, "B z"]  # of the diagonals of the Hessians

    @property
    def values(self) -> np.ndarray:
        """Largest value of each entry of a node, shape (B, E)."""
        return np.maximum(self.highest, self.lowest)

    @property
    def spreads(self) -> np.ndarray:
        """From the lowest to the highest value of each, shape (B, E)."""
        return self.highest + self.lowest

    @property
    def moves(self) -> np.ndarray:
        """Whether each entry moves by more than rounding, shape (B, E)."""
        from .extent_kernels import STILL

        return self.spreads > STILL * self.values

    def along(self, entries: np.ndarray) -> np.ndarray:
        """Sizes in the coordinates of the nodes from sizes in the entries."""
        return (self.support * entries[:, None]).max(axis=2, initial=0.0)

    def moved(self, layout: PointLayout) -> tuple[np.ndarray, np.ndarray]:
        """What each coordinate of the nodes moves by, zero where that is rounding, and its size, shape (B, n).

        Beside the size of its column it may be rounding, as the tilt of an attitude that turns about one axis.
        """
        from . import extent_kernels

        (batch, n, size), columns = self.support.shape, layout.columns
        moved, sizes = np.empty((2, batch, n))
        own = self.highest, self.lowest, self.support, columns
        extent_kernels.moves(*own, EPS**HALF, np.empty((2, size)), moved, sizes)
        return moved, sizes


def alone(support: Float[np.ndarray, "n E"]) -> Bool[np.ndarray, " E"]:
    """Which entries have a coordinate of their own, which moves nothing else: they may have other units than those
    beside them."""
    from . import extent_kernels

    found = np.empty((1, support.shape[1]), bool)
    extent_kernels.find_alone(plain(support[None]), found)
    return found[0]


def extent(nodes: np.ndarray, frames: np.ndarray, coordinates: np.ndarray, gap: np.ndarray, blocks: Blocks) -> Extent:
    """The extent of trajectories with these nodes, frames, multipliers, gaps and blocks."""
    from . import extent_kernels

    batch, count, n, z = blocks.left.shape
    e = nodes.shape[2]
    highest, lowest = np.full((2, batch, e), -np.inf)
    support, sizes, held = np.zeros((batch, n, e)), np.zeros((batch, n)), np.zeros(batch)
    missing, lacking = np.zeros((2, batch, n))
    found = Extent(highest, lowest, support, sizes, missing, lacking, held, *np.zeros((3, batch, z)))
    trajectory = tuple(map(plain, (nodes, frames, coordinates, gap)))
    arrays = tuple(map(plain, (blocks.hessian, blocks.left, blocks.right, blocks.slope, blocks.gradient)))

    def run(part: range) -> None:
        extent_kernels.survey(part.start, part.stop, trajectory, arrays, tuple(found))

    in_threads(run, batch, count * (2 * n * (z + e)))
    return found


def ends_meet(assembled: Any, in_arrays: Float[np.ndarray, "A E"], tolerance: float) -> Bool[np.ndarray, " B"]:
    """Whether ends of steps are not as far apart as the arrays of the states are large, whatever gaps are measured by.

    Where units have lost their meaning, as where controls reach next to nothing or next to everything, a gap in these
    units says nothing.
    """
    extent, distance = assembled.extent, assembled.distance
    values = np.maximum(extent.highest, extent.lowest)
    worst, size = distance.max(axis=1, initial=0.0), values.max(axis=1, initial=0.0)
    met = worst <= MET * size
    if met.all():
        return met
    apart, own = (np.where(in_arrays > 0, entries[:, None], 0.0).max(axis=2) for entries in (distance, values))
    far = (apart > max(APART, 10 * tolerance) * own) & (apart > MET * size[:, None])
    return ~far.any(axis=1)
