"""Units in which a trajectory's KKT system is free of the units that its problem is written in.

A coordinate of the state is measured by what the controls reach in it over the horizon. The cheapest way from rest to a
deviation ``e`` costs ``e' G^-1 e / 2`` with the Gramian ``G_{k+1} = A G_k A' + B W B'`` of the linearised steps, ``W``
the inverse curvature of the cost in the controls; both ends are fixed, so the smaller of the Gramians from the start
and from the end counts. One factor is left, the size of the trajectory: what controls have to make up for of the ends
that a drifting trajectory misses, and what the slope of the cost asks for. What drifts by itself asks for nothing:
controls hardly move a state at the end of a chain. No unit is next to nothing: not beside what each step makes of the
units of others, nor beside what costs as much as all others do.
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
    from . import scaling_kernels

    (batch, count, n, z), (hessian, left, right, _, gap, *ends) = system.left.shape, system
    known, free, bent = np.empty((batch, z)), np.empty(controls.shape), np.empty(batch, bool)
    known[:], free[:], bent[:] = values, room, curved
    own = np.concatenate([states, controls], axis=1), known, free
    unknowns, nodes, cost = np.empty((batch, z)), np.empty((batch, n)), np.empty(batch)
    work, swaps = tuple(scratch(tuple(unit_shapes(count, n, z).values()))), np.empty(n, np.int64)
    scaling_kernels.units(
        tuple(map(plain, (hessian, left, right, gradient, gap, *ends))),
        tuple(map(plain, own)),
        bent,
        work,
        swaps,
        EPS**HALF,
        (unknowns, nodes, cost),
    )
    return Units(unknowns, nodes, cost)


def unit_shapes(count: int, n: int, z: int) -> dict[str, tuple[int, ...]]:
    """Shapes of what the kernel works in."""
    width = whole(n)
    solved = {"equations": (n, 2 * width), "lower": (n, n), "weights": (n,), "turned": (z, width)}
    sums = {"terms": (2, z, width), "gramian": (2, n, width), "images": (n, width), "drifts": (3, n), "gains": (n, n)}
    return {**solved, **sums, "of_unknowns": (5, z), "gramians": (4, count, n)}


def typical_curvatures(curvature: Float[np.ndarray, "B z"], units: Units) -> Float[np.ndarray, "B z"]:
    """Typical curvatures of the coordinates in their units, in which Hessians are shifted."""
    diagonal = curvature * units.unknowns * units.unknowns / units.cost[:, None]
    floor = SOFTEST * diagonal.max(axis=1, keepdims=True)
    return np.where(floor > 0, np.maximum(diagonal, floor), 1.0)
