"""Units in which a trajectory's KKT system is free of the units that its problem is written in.

A coordinate of the state is measured by what the controls reach in it over the horizon. The cheapest way from rest to a
deviation ``e`` costs ``e' G^-1 e / 2`` with the Gramian ``G_{k+1} = A G_k A' + B W B'`` of the linearised steps, ``W`` the
inverse curvature of the cost in the controls; both ends are fixed, so the smaller of the Gramians from the start and from the
end counts. One factor is left, the size of the trajectory: what its ends, its guess and the slope of the cost ask for.
"""

from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np
from jaxtyping import Float

from .arrays import plain, whole

if TYPE_CHECKING:
    from .elimination import BlockSystem

SHARE = 1e-3  # of the natural unit: a coordinate that moves by less is not measured by its own size
NOISE = 0.5  # power of the machine epsilon: what is reached less than this, beside the terms of it, is not reached


@final
class Units(NamedTuple):
    """Natural sizes of a step of the stages' unknowns and of the nodes' gaps, and of the cost of a stage."""

    unknowns: Float[np.ndarray, "B z"]
    nodes: Float[np.ndarray, "B n"]
    cost: Float[np.ndarray, " B"]


def natural_units(
    system: "BlockSystem",
    gradient: Float[np.ndarray, "B N z"],
    states: Float[np.ndarray, "B n"],
    controls: Float[np.ndarray, "B m"],
    values: Float[np.ndarray, "B z"] | float = 1.0,
) -> Units:
    """Units from the linearised trajectories, their displacements in the states and the sizes of their controls.

    ``gradient``: of the cost alone; ``m`` counts all controls of a step; ``values``: sizes of coordinates that nothing moves.
    """
    count, n = system.left.shape[1:3]
    curvature = np.abs(np.diagonal(system.hessian, axis1=2, axis2=3)).sum(axis=1)
    slope, own = np.abs(gradient).sum(axis=1), np.concatenate([states, controls], axis=1)
    convex = np.all(curvature[:, n:] > 0, axis=1)[:, None]
    with np.errstate(all="ignore"):
        push = np.where(convex, 1 / np.sqrt(curvature[:, n:]), controls)
        reach = np.concatenate([_reach(system, count * push**2), push], axis=1)
        asked = np.where(reach > 0, own / reach, 0.0)
        asked = np.maximum(asked, np.where(convex, slope * reach / (1 + curvature * reach**2), 0.0))
        unknowns = np.maximum(own, asked.max(axis=1)[:, None] * reach)
        unknowns = _or_one(np.where(unknowns > 0, unknowns, values))
        cost = np.max(np.maximum(curvature * unknowns**2, slope * unknowns), axis=1) / count
    return Units(unknowns, unknowns[:, :n], _or_one(cost))


def _or_one(size: np.ndarray) -> np.ndarray:
    return np.where((size > 0) & np.isfinite(size), size, 1.0)


def _reach(system: "BlockSystem", variance: Float[np.ndarray, "B m"]) -> Float[np.ndarray, "B n"]:
    """How far controls of this variance move each coordinate of a node between two fixed ends, zero where it is rounding."""
    n = system.left.shape[2]
    found, parts = [], []
    for near, far in _both_ways(system):
        found.append(_gramians(near, far, variance))
        # Of what does not cancel: A = F N^-1 and B = F_u - A N_u with the sizes of their terms.
        moved = np.abs(far[..., :n]) @ np.abs(_inverse(near[..., :n]))
        pushed = np.abs(far[..., n:]) + moved @ np.abs(near[..., n:])
        still = np.concatenate([np.broadcast_to(np.eye(n), moved.shape), np.zeros_like(pushed)], axis=3)
        parts.append(_gramians(still, np.concatenate([moved, pushed], axis=3), variance))
    reach, terms = (np.sqrt(_between(sizes)) for sizes in (found, parts))
    return np.where(reach > np.finfo(float).eps ** NOISE * terms, reach, 0.0)


def _between(sizes: list[np.ndarray]) -> np.ndarray:
    """The largest over the nodes of the smaller of the variances from both ends, zero where that is not finite."""
    first, last = sizes
    # One step has no node between its ends.
    between = np.minimum(first[:, :-1], last[:, -2::-1]).max(axis=1) if first.shape[1] > 1 else first[:, 0]
    return np.where(np.isfinite(between), np.maximum(between, 0.0), 0.0)


def _inverse(matrices: np.ndarray) -> np.ndarray:
    """Inverses, NaN where there is none."""
    regular = np.abs(np.linalg.det(matrices)) > 0
    out = np.full_like(matrices, np.nan)
    out[regular] = np.linalg.inv(matrices[regular])
    return out


def _both_ways(system: "BlockSystem") -> list[tuple[np.ndarray, np.ndarray]]:
    """Near and far ends of the steps, from the start forward and from the end backward."""
    return [(system.left, system.right), (system.right[:, ::-1], system.left[:, ::-1])]


def _gramians(near: np.ndarray, far: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Diagonals of the Gramians after each step, shape ``(B, N, n)``."""
    from . import scaling_kernels

    batch, count, n, z = near.shape
    near, far = plain(near), plain(far)
    work = np.empty((n, 2 * whole(n))), np.empty((n, n)), np.empty((1, n)), np.empty((n, n)), np.empty((n, z - n))
    out = np.zeros((batch, count + 1, n, n))
    for m in range(batch):
        scaling_kernels.gramians(near[m], far[m], np.diag(variance[m]), work, np.empty(n, np.int64), out[m])
    return np.diagonal(out[:, 1:], axis1=2, axis2=3)
