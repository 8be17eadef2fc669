"""Condensing of collocation steps by the compiled core."""

from ctypes import byref
from typing import NamedTuple, final

import numpy as np

from ...errors import InvalidInputError
from ..working_memory import scratch
from .library import BYTES, FLOAT, PLACE, address_of, best_instruction_set, library
from .structs import CollocationSystemStruct, CondensedSystemStruct


@final
class CollocationArrays(NamedTuple):
    """Newton's equations of N steps with s points, states of n and controls of m numbers, q = 3 n + m; k right-hand
    sides."""

    step_size: np.ndarray  # (N,)
    matrix: np.ndarray  # (s, s)
    weights: np.ndarray  # (s,)
    hessian: np.ndarray  # (N, s, q, q)
    jacobian: np.ndarray  # (N, s, n, q)
    slope: np.ndarray  # (N, s, q, k)
    defect: np.ndarray  # (N, s, n, k)
    end_hessian: np.ndarray  # (N, 2n, 2n)
    end_left: np.ndarray  # (N, n, 2n)
    end_right: np.ndarray  # (N, n, 2n)
    end_slope: np.ndarray  # (N, 2n, k)


@final
class CondensedArrays(NamedTuple):
    """The system that condensing leaves, z = n + s m."""

    hessian: np.ndarray  # (N, z, z)
    left: np.ndarray  # (N, n, z)
    right: np.ndarray  # (N, n, z)
    slope: np.ndarray  # (N, z, k)
    before: np.ndarray  # (N, n, k)
    after: np.ndarray  # (N, n, k)


@final
class KeptArrays(NamedTuple):
    """The velocities as functions of what is left, which expanding needs, p = s n."""

    factors: np.ndarray  # (N, p, p)
    swaps: np.ndarray  # (N, p)
    velocities: np.ndarray  # (N, p, z + k)


def _sizes(arrays: CollocationArrays) -> tuple[int, int, int, int, int]:
    """Numbers of steps, points, of a state, of controls, and of right-hand sides."""
    shape, columns = arrays.jacobian.shape, arrays.slope.shape[-1:]
    if len(shape) != 4 or 0 in (*shape, *columns) or shape[3] < 3 * shape[2]:
        raise InvalidInputError(
            f"collocation steps have Jacobians (steps, points, n, 3 n + m) and slopes with columns, got shapes {shape} "
            f"and {arrays.slope.shape}"
        )
    count, s, n, q = shape
    return count, s, n, q - 3 * n, *columns


def _system(arrays: CollocationArrays) -> CollocationSystemStruct:
    count, s, n, m, k = _sizes(arrays)
    q = 3 * n + m
    table = (count,), (s, s), (s,)
    points = (count, s, q, q), (count, s, n, q), (count, s, q, k), (count, s, n, k)
    ends = (count, 2 * n, 2 * n), (count, n, 2 * n), (count, n, 2 * n), (count, 2 * n, k)
    addresses = (
        address_of(array, FLOAT, shape, f"{name} of collocation steps")
        for array, shape, name in zip(arrays, (*table, *points, *ends), CollocationArrays._fields, strict=True)
    )
    return CollocationSystemStruct(count, s, n, m, k, *addresses)


def _kept_struct(kept: KeptArrays, sizes: tuple[int, int, int, int, int]) -> CondensedSystemStruct:
    """The struct with what is kept alone."""
    count, s, n, m, k = sizes
    z, p = n + s * m, s * n
    shapes = (count, p, p), (count, p), (count, p, z + k)
    addresses = [
        address_of(array, PLACE if name == "swaps" else FLOAT, shape, f"{name} of condensed steps")
        for array, shape, name in zip(kept, shapes, KeptArrays._fields, strict=True)
    ]
    return CondensedSystemStruct(*[None] * 6, *addresses)


def _workspace(sizes: tuple[int, int, int, int, int]) -> np.ndarray:
    size = library().retrax_condensing_workspace(*sizes[1:])
    if not size:
        raise InvalidInputError(f"collocation steps of these sizes are larger than the core takes: {sizes[1:]}")
    return scratch(((size // BYTES,),))[0]


def condense_steps(arrays: CollocationArrays, instruction_set: int | None = None) -> tuple[CondensedArrays, KeptArrays]:
    """Return the system that is left when the velocities are eliminated from each step, and what is kept of them."""
    system, sizes = _system(arrays), _sizes(arrays)
    count, s, n, m, k = sizes
    z, p = n + s * m, s * n
    shapes = (count, z, z), (count, n, z), (count, n, z), (count, z, k), (count, n, k), (count, n, k)
    condensed = CondensedArrays(*map(np.empty, shapes))
    kept = KeptArrays(np.empty((count, p, p)), np.empty((count, p), PLACE), np.empty((count, p, z + k)))
    addresses = [a.ctypes.data for a in (*condensed, *kept)]
    workspace = _workspace(sizes)
    library().retrax_condense(
        byref(system),
        byref(CondensedSystemStruct(*addresses)),
        0,
        count,
        address_of(workspace, FLOAT, workspace.shape, "workspace"),
        best_instruction_set() if instruction_set is None else instruction_set,
    )
    return condensed, kept


def condense_slope(
    arrays: CollocationArrays, kept: KeptArrays, slope: np.ndarray, end_slope: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the slopes of a function by the velocities, (N, s, n), and by the remaining unknowns, (N, z).

    The function has slopes (N, s, q) at the points and (N, 2n) at the ends.
    """
    system, sizes = _system(arrays), _sizes(arrays)
    count, s, n, m, _ = sizes
    inner, outer = np.empty((count, s, n)), np.empty((count, n + s * m))
    library().retrax_condense_slope(
        byref(system),
        byref(_kept_struct(kept, sizes)),
        address_of(slope, FLOAT, (count, s, 3 * n + m), "slope of collocation steps"),
        None if end_slope is None else address_of(end_slope, FLOAT, (count, 2 * n), "slope of the ends"),
        *(address_of(a, FLOAT, a.shape, "result") for a in (inner, outer)),
    )
    return inner, outer
