"""The share of a step that the linearised trajectory is followed: where points keep their size it ends at a diameter.

Where the constraints are dependent, as at rest of a system without drift, Newton's step is unbounded. On spheres and rotations
that shows in no residual: all points are as near to one another after any number of turns.
"""

from typing import Any

import numpy as np

from .layout import Layout
from .system import Assembled, Iterate, Step
from .transcription import Data, Moves, Nodes

DIAMETER = 2.0  # times the size of a point, which is the radius of the sphere that it stays on
ROUNDING = np.sqrt(np.finfo(float).eps)


def followed(
    transcription: Any, nodes: Nodes, data: Data, iterate: Iterate, assembled: Assembled, step: Step, multipliers: np.ndarray
) -> np.ndarray:
    """The share of a step, shape (B,), in which nothing that keeps its size moves by more than a diameter.

    That is judged array by array of the states, and of controls on a manifold; no array of a flat space keeps its size where
    the step leads.
    """
    n, unknowns, extent = nodes.dimension, iterate.unknowns, assembled.extent
    along = step.unknowns[..., :n]
    parts = [(nodes.layout, unknowns.centres, extent.support, along)]
    if (support := nodes.control_support(unknowns.controls)) is not None:
        moves = step.unknowns[..., n:].reshape(*unknowns.controls.shape[:3], -1)
        parts.append((nodes.control, unknowns.controls, support, moves))
    # Where no coordinate moves by its share of a diameter, nothing else is to be found out.
    elif np.all(np.abs(along).max(axis=1) <= DIAMETER / np.sqrt(max(n, 1)) * extent.along(extent.values)):
        return np.ones(len(along))
    turns = np.concatenate([_turns(*part) for part in parts])
    farthest = turns.max(axis=0, initial=0.0)
    if not np.any(farthest > DIAMETER):
        return np.ones(len(farthest))
    far = Moves(step.unknowns, multipliers, DIAMETER / np.maximum(farthest, DIAMETER), step.inner)
    moved = transcription.move(unknowns, assembled.blocks, far, data)
    reached = (moved.centres, moved.controls)[: len(parts)]
    kept = np.concatenate([_kept(*part[:2], after) for part, after in zip(parts, reached, strict=True)])
    return DIAMETER / np.maximum(np.where(kept, turns, 0.0).max(axis=0), DIAMETER)


def _turns(layout: Layout, points: np.ndarray, support: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Largest moves of the arrays of points, relative to their sizes, by coordinates that move nothing else: (arrays, B).

    Zero where the sizes differ along the trajectory.
    """
    found = np.zeros((len(layout.places), len(moves)))
    sizes = [size.reshape(len(moves), -1) for size in _sizes(layout, points)]
    same = [np.ptp(size, axis=1) <= ROUNDING * size.max(axis=1, initial=0.0) for size in sizes]
    if not np.any(same):
        return found
    touched = np.array([np.any(support[:, :, place] > ROUNDING, axis=2) for place in layout.places])
    alone = touched & (touched.sum(axis=0) == 1)
    for k in np.flatnonzero(np.any(same, axis=1)):
        lengths = np.sqrt(np.einsum("b...a,ba->b...", moves * moves, alone[k])).reshape(len(moves), -1).max(axis=1)
        turns = np.where(same[k], sizes[k].max(axis=1), 0.0)
        found[k] = np.where(turns > 0, lengths / np.where(turns > 0, turns, 1.0), 0.0)
    return found


def _sizes(layout: Layout, points: np.ndarray) -> list[np.ndarray]:
    return [np.sqrt(np.einsum("...e,...e->...", points[..., place], points[..., place])) for place in layout.places]


def _kept(layout: Layout, points: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Whether the arrays of points have the sizes that they had: (arrays, B)."""
    pairs = zip(_sizes(layout, points), _sizes(layout, moved), strict=True)
    same = [np.all((np.abs(b - a) <= ROUNDING * a).reshape(len(a), -1), axis=1) for a, b in pairs]
    return np.array(same, bool).reshape(len(layout.places), len(points))
