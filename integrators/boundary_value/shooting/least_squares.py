"""Damped Gauss-Newton steps of least norm for systems whose equations may repeat or contradict each other."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ....manifolds.numerics.levenberg import RELATIVE_DAMPING, levenberg

CUTOFF = 1e-11  # singular values below this fraction of the largest are taken for zero
SOLVED = 1e-13  # largest residual at which the iteration ends, in the units of the residual: its rounding


def least_squares(
    residual: Callable[[Float[Array, " n"]], Float[Array, " m"]], start: Float[Array, " n"]
) -> tuple[Float[Array, " n"], Float[Array, " m"]]:
    """A stationary point of ``|residual|^2`` near ``start``, and the residual there: zero to rounding where that is
    possible.

    Levenberg's method [Nocedal, Wright 2006, 10.3] with steps of least norm; ``m`` and ``n`` are any, the rank too.
    """

    def step(jacobian: Float[Array, "m n"], r: Float[Array, " m"], damping: Array) -> Float[Array, " n"]:
        u, s, vt = jnp.linalg.svd(jacobian, full_matrices=False)
        kept = s > CUTOFF * s[0]
        scales = jnp.where(kept, s / jnp.where(kept, s * s + (damping * s[0]) ** 2, 1.0), 0.0)
        return -vt.T @ (scales * (u.T @ r))

    return levenberg(residual, start, step, RELATIVE_DAMPING, SOLVED)


def shortest_step(
    matrix: np.ndarray, residual: np.ndarray, excess: np.ndarray, damping: float
) -> tuple[np.ndarray, int]:
    """The ``d`` with ``matrix d = -residual``, in the least-squares sense, for which ``|excess + d|`` is least, and the
    rank.

    With ``damping``, in units of the largest singular value, it is Levenberg's step instead.
    """
    u, s, vt = np.linalg.svd(matrix, full_matrices=False)
    kept = s > CUTOFF * np.max(s, initial=0.0)
    u, s, vt = u[:, kept], s[kept], vt[kept]
    shortest = -vt.T @ (s / (s**2 + (damping * s[0]) ** 2) * (u.T @ residual)) if s.size else np.zeros(matrix.shape[1])
    free = np.zeros_like(shortest) if damping else vt.T @ (vt @ excess) - excess
    return shortest + free, len(s)
