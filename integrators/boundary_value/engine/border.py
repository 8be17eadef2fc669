"""The border that couples the ends of trajectories to each other: elimination of each, then a small dense system.

Each trajectory is eliminated with its start prescribed to move by ``e``, and its end free, with a linear cost ``f`` of
what that moves by, ``w = R d``: with both prescribed an arc without controls would have dependent equations. The end is
held by a weight ``rho |w|^2 / 2``, which the border takes back, so that focal points are no singular pivots. What is
left is one system in ``(e, w, f)`` of all trajectories and the steps of the multipliers of ``b(ends) = 0``, with ``L``
the curvature of the costs of the ends and of the multipliers times b,

    (L_ee - C_e) e + L_ew w - C_f f + B_e' dmu = c_0,     L_we e + (L_ww - rho) w - f + B_w' dmu = 0,
    W_e e - w + W_f f = -W_0,                             B_e e + B_w w = -b.

Prescribed coordinates of the start have no ``e``, those of the end a ``w`` that is known. By Haynsworth's formula the
inertia of the whole is that of the eliminated systems and of this one.
"""

from typing import NamedTuple, final

import numpy as np

from ..transcription.iterate import Iterate
from .augmented import augmented, of_lagrangian
from .conditions import Conditions
from .coupling import Coupled
from .elimination import WEIGHT, BlockSystem, eliminate
from .kkt_system import Assembled
from .transcription import Blocks

ROUNDS = 3  # of scaling rows and columns to one size


@final
class Response(NamedTuple):
    """How a trajectory follows its ends: Newton's step in column 0, then per unit of e, then per unit of f."""

    steps: np.ndarray  # (B, N, z, 1 + p + n)
    multipliers: np.ndarray  # (B, N + 1, n, 1 + p + n)
    start: np.ndarray  # (B, p, 1 + p + n): multipliers of the free coordinates of the start
    end: np.ndarray  # (B, n, 1 + p + n): what the end moves by
    wanted: np.ndarray  # (B, n): what its prescribed coordinates are to move by, zero for the others
    weight: np.ndarray  # (B, n)
    free: tuple[np.ndarray, np.ndarray]  # places of the free coordinates of both ends
    negative: np.ndarray
    smallest: np.ndarray


def responses(conditions: Conditions, iterate: Iterate, assembled: Assembled, shift: np.ndarray | None) -> Response:
    """How the trajectory of the linearised conditions follows its ends, the Hessians raised by a shift.

    Without one, the multipliers of the inequalities are unknowns, by which the inertia is not lost in their stiffness.
    """
    blocks = assembled.blocks if shift is not None else of_lagrangian(conditions, iterate, assembled)
    first, last = (
        np.flatnonzero(mask == 0) for mask in (conditions.ends.start_coordinates, conditions.ends.end_coordinates)
    )
    right, z = blocks.right[:, -1], blocks.hessian.shape[3]
    after = np.zeros(right.shape[:2]) if blocks.inner is None else blocks.inner.after[:, -1]
    units = conditions.measured
    weight = WEIGHT * blocks.left.shape[1] * units.cost[:, None] / units.nodes**2
    system, others = _with_columns(conditions.system(iterate, assembled), blocks, (right, after, weight), first), 0
    if shift is None and iterate.slacks is not None:
        limits = conditions.transcription.limits(blocks, conditions.data.steps)
        none = np.zeros((*system.slope.shape[:2], limits.shape[2], system.slope.shape[3]))
        system = system._replace(slope=np.concatenate([system.slope, none], axis=2))
        system, units = augmented(system, units, limits, blocks.inequalities, iterate.slacks)
        others = limits.shape[1] * limits.shape[2]  # each has a negative eigenvalue of its own
    found = eliminate(system, units, shift)
    steps, multipliers = found.steps[:, :, :z], found.multipliers
    end = right @ steps[:, -1]
    end[..., 0] += after
    own = multipliers[:, 0, first], end, assembled.asked[:, -1], weight
    return Response(steps, multipliers, *own, (first, last), found.negative - others, found.smallest)


