"""The linear system of a Newton step along a trajectory, solved by the compiled core."""

from ctypes import byref
from typing import NamedTuple, final

import numpy as np

from ...errors import InvalidInputError
from ..working_memory import scratch
from .library import BYTES, FLOAT, address_of, best_instruction_set, library
from .structs import BlockSolutionStruct, BlockSystemStruct


@final
class BlockArrays(NamedTuple):
    """A linear system as ``retrax_core.h`` has it: N stages of z unknowns, N + 1 nodes of n equations, k right-hand
    sides."""

    hessian: np.ndarray  # (N, z, z)
    left: np.ndarray  # (N, n, z)
    right: np.ndarray  # (N, n, z)
    slope: np.ndarray  # (N, z, k)
    defect: np.ndarray  # (N + 1, n, k)
    fixed_start: np.ndarray  # (n,)
    fixed_end: np.ndarray  # (n,)
    stage_scale: np.ndarray  # (z,)
    node_scale: np.ndarray  # (n,)
    regularised: np.ndarray  # (z,)


@final
class BlockResult(NamedTuple):
    """The solution, and the inertia of the matrix: number of negative eigenvalues and size of the smallest pivot."""

    step: np.ndarray  # (N, z, k)
    multipliers: np.ndarray  # (N + 1, n, k)
    finite: np.ndarray  # (k,)
    largest_step: np.ndarray  # (z,)
    negative: int
    smallest: float
    curvature: float
    size: float


def block_workspace(stages: int, node_size: int, stage_size: int, columns: int) -> int:
    """The bytes of workspace of an elimination."""
    return int(library().retrax_block_workspace(stages, node_size, stage_size, columns))


def solve_blocks(
    arrays: BlockArrays, cost_scale: float = 1.0, regularisation: float = 0.0, instruction_set: int | None = None
) -> BlockResult:
    """Return the solution of a linear system.

    ``cost_scale``, ``regularisation``: the scaling factor of the cost of a stage, and the factor of the diagonal
    ``regularised``.
    """
    if arrays.left.ndim != 3 or arrays.slope.ndim != 3 or not arrays.left.size * arrays.slope.shape[2]:
        raise InvalidInputError(
            f"a linear system has blocks (stages, n, z) and slopes (stages, z, columns) that are not empty, got "
            f"{arrays.left.shape} and {arrays.slope.shape}"
        )
    (count, n, z), columns = arrays.left.shape, arrays.slope.shape[2]
    shapes = (count, z, z), (count, n, z), (count, n, z), (count, z, columns), (count + 1, n, columns)
    vectors = (n,), (n,), (z,), (n,), (z,)
    *addresses, regularised = (
        address_of(array, FLOAT, shape, f"{name} of a linear system")
        for array, shape, name in zip(arrays, (*shapes, *vectors), BlockArrays._fields, strict=True)
    )
    system = BlockSystemStruct(count, n, z, columns, *addresses, cost_scale, regularisation, regularised)
    step, multipliers = np.empty((count, z, columns)), np.empty((count + 1, n, columns))
    finite, largest = np.empty(columns, bool), np.empty(z)
    own = library()
    size = own.retrax_block_workspace(count, n, z, columns)
    if not size:
        raise InvalidInputError(f"a linear system of {count} stages of {z} unknowns is larger than memory")
    (workspace,) = scratch(((size // BYTES,),))
    solution = BlockSolutionStruct(*(a.ctypes.data for a in (step, multipliers, finite, largest)))
    chosen = best_instruction_set() if instruction_set is None else instruction_set
    own.retrax_block_eliminate(
        byref(system), byref(solution), address_of(workspace, FLOAT, workspace.shape, "workspace"), chosen
    )
    inertia = solution.inertia
    return BlockResult(
        step, multipliers, finite, largest, inertia.negative, inertia.smallest, solution.curvature, solution.size
    )
