"""Derivatives and orders from values alone: central differences, and slopes of errors."""

from functools import cache
from math import factorial
from typing import Any

import numpy as np
from jaxtyping import Float

FEWEST_ERRORS = 3  # errors that make a slope


def central_nodes(reach: int) -> Float[np.ndarray, " nodes"]:
    """The places ``-reach, ..., -1, 1, ..., reach`` of a central difference, in steps."""
    ahead = np.arange(1.0, reach + 1)
    return np.concatenate([-ahead[::-1], ahead])


@cache
def _weights(order: int, reach: int) -> Float[np.ndarray, " nodes"]:
    """Weights of the values at ``central_nodes(reach)``, zero at nodes farther out than the order needs."""
    m = order // 2
    ahead = [
        (-1) ** (k + 1) * factorial(m) ** 2 / (k * factorial(m - k) * factorial(m + k)) if k <= m else 0.0
        for k in range(1, reach + 1)
    ]
    return np.array([-w for w in reversed(ahead)] + ahead)


def central_difference(values: np.ndarray, h: Any, order: int, axis: int = 0) -> np.ndarray:
    """The derivative at 0, to an even ``order`` of ``h``, from values at ``h central_nodes(reach)`` along an axis.

    ``f'(0) = sum_k w_k f(k h) / h`` with ``w_k = (-1)^(k + 1) m!^2 / (k (m - k)! (m + k)!)`` for ``order = 2 m``
    [Fornberg 1988].
    """
    return np.tensordot(_weights(order, values.shape[axis] // 2), values, (0, axis)) / h


def slope(t: np.ndarray, errors: np.ndarray, floor: float, fewest: int = FEWEST_ERRORS) -> float:
    """Slope of ``log error`` over ``log t``, where the errors are above the rounding ``floor``.

    It is infinite where fewer than ``fewest`` are.
    """
    seen = errors > floor
    return float(np.polyfit(np.log(t[seen]), np.log(errors[seen]), 1)[0]) if seen.sum() >= fewest else np.inf
