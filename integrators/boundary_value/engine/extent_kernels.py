"""Compiled pass over a trajectory and its KKT system that finds what is largest in them."""

import numpy as np

from .factors import compiled, inner


@inner
def _larger(a: float, b: float) -> float:
    """The larger of both; what is not a number stays."""
    return b if b > a or b != b else a


@inner
def _node(nodes: np.ndarray, frames: np.ndarray, coordinates: np.ndarray, gap: np.ndarray, m: int, out: tuple) -> None:
    """What the node of these entries raises."""
    (highest, lowest, support, missing, lacking, held), size = out[:6], nodes.size
    for e in range(size):
        highest[m, e], lowest[m, e] = _larger(highest[m, e], nodes[e]), _larger(lowest[m, e], -nodes[e])
    for a in range(gap.size):
        missing[m, a] += abs(gap[a])
        held[m] += coordinates[a] * gap[a]
        lacking[m, a] = _larger(lacking[m, a], abs(gap[a]))
        for e in range(size):
            support[m, a, e] = _larger(support[m, a, e], abs(frames[a, e]))


@inner
def _step(blocks: tuple, before: np.ndarray, after: np.ndarray, m: int, k: int, out: tuple) -> None:
    """What step k raises, with the multipliers before and after it."""
    (hessian, left, right, slope, gradient), (parts, slopes, curvature, sums) = blocks, out[6:]
    for i in range(slope.shape[2]):
        sums[0, i], sums[1, i] = 0.0, 0.0
    for a in range(left.shape[2]):
        for i in range(slope.shape[2]):
            sums[0, i] += left[m, k, a, i] * before[a]
            sums[1, i] += right[m, k, a, i] * after[a]
    for i in range(slope.shape[2]):
        parts[m, i] = _larger(parts[m, i], abs(gradient[m, k, i]) + abs(sums[0, i]) + abs(sums[1, i]))
        slopes[m, i] = _larger(slopes[m, i], abs(slope[m, k, i]))
        curvature[m, i] = _larger(curvature[m, i], abs(hessian[m, k, i, i]))


@compiled
def survey(first: int, last: int, trajectory: tuple, blocks: tuple, out: tuple) -> None:
    """Survey the members ``first`` to ``last``.

    ``trajectory``: nodes, frames, coordinates of the multipliers, gaps; ``blocks``: Hessian, left, right, slope, gradient of the
    cost; ``out``: the fields of the extent, which come as the least that they can be, and room for two sums.
    """
    nodes, frames, coordinates, gap = trajectory
    for m in range(first, last):
        for k in range(nodes.shape[1]):
            _node(nodes[m, k], frames[m, k], coordinates[m, k], gap[m, k], m, out)
        for k in range(blocks[0].shape[1]):
            _step(blocks, coordinates[m, k], coordinates[m, k + 1], m, k, out)
