"""The covariance of estimated states and parameters: diagonal blocks of the inverse of a KKT matrix."""

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ....manifolds import ConvergenceError, InvalidInputError
from ...reporting.records import shapes, write_protect
from ...reporting.text import brief
from ..transcription.kkt_system import KKTSystem
from .sensitivity import CLEAR

NODES_AT_ONCE = 32  # whose right-hand sides one elimination takes: more of them take memory, not less time


@final
@dataclass(frozen=True, eq=False)
class Covariance:
    r"""The covariance of estimated states and parameters, to first order in the errors of the measurements.

    Attributes
    ----------
    states : array of shape (N + 1, n, n)
        Covariances of the states at the nodes, in ``manifold.basis(q)`` there; zero for prescribed coordinates.
    parameters : array of shape (j, j)
        The covariance of the entries of all free parameters in a row, in the order of ``jax.tree.leaves``.
    cross : array of shape (N + 1, n, j)
        Covariances between the coordinates of the states and the parameters.

    Notes
    -----
    The inverse of the Hessian of the cost on the trajectories that satisfy the dynamics and the active constraints. It
    is the covariance if the cost is the negative logarithm of the likelihood: half the squares of the errors, each over
    its variance. White noise :math:`w` of the spectral density :math:`S` enters the dynamics as a control with the
    running cost :math:`w^T S^{-1} w / 2`.
    """

    states: np.ndarray
    parameters: np.ndarray
    cross: np.ndarray

    def __post_init__(self) -> None:
        write_protect(vars(self))

    def __repr__(self) -> str:
        return f"Covariance({', '.join(f'{name}={shapes(value)}' for name, value in vars(self).items())})"


def require_estimate(kept: Any, solution: Any) -> Any:
    """The record that the solver has ``kept`` of a solution; raises unless the solution is a strict minimum."""
    if kept is None or not solution.success:
        raise InvalidInputError(
            "covariance takes a solution with success of a regular problem that this solver found, got "
            f"{brief(solution)}; try solver.covariance(solver.solve(...)) with one and the same solver"
        )
    if solution.status != "minimum":
        raise _singular_information(f"its status is {solution.status!r}, expected 'minimum'", solution)
    return kept


def covariance_of(system: KKTSystem, solution: Any) -> Covariance:
    """The covariance of the states of an extremal with this KKT matrix; raises ``ConvergenceError`` if it is
    singular."""
    left, right, n, z = system.left, system.right, system.sizes.state_size, system.dimension
    ends, steps = np.concatenate([left[:1], right]), np.maximum(np.arange(len(right) + 1) - 1, 0)
    covariances = np.empty((len(ends), n, n))
    for nodes in np.array_split(np.arange(len(ends)), -(-len(ends) // NODES_AT_ONCE)):
        # Unit forces at a node move it by minus its covariance.
        slope = np.zeros((len(right), z + system.limits[0].shape[1], len(nodes), n))
        for place, node in enumerate(nodes):
            slope[steps[node], :z, place] = ends[node].T
        flat = slope.reshape(*slope.shape[:2], -1)
        result = system.solve(flat, np.zeros((len(ends), n, flat.shape[2])))
        if not result.smallest > CLEAR:
            raise _singular_information(f"the smallest pivot of its KKT matrix is {result.smallest:.3g}", solution)
        moves = result.step[:, :z].reshape(len(right), z, len(nodes), n)
        for place, node in enumerate(nodes):
            covariances[node] = -ends[node] @ moves[steps[node], :, place]
    return Covariance((covariances + covariances.mT) / 2, np.zeros((0, 0)), np.zeros((len(ends), n, 0)))


def _singular_information(why: str, solution: Any) -> ConvergenceError:
    """The error for an estimate that the measurements do not determine."""
    return ConvergenceError(
        f"the costs do not determine the estimate, which has no covariance: {why}; try more measurements, or an "
        "initial cost for what is known of the start and of the parameters",
        solution,
    )
