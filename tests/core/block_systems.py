"""Random block systems and the dense matrices that they stand for."""

from typing import NamedTuple

import numpy as np


class BlockSystem(NamedTuple):
    """Linear systems of Newton steps, with the members of a batch along the leading axis; see ``retrax_core.h``."""

    hessian: np.ndarray  # (B, N, z, z)
    left: np.ndarray  # (B, N, n, z)
    right: np.ndarray  # (B, N, n, z)
    slope: np.ndarray  # (B, N, z, k)
    gap: np.ndarray  # (B, N + 1, n, k)
    fixed_start: np.ndarray  # (B, n)
    fixed_end: np.ndarray  # (B, n)


def random_system(seed: int, sizes=(3, 4, 3, 5, 2), free=(0, 0), convex: bool = True) -> BlockSystem:
    """Systems of these sizes B, N, n, z, k, with this many free coordinates at the start and at the end."""
    rng = np.random.default_rng(seed)
    batch, count, n, z, columns = sizes
    hessian = rng.standard_normal((batch, count, z, z))
    other = hessian.swapaxes(2, 3)
    hessian = hessian @ other + 0.1 * np.eye(z) if convex else hessian + other
    left, right = rng.standard_normal((2, batch, count, n, z))
    gap, start, end = rng.standard_normal((batch, count + 1, n, columns)), np.ones((batch, n)), np.ones((batch, n))
    start[:, : free[0]], end[:, : free[1]] = 0.0, 0.0
    return BlockSystem(hessian, left, right, rng.standard_normal((batch, count, z, columns)), gap, start, end)


def dense(system: BlockSystem, m: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Hessian and constraints of member m, the diagonal of the free coordinates' equations ``-c = 0``, the right-hand
    side."""
    _, count, n, z = system.left.shape
    hessian, constraints = np.zeros((count * z, count * z)), np.zeros(((count + 1) * n, count * z))
    for k in range(count):
        step = slice(k * z, (k + 1) * z)
        hessian[step, step] = system.hessian[m, k]
        constraints[k * n : (k + 1) * n, step] += system.left[m, k]
        constraints[(k + 1) * n : (k + 2) * n, step] -= system.right[m, k]
    fixed = np.ones((count + 1, n))
    fixed[0], fixed[-1] = system.fixed_start[m], system.fixed_end[m]
    constraints *= fixed.ravel()[:, None]
    gap = system.gap[m] * fixed[..., None]
    side = -np.concatenate([system.slope[m].reshape(count * z, -1), gap.reshape(fixed.size, -1)])
    return hessian, constraints, np.diag(fixed.ravel() - 1), side


def matrix(system: BlockSystem, m: int) -> np.ndarray:
    """The KKT matrix of member m."""
    hessian, constraints, free, _ = dense(system, m)
    return np.block([[hessian, constraints.T], [constraints, free]])
