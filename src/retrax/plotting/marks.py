"""Cones and obstacles that pictures show: their arguments, checked, and circles on the sphere."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from ..integrators.reporting.text import brief
from ..manifolds import InvalidInputError


def check_pairs(what: str, given: Any, n: int) -> list[tuple[np.ndarray, float]]:
    """Pairs of a vector of ``n`` entries and a positive number, as for cones and obstacles; raises for other input."""
    found = []
    for pair in given if isinstance(given, Iterable) else [given]:
        try:
            vector, size = np.asarray(pair[0], float), float(pair[1])
        except (TypeError, ValueError, IndexError, KeyError):
            vector, size = np.zeros(0), 0.0
        if vector.shape != (n,) or not (np.all(np.isfinite(vector)) and 0 < size < np.inf):
            raise InvalidInputError(
                f"{what} must be pairs of {n} numbers and a positive number, got {brief(pair)}; try "
                f"{what}=[({[1.0, *[0.0] * (n - 1)]}, 0.5)]"
            )
        found.append((vector, size))
    return found


def check_cones(given: Any) -> list[tuple[np.ndarray, float]]:
    """Cones with unit vectors as axes; raises for other input."""
    found = [(vector, size, np.linalg.norm(vector)) for vector, size in check_pairs("cones", given, 3)]
    if any(length == 0 or size >= np.pi for _, size, length in found):
        raise InvalidInputError(
            "cones must be pairs of a direction that is not zero and a half-angle below pi; try half-angles in rad"
        )
    return [(vector / length, size) for vector, size, length in found]


def circle(direction: np.ndarray, half_angle: float) -> np.ndarray:
    """The circle in which a cone about a unit vector meets the unit sphere, shape ``(3, 100)``."""
    angle = np.linspace(0, 2 * np.pi, 100)
    across = np.linalg.svd(direction[None])[2][1:]
    return np.cos(half_angle) * direction[:, None] + np.sin(half_angle) * (across.T @ [np.cos(angle), np.sin(angle)])
