"""Iterates of a transcribed problem, and the data that trajectories are computed for."""

from typing import Any, NamedTuple, final

import numpy as np


class Data(NamedTuple):
    """Data of a trajectory, with a leading axis for the members of a batch."""

    steps: np.ndarray  # lengths, shape (B, N)
    parameters: np.ndarray  # shape (B, P)
    asked: np.ndarray | None = None  # 1 where an inequality is to hold, else 0, shape (B, N, r, c); None: everywhere

    def activation(self, inequalities: int, places: int) -> np.ndarray:
        """``asked`` with all its axes, or with length 1 along them."""
        return np.ones((1, 1, places, inequalities)) if self.asked is None else self.asked


class KnownExtremal(NamedTuple):
    """Arrays of a guess beside states, controls and costates: states at the nodes, covectors at the stages."""

    nodes: np.ndarray  # (B, N + 1, E)
    stage_costates: np.ndarray  # (B, N, s, E)


class Unknowns(NamedTuple):
    """States at the centres of the steps and controls at their stages, as flat points; of shapes (B, N, E) and (B, N,
    s, U)."""

    centres: np.ndarray
    controls: np.ndarray


class CollocationUnknowns(NamedTuple):
    """Centres (B, N, E); at the points of steps velocities in frames at the centres (B, N, s, n), controls,
    costates."""

    centres: np.ndarray
    velocities: np.ndarray
    controls: np.ndarray
    costates: np.ndarray


@final
class Slacks(NamedTuple):
    """Slacks, multipliers, excesses and their prices, shape (B, N, r, c), and the barrier of each member, shape (B,).

    The price is infinite, and the excess zero, where an inequality is not elastic.
    """

    slacks: np.ndarray
    multipliers: np.ndarray
    excess: np.ndarray
    price: np.ndarray
    barrier: np.ndarray

    @classmethod
    def none(cls, shape: tuple[int, ...]) -> "Slacks":
        """Slacks of inequalities that do not pull."""
        zero = np.zeros(shape)
        return cls(np.ones(shape), zero, zero, np.full(shape, np.inf), np.zeros(shape[0]))


class Iterate(NamedTuple):
    """Unknowns of the steps, and covectors at the nodes, shape (B, N + 1, E)."""

    unknowns: Any
    costates: np.ndarray
    slacks: Slacks | None = None  # of the inequalities, if there are any; of a guess, with multipliers that are known


class LinkedIterate(NamedTuple):
    """The iterates of phases, and the multipliers of the equations between their ends, shape (B, M)."""

    parts: tuple[Iterate, ...]
    multipliers: np.ndarray


class Ends(NamedTuple):
    """Flat points at the ends, shape (B, E), and which of their entries and coordinates are prescribed."""

    start: np.ndarray
    end: np.ndarray
    start_entries: np.ndarray
    end_entries: np.ndarray
    start_coordinates: np.ndarray
    end_coordinates: np.ndarray
