"""Units in which a trajectory's KKT system is free of the units that its problem is written in.

A coordinate of the state is measured by what the controls reach in it over the horizon. The cheapest way from rest to a
deviation ``e`` costs ``e' G^-1 e / 2`` with the Gramian ``G_{k+1} = A G_k A' + B W B'`` of the linearised steps, ``W``
the inverse curvature of the cost in the controls; both ends are fixed, so the smaller of the Gramians from the start
and from the end counts. One factor is left, the size of the trajectory: what its ends, its guess and the slope of the
cost ask for.
"""

from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np
from jaxtyping import Float

from ....aligned import scratch
from ....manifolds.numerics.tolerances import EPS, HALF
from .arrays import plain, whole

if TYPE_CHECKING:
    from .elimination import BlockSystem

SHARE = 1e-3  # of the natural unit: a coordinate that moves by less is not measured by its own size
SOFTEST = 1e-3  # of the largest curvature of a coordinate, in its unit: those of less are shifted by as much


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
    curved: np.ndarray | bool = True,
    room: np.ndarray | float = np.inf,
) -> Units:
    """Units from the linearised trajectories, their displacements in the states and the sizes of their controls.

    ``gradient``: of the cost alone; ``m`` counts all controls of a step; ``values``: sizes of coordinates that nothing
    moves; ``curved``: False where curvature in the controls is rounding, shape (B,); ``room``: how far inequalities let
    the controls go, (B, m), beyond which no trajectory is large whose controls are all confined.
    """
    count, n = system.left.shape[1:3]
    curvature = np.abs(np.diagonal(system.hessian, axis1=2, axis2=3)).sum(axis=1)
    slope, own = np.abs(gradient).sum(axis=1), np.concatenate([states, controls], axis=1)
    convex = (np.all(curvature[:, n:] > 0, axis=1) & curved)[:, None]
    with np.errstate(all="ignore"):
        push = np.where(convex, 1 / np.sqrt(curvature[:, n:]), controls)
        reach = np.concatenate([_reach(system, count * push**2), push], axis=1)
        asked = np.where(reach > 0, own / reach, 0.0)
        asked = np.maximum(asked, np.where(convex, slope * reach / (1 + curvature * reach**2), 0.0))
        most = np.where(convex, room / push, np.inf).max(axis=1, initial=0.0)
        size = np.minimum(asked.max(axis=1), np.where(most > 0, most, np.inf))
        unknowns = np.maximum(own, size[:, None] * reach)
        unknowns = _or_one(np.where(unknowns > 0, unknowns, values))
        cost = np.max(np.maximum(curvature * unknowns**2, slope * unknowns), axis=1) / count
    return Units(unknowns, unknowns[:, :n], _or_one(cost))


def typical_curvatures(curvature: Float[np.ndarray, "B z"], units: Units) -> Float[np.ndarray, "B z"]:
    """Typical curvatures of the coordinates in their units, in which Hessians are shifted."""
    diagonal = curvature * units.unknowns * units.unknowns / units.cost[:, None]
    floor = SOFTEST * diagonal.max(axis=1, keepdims=True)
    return np.where(floor > 0, np.maximum(diagonal, floor), 1.0)


def _or_one(size: np.ndarray) -> np.ndarray:
    return np.where((size > 0) & np.isfinite(size), size, 1.0)


def _reach(system: "BlockSystem", variance: Float[np.ndarray, "B m"]) -> Float[np.ndarray, "B n"]:
    """How far controls of this variance move each coordinate of a node between two fixed ends, zero where it is
    rounding."""
    reached = _variances(system, variance)
    # One step has no node between its ends.
    between = np.minimum(reached[:, 0, :, :-1], reached[:, 1, :, 1:]) if reached.shape[3] > 1 else reached[:, 0]
    largest = between.max(axis=2)
    reach, terms = np.sqrt(np.where(np.isfinite(largest), np.maximum(largest, 0.0), 0.0)).transpose(1, 0, 2)
    return np.where(reach > EPS**HALF * terms, reach, 0.0)


def _variances(system: "BlockSystem", variance: Float[np.ndarray, "B m"]) -> np.ndarray:
    """Variances at the far ends of the steps from either end, and those of their terms, shape ``(B, 2, 2, N, n)``.

    A step whose near end is singular leaves what is not finite.
    """
    from . import scaling_kernels

    batch, count, n, z = system.left.shape
    left, right, variance = plain(system.left), plain(system.right), plain(variance)
    width = whole(n)
    shapes = (n, 2 * width), (n, n), (n,), (z, width), (2, z, width), (2, n, width), (n, width)
    work, swaps, out = tuple(scratch(shapes)), np.empty(n, np.int64), np.empty((batch, 2, 2, count, n))
    for m in range(batch):
        scaling_kernels.gramians(left[m], right[m], variance[m], work, swaps, out[m])
    return out
