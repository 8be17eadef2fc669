"""Block elimination of a trajectory's KKT system: cost linear in the number of steps, many trajectories side by
side."""

from typing import NamedTuple, final

import numpy as np
from jaxtyping import Bool, Float

from ....aligned import scratch
from ....compute.binding.block_elimination import BlockArrays, BlockResult, solve_blocks
from ....compute.binding.library import PARTS_ON_CORE
from ....compute.threads import in_threads
from ....manifolds.numerics.tolerances import EPS, REGULAR
from .arrays import plain, whole
from .scaling import Units

WEIGHT = 2.0**8  # times the number of steps, the curvature of the cost of one being about 1
MANY = 1e3  # equations of nodes: with more, and so with larger weights, rounding hides more


@final
class BlockSystem(NamedTuple):
    """Linear systems in the steps ``d_k`` of the stages and those ``c_k`` of the nodes' multipliers, N stages, N + 1
    nodes:

        hessian_k d_k + left_k' c_k - right_k' c_{k+1} = -slope_k
        left_k d_k - right_{k-1} d_{k-1}               = -gap_k

    with no ``left`` at the last node and no ``right`` before the first. Where ``fixed_start`` or ``fixed_end`` is 0 the
    equation of that node's coordinate is ``c = 0`` instead. B systems, k right-hand sides; the upper triangles of the
    Hessians are read.
    """

    hessian: Float[np.ndarray, "B N z z"]
    left: Float[np.ndarray, "B N n z"]
    right: Float[np.ndarray, "B N n z"]
    slope: Float[np.ndarray, "B N z k"]
    gap: Float[np.ndarray, "B N+1 n k"]
    fixed_start: Float[np.ndarray, "B n"]
    fixed_end: Float[np.ndarray, "B n"]


@final
class BlockSolution(NamedTuple):
    """Solutions of block systems, and the inertia of their matrices.

    ``finite``: which columns are found, the others are NaN; ``negative``: number of negative eigenvalues; ``smallest``:
    size of the smallest pivot, rows scaled to one size; ``curvature``, ``size``: ``sum_k d_k' (H_k + shift S) d_k`` and
    ``sum_k d_k' S d_k`` of the first column, in units; ``largest``: its largest step of each unknown.
    """

    steps: Float[np.ndarray, "B N z k"]
    multipliers: Float[np.ndarray, "B N+1 n k"]
    finite: Bool[np.ndarray, "B k"]
    negative: Float[np.ndarray, " B"]
    smallest: Float[np.ndarray, " B"]
    curvature: Float[np.ndarray, " B"]
    size: Float[np.ndarray, " B"]
    largest: Float[np.ndarray, "B z"]


def eliminate(
    system: BlockSystem,
    units: Units | None = None,
    shift: Float[np.ndarray, " B"] | None = None,
    scales: Float[np.ndarray, "B z"] | None = None,
) -> BlockSolution:
    """Solve by eliminating ``(c_k, d_k)`` stage after stage; each leaves a Schur complement on the next node.

    It is eliminated in ``units``; there the Hessians are raised by ``shift diag(scales)``, ones by default. A system
    that is singular, or not finite, has the solution NaN.

    A pivot is singular where the problem up to its node, with a free end there, has a focal point, as a quarter turn
    away on a sphere. So ``weight (|right_k d_k|^2 - |left_k d_k|^2) / 2`` is added to the cost of each stage: by the
    equations of the nodes these cancel one another, the solution and the inertia stay, but each of those free ends is
    held by the weight.
    """
    if "elimination" in PARTS_ON_CORE:
        return _eliminate_on_core(system, units, shift, scales)
    from . import elimination_kernels

    batch, count, n, z = system.left.shape
    columns = system.slope.shape[3]
    if units is None:
        units = Units(np.ones((batch, z)), np.ones((batch, n)), np.ones(batch))
    raised = (
        np.zeros(batch) if shift is None else plain(shift),
        np.ones((batch, z)) if scales is None else plain(scales),
    )
    given = tuple(map(plain, system)), (plain(units.unknowns), 1 / units.nodes, plain(units.cost)), raised
    steps, multipliers = np.empty((batch, count, z, columns)), np.empty((batch, count + 1, n, columns))
    finite, largest = np.empty((batch, columns), bool), np.zeros((batch, z))
    negative, smallest, curvature, size = told = tuple(np.empty((4, batch)))
    out = steps, multipliers, finite, largest

    def run(part: range) -> None:
        elimination_kernels.solve(part.start, part.stop, *given, *workspace(count, n, z, columns), out, told)

    in_threads(run, batch, count * (n + z) ** 2 * (n + z + columns))
    return BlockSolution(steps, multipliers, finite, negative, smallest, curvature, size, largest)


def _eliminate_on_core(
    system: BlockSystem, units: Units | None, shift: np.ndarray | None, scales: np.ndarray | None
) -> BlockSolution:
    """The same, by the compiled core."""
    batch, _, n, z = system.left.shape
    if units is None:
        units = Units(np.ones((batch, z)), np.ones((batch, n)), np.ones(batch))
    shift = np.zeros(batch) if shift is None else shift
    scales = np.ones((batch, z)) if scales is None else scales
    given = [plain(a) for a in (*system, units.unknowns, units.nodes, scales)]
    found: list[BlockResult] = []
    for k in range(batch):
        found.append(solve_blocks(BlockArrays(*(a[k] for a in given)), float(units.cost[k]), float(shift[k])))
    parts = ("step", "multipliers", "finite", "negative", "smallest", "curvature", "size", "largest_step")
    return BlockSolution(*(np.array([getattr(own, part) for own in found]) for part in parts))


def work_shapes(count: int, n: int, z: int, columns: int) -> dict[str, tuple[int, ...]]:
    """Shapes of what the kernels work in: in one step, and the factors of all steps, whose rows follow one another."""
    rows, pivots = z + 2 * n, count * (z + n) + n
    width = whole(rows + columns)
    own = {"ends": (2 * n, whole(z)), "front": (rows, width), "columns": (columns, 2 * rows), "line": (4, width)}
    sizes = {"pivots": (pivots,), "order": (rows,), "sizes": (count, width)}
    return {**own, "kept": (pivots, width), "upper": (rows, width), **sizes}


def workspace(count: int, n: int, z: int, columns: int) -> tuple[float, tuple, tuple]:
    """The weight, and arrays that the kernels work in."""
    *work, kept, upper, pivots, order, sizes = scratch(tuple(work_shapes(count, n, z, columns).values()))
    for array in work:
        array.fill(0.0)
    return WEIGHT * count, tuple(work), (kept, upper, pivots.view(int), order.view(int), sizes)


def is_strict_minimum(solution: BlockSolution, count: int) -> np.ndarray:
    """Whether the Hessian is positive definite on the null space of the ``count`` constraints, beyond rounding, shape
    ``(B,)``.

    This is the second-order sufficient condition of a strict local minimum. By Sylvester's law of inertia it holds
    exactly if the pivots have as many negative eigenvalues as there are node equations, ``(N + 1) n``, and none is
    zero.
    """
    return positive_definite(solution.negative, solution.smallest, count)


def positive_definite(negative: np.ndarray, smallest: np.ndarray, count: int) -> np.ndarray:
    """The same from the number of negative eigenvalues of the pivots and the size of the smallest of these."""
    return (negative == count) & (smallest > clear_pivot(count))


def clear_pivot(count: int) -> float:
    """What a pivot that is more than rounding exceeds."""
    return EPS**REGULAR * max(1.0, count / MANY)
