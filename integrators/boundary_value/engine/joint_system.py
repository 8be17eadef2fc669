"""The records of trajectories whose ends are coupled: iterates, systems and steps of all phases together."""

from typing import NamedTuple

import numpy as np

from ..transcription.iterate import LinkedIterate as JointIterate
from .coupling import Coupled
from .kkt_system import Assembled, Step

__all__ = ["JointAssembled", "JointExtent", "JointIterate", "JointStep", "JointUnits"]


class JointExtent(NamedTuple):
    """The largest of what the nodes of all phases lack in each coordinate, then the equations, shape (B, n)."""

    lacking: np.ndarray


class JointAssembled(NamedTuple):
    """The KKT systems of the phases, and the equations between their ends."""

    parts: tuple[Assembled, ...]
    coupled: Coupled

    @property
    def cost(self) -> np.ndarray:
        """The cost of all phases."""
        return sum((part.cost for part in self.parts), np.zeros(len(self.coupled.values)))

    @property
    def extent(self) -> JointExtent:
        """What the nodes lack."""
        parts = [part.extent.lacking for part in self.parts]
        return JointExtent(np.concatenate([*parts, np.abs(self.coupled.values)], axis=1))


class JointStep(NamedTuple):
    """The steps of the phases, what their ends move by, (B, Z), and the steps of the multipliers in coordinates, (B,
    r)."""

    parts: tuple[Step, ...]
    moves: np.ndarray
    multipliers: np.ndarray
    strict: np.ndarray
    convex: np.ndarray
    finite: np.ndarray
    reach: np.ndarray
    followed: np.ndarray

    @property
    def of_multipliers(self) -> "JointStep":
        """The whole step of the multipliers, and none of anything else."""
        parts, reach = tuple(part.of_multipliers for part in self.parts), np.ones_like(self.reach)
        return self._replace(parts=parts, moves=np.zeros_like(self.moves), reach=reach)


class JointUnits(NamedTuple):
    """The units of all nodes, then of the equations, (B, n); and of the cost."""

    nodes: np.ndarray
    cost: np.ndarray
