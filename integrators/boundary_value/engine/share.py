"""The share of a step that the linearised trajectory is followed: where points keep their size it ends at a diameter.

Where the constraints are dependent, as at rest of a system without drift, Newton's step is unbounded. On spheres and
rotations that shows in no residual: all points are as near to one another after any number of turns.
"""

from typing import Any

import numpy as np

from ....manifolds.numerics.tolerances import EPS, HALF
from ...problem.point_layout import PointLayout
from ..transcription.iterate import Data, Iterate
from .extent import Extent
from .kkt_system import Assembled, Step
from .transcription import Moves, Nodes

DIAMETER = 2.0  # times the size of a point, which is the radius of the sphere that it stays on
UNCHANGED = EPS**HALF  # relative: sizes that differ by less are the same, and entries that move by less do not


def followed(
    transcription: Any,
    nodes: Nodes,
    data: Data,
    iterate: Iterate,
    assembled: Assembled,
    step: Step,
    multipliers: np.ndarray,
) -> np.ndarray:
    """The share of a step, shape (B,), in which nothing that keeps its size moves by more than a diameter.

    That is judged array by array of the states, and of controls on a manifold, by their columns that keep their sizes
    or by all of them if the array keeps its own; nothing in a flat space keeps its size where the step leads.
    """
    n, unknowns, extent = nodes.dimension, iterate.unknowns, assembled.extent
    along = step.unknowns[..., :n]
    parts = [(nodes.layout, unknowns.centres, extent.support, along)]
    if (support := nodes.control_support(unknowns.controls)) is not None:
        moves = step.unknowns[..., n:].reshape(*unknowns.controls.shape[:3], -1)
        parts.append((nodes.control, unknowns.controls, support, moves))
    elif _all_small(nodes.layout, extent, step.largest[:, :n]):
        return np.ones(len(along))
    same = [_steady(*part[:2]) for part in parts]
    farthest = _turns(parts, same)
    if not np.any(farthest > DIAMETER):
        return np.ones(len(farthest))
    far = Moves(step.unknowns, multipliers, DIAMETER / np.maximum(farthest, DIAMETER), step.inner)
    moved = transcription.move(unknowns, assembled.blocks, far, data)
    reached = (moved.centres, moved.controls)[: len(parts)]
    kept = [a & _kept(*part[:2], after) for a, part, after in zip(same, parts, reached, strict=True)]
    return DIAMETER / np.maximum(_turns(parts, kept), DIAMETER)


def _all_small(layout: PointLayout, extent: Extent, moves: np.ndarray) -> bool:
    """Whether no coordinate moves by its share of a diameter, but for those that move nothing but arrays that are zero
    all along, as rates at rest: then nothing else is to be found out."""
    small = moves <= DIAMETER / np.sqrt(max(moves.shape[1], 1)) * extent.sizes
    if np.all(small):
        return True
    arrays = extent.values @ layout.in_arrays.T
    idle = ~((extent.support @ layout.in_arrays.T) @ arrays[..., None] > 0)[..., 0]
    return bool(np.all(small | idle))


Part = tuple[
    PointLayout, np.ndarray, np.ndarray, np.ndarray
]  # points, their support, and what their coordinates move by


def _turns(parts: list[Part], same: list[np.ndarray]) -> np.ndarray:
    """Largest move of an array of the points, relative to the size of those of its columns that are the same: (B,).

    Counted are the coordinates that move nothing but such columns.
    """
    largest = np.zeros(len(parts[0][1]))
    for (layout, points, support, moves), steady in zip(parts, same, strict=True):
        touched = np.einsum("bne,ce->cbn", support > UNCHANGED, layout.in_columns) > 0
        squares = np.einsum("b...e,ce->cb...", points * points, layout.in_columns)
        for k in range(len(layout.places)):
            own = steady & (layout.array_of_columns == k)[:, None]
            alone = np.any(touched & own[..., None], axis=0) & ~np.any(touched & ~own[..., None], axis=0)
            lengths = np.einsum("b...n,bn->b...", moves * moves, alone).reshape(len(moves), -1).max(axis=1)
            sizes = np.einsum("cb...,cb->b...", squares, own).reshape(len(moves), -1).max(axis=1)
            largest = np.maximum(largest, np.sqrt(np.where(sizes > 0, lengths / np.where(sizes > 0, sizes, 1.0), 0.0)))
    return largest


def _sizes(layout: PointLayout, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sizes of the columns of points, and of the arrays that they are in: (columns, B, ...)."""
    squares = np.einsum("...e,ce->c...", points * points, layout.in_columns)
    together = np.equal.outer(layout.array_of_columns, layout.array_of_columns).astype(float)
    return np.sqrt(squares), np.sqrt(np.einsum("ac,c...->a...", together, squares))


def _steady(layout: PointLayout, points: np.ndarray) -> np.ndarray:
    """Which columns have the same sizes along the trajectory, by themselves or as a whole array: (columns, B)."""
    both = [sizes.reshape(*sizes.shape[:2], -1) for sizes in _sizes(layout, points)]
    return np.any([np.ptp(sizes, axis=2) <= UNCHANGED * sizes.max(axis=2, initial=0.0) for sizes in both], axis=0)


def _kept(layout: PointLayout, points: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Which columns of points, by themselves or as a whole array, have the sizes that they had: (columns, B)."""
    pairs = zip(_sizes(layout, points), _sizes(layout, moved), strict=True)
    same = [np.abs(after - before) <= UNCHANGED * before for before, after in pairs]
    return np.any([np.all(own.reshape(*own.shape[:2], -1), axis=2) for own in same], axis=0)
