"""Tolerances with one meaning in several files, from the tightest on.

A tolerance of a single algorithm stands beside the algorithm. Tolerances are relative to the terms of a number. Most
are multiples or powers of eps, which is 2e-16.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

EPS = float(np.finfo(float).eps)  # of double precision, in which what is not traced by JAX computes

ROUNDING = 100.0  # times eps, 2e-14: what sums and products of a few terms lose
FINEST = 256.0  # times eps, 6e-14, and a line: as close as two points on it come that tell a jump from a slope
SAME_TIME = 1e-12  # 5000 times eps, of the whole: what the sums of steps that times are may differ by
REGULAR = 0.6  # power of eps, 4e-10: the smallest singular value, or pivot, of a matrix that is solved with
HALF = 0.5  # power of eps, 1e-8: half of the digits, which differences, products of rows and derivatives by them leave
RANK = 0.45  # power of eps, 9e-8: the smallest singular value that counts for the rank of a matrix of derivatives
ACTIVE = 1e-3  # of the largest multiplier of an inequality: a smaller one is what a barrier leaves


def tolerance(x: Any, power: float) -> float:
    """``eps^power`` in the precision of an array."""
    return float(jnp.finfo(x.dtype).eps ** power)


def rounding_of(x: Any) -> float:
    """The rounding error of sums and products of a few terms, relative to the largest term, in the precision of an
    array."""
    return ROUNDING * tolerance(x, 1.0)
