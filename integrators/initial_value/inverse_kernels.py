"""Inverses of matrices in lanes, shape ``(n, n, lanes)``."""

import numpy as np

from ...kernels import kernel_part


@kernel_part()
def invert(a: np.ndarray, sizes: np.ndarray) -> None:
    """The inverse of a matrix in each lane, in its place, by Gauss and Jordan with partial pivoting.

    Pivots are compared in units of the largest entries of their rows, ``sizes`` being those of the unknowns: positions
    and momenta, and so their equations, are in units of their own.
    """
    n, lanes = a.shape[0], a.shape[2]
    rows, largest = np.empty((n, lanes), np.int64), np.zeros((n, lanes))
    for i in range(n):
        for column in range(n):
            for j in range(lanes):
                largest[i, j] = max(largest[i, j], abs(a[i, column, j]) * sizes[column, j])
    for k in range(n):
        for j in range(lanes):
            best = k
            for i in range(k + 1, n):
                if abs(a[i, k, j]) * largest[best, j] > abs(a[best, k, j]) * largest[i, j]:
                    best = i
            rows[k, j] = best
            largest[k, j], largest[best, j] = largest[best, j], largest[k, j]
            for i in range(n):
                a[k, i, j], a[best, i, j] = a[best, i, j], a[k, i, j]
            pivot, a[k, k, j] = a[k, k, j], 1.0
            for i in range(n):
                a[k, i, j] /= pivot
        for i in range(n):
            if i != k:
                _sweep(a, i, k)
    for k in range(n - 1, -1, -1):
        for j in range(lanes):
            for i in range(n):
                a[i, k, j], a[i, rows[k, j], j] = a[i, rows[k, j], j], a[i, k, j]


@kernel_part()
def _sweep(a: np.ndarray, i: int, k: int) -> None:
    """Take as much of row ``k`` from row ``i`` as stands there in column ``k``."""
    for column in range(a.shape[0]):
        if column != k:
            for j in range(a.shape[2]):
                a[i, column, j] -= a[i, k, j] * a[k, column, j]
    for j in range(a.shape[2]):
        a[i, k, j] *= -a[k, k, j]


@kernel_part()
def multiply(a: np.ndarray, v: np.ndarray, places: tuple) -> None:
    """Newton's steps in units of the unknowns. ``places``: first rows of the residual, of the steps, of the units."""
    missed, step, sizes = places
    n, lanes = a.shape[0], v.shape[1]
    for i in range(n):
        for j in range(lanes):
            v[step + i, j] = 0.0
        for column in range(n):
            for j in range(lanes):
                v[step + i, j] += a[i, column, j] * v[missed + column, j]
        for j in range(lanes):
            v[step + i, j] /= v[sizes + i, j]


@kernel_part()
def copy_to_lanes(matrix: np.ndarray, a: np.ndarray) -> None:
    """Write the matrix into all lanes."""
    for i in range(matrix.shape[0]):
        for column in range(matrix.shape[0]):
            for j in range(a.shape[2]):
                a[i, column, j] = matrix[i, column]
