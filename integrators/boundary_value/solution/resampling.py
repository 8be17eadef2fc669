"""A solution as a guess in other steps, or by another method: what it is between its nodes, at the places that are
wanted."""

from typing import NamedTuple

import numpy as np

from ....manifolds.numerics.tolerances import SAME_TIME
from ..guess import Guess
from .interpolation import Interpolant
from .record import Solution


class Mesh(NamedTuple):
    """The mesh of a method: lengths of the steps, places of the stages in each step as fractions, and the charts."""

    fractions: np.ndarray  # (N,)
    stages: np.ndarray  # (s,)
    interpolant: Interpolant

    def times(self, horizon: float) -> tuple[np.ndarray, np.ndarray]:
        """Times of the nodes, and of the stages."""
        nodes = horizon * np.concatenate([[0.0], np.cumsum(self.fractions)])
        return nodes, (nodes[:-1, None] + np.diff(nodes)[:, None] * self.stages).ravel()


def resample(solution: Solution, mesh: Mesh) -> Guess:
    """The solution at the nodes and stages of a mesh, over the horizon of the solution.

    Raises ``InvalidInputError`` if it is of other manifolds, and ``DomainError`` where a step does not fit into one
    chart.
    """
    mesh.interpolant.require_fits("guess: ", solution.states, solution.controls)
    begin = solution.times[0]
    times, stage_times = (begin + places for places in mesh.times(solution.horizon))
    if _same(times, solution.times) and _same(stage_times, solution.stage_times):
        return solution.guess()
    # A file that says nothing of the retraction is read as one of this: what it is between the nodes is a guess all the
    # same.
    interpolant = solution.interpolant or mesh.interpolant
    return interpolant.guess(solution, times, stage_times)


def _same(one: np.ndarray, other: np.ndarray) -> bool:
    horizon = np.max(np.abs(other), initial=0.0)
    return one.shape == other.shape and bool(np.all(np.abs(one - other) <= SAME_TIME * horizon))
