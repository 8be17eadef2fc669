"""A Riccati recursion over the steps of an extremal, with constraints.

The cost of the steps from a node on, as a function of the deviation ``y`` of the state there, is ``y' P y / 2`` beside
its linear part, on the deviations that later controls can still correct: those with ``C y = 0``. Backwards over the
steps, ``d`` minimises ``d' (H + R' P R) d / 2`` subject to ``L d = y``, ``C R d = 0`` and ``J d = 0``, with the
derivatives ``L`` and ``R`` of both ends of a step, and ``J`` of its active inequalities [Laine, Tomlin 2019]. A
prescribed end is ``C`` of the last node, so that no stiffness stands for a constraint.
"""

from typing import NamedTuple, final

import numpy as np

from ....manifolds import ConvergenceError
from ..transcription.kkt_system import KKTSystem

CONSTRAINT_RANK = 1e-10  # relative: smaller singular values of scaled constraints are rounding


@final
class Law(NamedTuple):
    """Results of the recursion."""

    response: np.ndarray  # (N, z, n): of the unknowns of the steps to deviations of their first nodes
    curvature: np.ndarray  # (N + 1, n, n)
    complete: np.ndarray  # (N + 1,): whether all deviations can be corrected


def recursion(system: KKTSystem, held: list[np.ndarray]) -> Law:
    """The recursion from the last node to the first, in units of the scaling.

    ``held``: derivatives of the active inequalities of each step by its unknowns.
    """
    unknown, node, cost = system.scale
    hessian = system.hessian * unknown[:, None] * unknown / cost
    left, right = (ends * unknown / node[:, None] for ends in (system.left, system.right))
    count, n, z = left.shape
    response, curvature = np.zeros((count, z, n)), np.zeros((count + 1, n, n))
    wanted = np.eye(n)[system.fixed[1] > 0]
    complete = np.full(count + 1, len(wanted) == 0)
    for k in reversed(range(count)):
        limits = held[k] * unknown
        whole = hessian[k] + right[k].T @ curvature[k + 1] @ right[k]
        response[k], wanted = _step(whole, left[k], np.concatenate([wanted @ right[k], limits]))
        response[k, np.unique(np.nonzero(limits[np.count_nonzero(limits, axis=1) == 1])[1])] = 0.0  # at bounds
        curvature[k] = response[k].T @ whole @ response[k]
        complete[k] = len(wanted) == 0
    curvature = cost * (curvature + curvature.mT) / 2 / np.outer(node, node)
    return Law(response * unknown[:, None] / node, curvature, complete)


def _step(hessian: np.ndarray, left: np.ndarray, asked: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Responses of the unknowns of a step, and constraints on deviations of its first node that no control can meet.

    ``asked``: constraints on the unknowns.
    """
    n = len(left)
    basis, triangle = np.linalg.qr(left.T, mode="complete")
    begin, free = basis[:, :n] @ np.linalg.inv(triangle[:n].T), basis[:, n:]
    sizes = np.linalg.norm(asked, axis=1, keepdims=True)
    asked = asked[sizes[:, 0] > 0] / sizes[sizes[:, 0] > 0]
    rows, values, columns = np.linalg.svd(asked @ free)
    rank = int(np.sum(values > CONSTRAINT_RANK))
    needed = asked @ begin
    lost = rows[:, rank:].T @ needed
    _, remaining, directions = np.linalg.svd(lost)
    lost = directions[: np.sum(remaining > CONSTRAINT_RANK)]
    met = columns[:rank].T @ ((rows[:, :rank].T @ needed) / values[:rank, None])
    base, rest = begin - free @ met, free @ columns[rank:].T
    try:
        np.linalg.cholesky(rest.T @ hessian @ rest)
    except np.linalg.LinAlgError:
        raise ConvergenceError(
            "the optimal cost from a node on has no minimum in the controls to second order; try more steps"
        ) from None
    response = base - rest @ np.linalg.solve(rest.T @ hessian @ rest, rest.T @ (hessian @ base))
    return response @ (np.eye(n) - lost.T @ lost), lost