def _with_columns(
    system: BlockSystem, blocks: Blocks, end: tuple[np.ndarray, np.ndarray, np.ndarray], first: np.ndarray
) -> BlockSystem:
    """The system of blocks with a start that is prescribed, a weight on the free end, and columns for what both move
    by."""
    (right, after, weight), p = end, len(first)
    hessian, columns = np.array(blocks.hessian), 1 + p + right.shape[1]
    hessian[:, -1] += right.mT @ (weight[:, :, None] * right)
    slope, gap = (np.zeros((*a.shape[:3], columns)) for a in (system.slope, system.gap))
    slope[..., 0], gap[..., 0] = system.slope[..., 0], system.gap[..., 0]
    slope[:, -1, :, 0] += np.einsum("bqz,bq->bz", right, weight * after)
    slope[:, -1, :, 1 + p :] = right.mT
    gap[:, 0, first, 1 + np.arange(p)] = -1.0
    none = np.zeros_like(system.fixed_end)
    return BlockSystem(hessian, system.left, system.right, slope, gap, np.ones_like(none), none)


class Solved(NamedTuple):
    """What the ends move by, ``f``, steps of the multipliers; number of negative eigenvalues, and size of the
    smallest."""

    moves: np.ndarray  # (B, p + q)
    forces: np.ndarray  # (B, n)
    multipliers: np.ndarray  # (B, r)
    negative: np.ndarray
    smallest: np.ndarray


def solve_border(
    parts: list[Response], places: tuple[np.ndarray, np.ndarray], coupled: Coupled, sizes: np.ndarray
) -> Solved:
    """Solve for what all ends move by.

    ``places`` of the free coordinates of all starts and of all ends among those of all nodes there; ``sizes`` of the
    unknowns, (B, p + q + n + r).
    """
    p, q, n = len(places[0]), len(places[1]), sum(part.end.shape[1] for part in parts)
    batch, total, free = len(sizes), sizes.shape[1], np.concatenate(places)
    matrix, side = np.zeros((batch, total, total)), np.zeros((batch, total))
    e, w, f, mu = np.split(np.arange(total), np.cumsum([p, q, n]))
    matrix[:, : p + q, : p + q] = coupled.curvature[:, free][:, :, free]
    matrix[:, mu, : p + q] = coupled.jacobian[:, :, free]
    matrix[:, : p + q, mu] = coupled.jacobian[:, :, free].mT
    side[:, mu] = -coupled.values
    for part in parts:
        count, last = 1 + len(part.free[0]), part.free[1]
        (own, e), (moved, w), (force, f) = (
            np.split(a, [k]) for a, k in ((e, count - 1), (w, len(last)), (f, part.end.shape[1]))
        )
        matrix[:, own[:, None], own] -= part.start[..., 1:count]
        matrix[:, own[:, None], force] -= part.start[..., count:]
        matrix[:, force[:, None], own] += part.end[..., 1:count]
        matrix[:, force[:, None], force] += part.end[..., count:]
        matrix[:, moved, force[last]] = matrix[:, force[last], moved] = -1.0
        matrix[:, moved, moved] -= part.weight[:, last]
        side[:, own], side[:, force] = part.start[..., 0], part.wanted - part.end[..., 0]
    found, negative, smallest = np.full(side.shape, np.nan), np.zeros(batch, int), np.zeros(batch)
    for k in range(batch):
        found[k], negative[k], smallest[k] = _solved(matrix[k], side[k], sizes[k])
    moves, _, forces, multipliers = np.split(found, np.cumsum([p + q, 0, n]), axis=1)
    return Solved(moves, forces, multipliers, negative, smallest)


def _solved(matrix: np.ndarray, side: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, int, float]:
    """Solution of a symmetric system, number of its negative eigenvalues, and the smallest one, rows scaled to one
    size."""
    if not (np.all(np.isfinite(matrix)) and np.all(np.isfinite(side))):
        return np.full(side.shape, np.nan), 0, 0.0
    scale = np.array(sizes)
    scaled = matrix * np.outer(scale, scale)
    for _ in range(ROUNDS):
        rows = np.sqrt(np.max(np.abs(scaled), axis=1, initial=0.0))
        own = np.where(rows > 0, 1 / np.where(rows > 0, rows, 1.0), 1.0)
        scaled, scale = scaled * np.outer(own, own), scale * own
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2)
    smallest = float(np.min(np.abs(values), initial=np.inf))
    if smallest == 0:
        return np.full(side.shape, np.nan), int(np.sum(values < 0)), 0.0
    found = scale * (vectors @ (vectors.T @ (scale * side) / values))
    return found, int(np.sum(values < 0)), smallest
