"""One level of the integrability algorithm: ranks of the derivative array at consistent points, clustered into strata."""

from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ....manifolds.numerics.rank import null_space, numerical_rank
from .points import Points

DETERMINED = 1e-6  # largest change of a determined component along a unit vector of free directions


class Signature(NamedTuple):
    """What characterises a stratum of ``P^k`` at a level."""

    codimension: int
    free_controls: int
    form_rank: int


@dataclass(frozen=True)
class PointRanks:
    """Ranks at one consistent point, with the smallest gap between singular values counted and not counted.

    ``kernel``: independent rows that span the kernel of the form on ``T P^k``, in the frame of ``T_z T*Q``. ``directions``:
    a basis of the directions in which the controls are free, one column each; ``determined``: which components of the
    control do not change along them. ``tangents``: an orthonormal basis of ``T P^k`` in units, one column each.
    """

    signature: Signature
    gap: float
    kernel: np.ndarray
    directions: np.ndarray
    determined: np.ndarray
    tangents: np.ndarray


@dataclass(frozen=True)
class Level:
    """A level of the algorithm: how many of the points tried reached ``P^k``, and the strata that they lie in."""

    index: int
    tried: int
    consistent: int
    strata: dict[Signature, int]
    gap: float
    residual: float
    slow: int

    @property
    def empty(self) -> bool:
        """Whether no consistent point was found."""
        return self.consistent == 0


def point_ranks(points: Points, index: int, level: int) -> PointRanks:
    """Codimension, free controls and rank of the form at one point of a batch."""
    by_state, by_jet = (matrix[index] for matrix in points.matrices(level))
    full, vertical = numerical_rank(np.concatenate([by_state, by_jet], axis=1), unit=1.0), numerical_rank(by_jet, unit=1.0)
    codimension = full.rank - vertical.rank
    conormals = null_space(by_jet.T, unit=1.0).T @ by_state
    tangents = np.linalg.svd(conormals)[2][codimension:].T
    units = points.units.state
    omega = points.at.omega[index] * np.outer(units, units)
    restricted = tangents.T @ omega @ tangents / np.max(np.abs(omega))
    form = numerical_rank(restricted, unit=1.0)
    kernel = np.linalg.qr(units[:, None] * (tangents @ null_space(restricted, unit=1.0)))[0].T
    free = null_space(by_jet, unit=1.0)[: points.at.jet.shape[-1]]
    controls = numerical_rank(free, unit=1.0)
    directions = np.linalg.svd(free, full_matrices=False)[0][:, : controls.rank]
    return PointRanks(
        signature=Signature(codimension, controls.rank, form.rank),
        gap=min(full.gap, vertical.gap, form.gap, controls.gap),
        kernel=kernel,
        directions=directions,
        determined=np.linalg.norm(directions, axis=1) <= DETERMINED,
        tangents=tangents,
    )


def summarise(points: Points, level: int, ranks: list[PointRanks]) -> Level:
    """The record of a level."""
    consistent = points.consistent
    return Level(
        index=level,
        tried=len(consistent),
        consistent=int(consistent.sum()),
        strata=dict(Counter(rank.signature for rank in ranks).most_common()),
        gap=min((rank.gap for rank in ranks), default=np.inf),
        residual=float(np.max(points.residuals[consistent], initial=0.0) if consistent.any() else np.min(points.residuals)),
        slow=int(np.sum(points.slow & consistent)),
    )
