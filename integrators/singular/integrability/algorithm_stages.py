"""One level of the integrability algorithm: ranks of the derivative array at consistent points, clustered into
strata."""

from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..integrability_result import Signature
from .echelon import CERTAIN, COUNTED, RANK_GAP, eliminate, significance
from .sample_points import RESOLUTION, Points

VANISHING_COSTATE = 1e-6  # of the action: a costate whose product with the lengths is smaller counts as zero


@dataclass(frozen=True)
class PointRanks:
    """Ranks at one consistent point, and whether they are clear.

    ``gap``: of the significance of what was counted over that of what was not. ``kernel``: independent rows that span
    the kernel of the form on ``T P^k``, in the frame of ``T_z T*Q``. ``determined``: which components of the control
    are the same wherever the others are free. ``tangents``: an orthonormal basis of ``T P^k`` in typical sizes, one
    column each. ``pivots``: the row of the array that was solved for each of ``u'``, ..., ``u``, ``z``, -1 where none
    was.
    """

    signature: Signature
    decided: bool
    gap: float
    kernel: np.ndarray
    determined: np.ndarray
    tangents: np.ndarray
    pivots: np.ndarray


class StoppedPoints(NamedTuple):
    """A point around which ``P^k`` stopped, in a batch of its own, and its ranks at all levels."""

    points: Points
    history: list[PointRanks]

    @property
    def ranks(self) -> PointRanks:
        """At the last level."""
        return self.history[-1]

    @property
    def trivial(self) -> bool:
        """Whether the costate vanishes."""
        sizes = self.points.sizes
        return bool(np.max(np.abs(self.points.at.costate) * sizes.lengths) <= VANISHING_COSTATE * sizes.action)


@dataclass(frozen=True)
class Level:
    """A level of the algorithm: how many of the points tried reached ``P^k``, and the strata that they lie in.

    ``slow`` and ``unclear``: at how many of them equations are irregular, and ranks not decided; ``left_out``: at how
    many either; ``opposed``: equations contradict each other at all others.
    """

    index: int
    tried: int
    consistent: int
    strata: dict[Signature, int]
    gap: float
    residual: float
    slow: int
    unclear: int
    left_out: int
    opposed: bool

    @property
    def empty(self) -> bool:
        """Whether no consistent point was found."""
        return self.consistent == 0

    @property
    def missing(self) -> int:
        """How many points are not found or left out."""
        return self.tried - self.consistent + self.left_out

    @property
    def unknown(self) -> bool:
        """Whether points were found and ranks are known at none of them."""
        return 0 < self.consistent == self.left_out


def point_ranks(points: Points, level: int) -> list[PointRanks]:
    """Codimension, free controls and rank of the form at each point of a batch.

    Rows of the array are solved for the derivatives of the control first, then for the control, then for the state.
    """
    m, n = points.at.jet.shape[-1], points.at.velocity.shape[1]
    by_state, by_jet = points.stacks(level)
    width = by_jet.shape[-1]
    control, state = slice(width - m, width), slice(width, width + n)
    values = (points.stack("array")[:, :, : level + 1] / points.units.rows[:, None, : level + 1]).reshape(
        *by_jet.shape[:-1], 1
    )
    matrix = np.concatenate([by_jet[..., m:], by_jet[..., :m], by_state, values], axis=-1)
    found = eliminate(matrix, (slice(0, width - m), control, state), np.arange(width) // m)
    tangents = found.null_basis(state)
    units = points.units.state[:, :, None]
    omega = points.stack("omega") * (units * np.swapaxes(units, 1, 2))[:, None]
    form = eliminate(np.swapaxes(tangents, 2, 3) @ omega @ tangents, (slice(0, n),), np.zeros(n, int))
    kernels = units * tangents[:, 0] @ form.null_basis(slice(0, n))[:, 0]
    bases = units / points.sizes.state[:, None] * tangents[:, 0]
    smallest, largest = np.minimum(found.smallest, form.smallest), np.maximum(found.largest, form.largest)
    determined = np.max(significance(found.null_basis(control)), axis=2, initial=0.0) <= COUNTED
    near = found.steps() <= CERTAIN / RANK_GAP * RESOLUTION
    ranks = []
    for i, rows in enumerate(found.rows):
        free, held = rows[state] < 0, form.rows[i] >= 0
        ranks.append(
            PointRanks(
                signature=Signature(int(np.sum(~free)), int(np.sum(rows[control] < 0)), int(np.sum(held))),
                decided=bool(found.decided[i] and form.decided[i] and near[i]),
                gap=float(smallest[i] / largest[i]) if largest[i] > 0 else np.inf,
                kernel=np.linalg.qr(kernels[i][:, free & ~held])[0].T,
                determined=determined[i],
                tangents=np.linalg.qr(bases[i][:, free])[0],
                pivots=rows[:-1],
            )
        )
    return ranks


def summarise(points: Points, ended: list[PointRanks], ranks: list[PointRanks]) -> Level:
    """The record of a level, from the ``ranks`` at its reliable points and the ranks of points where ``P^k``
    ``ended``."""
    consistent, before = points.consistent, len(ended)
    return Level(
        index=points.level,
        tried=before + len(consistent),
        consistent=before + int(consistent.sum()),
        strata=dict(Counter(rank.signature for rank in (*ended, *ranks)).most_common()),
        gap=min((rank.gap for rank in ranks), default=np.inf),
        residual=float(np.max(points.residuals[consistent]) if consistent.any() else np.min(points.approach)),
        slow=int(np.sum(points.slow & consistent)),
        unclear=int(np.sum(points.unclear & consistent)),
        left_out=int(np.sum((points.slow | points.unclear) & consistent)),
        opposed=bool(np.all(points.opposed)),
    )
