"""Compiled recursion of the Gramians that tell what controls reach."""

import numpy as np

from .factors import compiled, inner
from .lu import back_substitute, decompose


@inner
def _move(near: np.ndarray, far: np.ndarray, v: np.ndarray, start: int, move: np.ndarray, push: np.ndarray) -> None:
    """``A = far_x near_x^-1`` and ``B = far_u - A near_u``; the inverse stands in the columns of ``v`` from ``start`` on."""
    n, z = near.shape
    for a in range(n):
        for b in range(n):
            move[a, b] = 0.0
            for c in range(n):
                move[a, b] += far[a, c] * v[c, start + b]
        for j in range(n, z):
            push[a, j - n] = far[a, j]
            for c in range(n):
                push[a, j - n] -= move[a, c] * near[c, j]


@inner
def _congruent(out: np.ndarray, a: np.ndarray, g: np.ndarray) -> None:
    """``out += a g a'``."""
    for i in range(a.shape[0]):
        for k in range(g.shape[0]):
            f = 0.0
            for j in range(g.shape[0]):
                f += a[i, j] * g[j, k]
            for j in range(a.shape[0]):
                out[i, j] += f * a[j, k]


@compiled
def gramians(near: np.ndarray, far: np.ndarray, variance: np.ndarray, work: tuple, swaps: np.ndarray, out: np.ndarray) -> None:
    """``G_k = A G_{k-1} A' + B W B'`` from the ends of the steps in their order, shape ``(N, n, z)``.

    ``variance``: the diagonal matrix ``W``; ``out``: shape ``(N + 1, n, n)``, comes as zeros.
    """
    (v, lower, weights, move, push), (count, n, _) = work, near.shape
    start = v.shape[1] // 2
    for k in range(count):
        for a in range(n):
            for j in range(v.shape[1]):
                v[a, j] = near[k, a, j] if j < n else 0.0
            v[a, start + a] = 1.0
        decompose(v, swaps, lower, weights[0])
        back_substitute(v, start, lower)
        _move(near[k], far[k], v, start, move, push)
        for i in range(2):
            _congruent(out[k + 1], move if i == 0 else push, out[k] if i == 0 else variance)
