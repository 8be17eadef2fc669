"""Distances of points on each factor of a manifold, which are angles on rotation groups and spheres."""

from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from ....manifolds import SE, SO, Manifold, Power, Product, Sphere
from ....manifolds.product import factor_name

SOLID_DIMENSION = 3  # largest n for which a rotation of R^n has one angle
LONGEST_TURN = 2 * np.pi / 3  # radians: larger turns in one step hardly tell one direction from the other
Distances = tuple[str, np.ndarray, bool]


def factor_distances(manifold: Manifold, first: Any, second: Any, name: str = "") -> Iterator[Distances]:
    """Distances of points with leading axes: for each factor its name, the distances, and whether these are angles.

    Angles are in radians. On ``SO(n)`` the distance is the root of the sum of the squared angles of the rotation.
    """
    match manifold:
        case Product(factors=factors):
            for i, (factor, x, y) in enumerate(zip(factors, first, second, strict=True)):
                yield from factor_distances(factor, x, y, f"{name}{factor_name(i)}, ")
        case Power(factor=factor):
            for part, distances, is_angle in factor_distances(factor, first, second):
                yield f"{name}{manifold}{part.removeprefix(str(factor))}", np.max(distances, axis=-1), is_angle
        case SE(n=n):
            shift = np.linalg.norm(first[..., :n, n] - second[..., :n, n], axis=-1)
            yield f"{name}{manifold}, rotation", _turn(first[..., :n, :n], second[..., :n, :n]), n <= SOLID_DIMENSION
            yield f"{name}{manifold}, translation", shift, False
        case SO(n=n):
            yield f"{name}{manifold}", _turn(first, second), n <= SOLID_DIMENSION
        case Sphere():
            difference, total = (np.linalg.norm(a, axis=-1) for a in (first - second, first + second))
            yield f"{name}{manifold}", 2 * np.arctan2(difference, total), True
        case _:
            pairs = zip(jax.tree.leaves(manifold.ambient), jax.tree.leaves(first), jax.tree.leaves(second), strict=True)
            parts = [
                np.sum(np.abs(a - b) ** 2, axis=tuple(range(a.ndim - len(kind.shape), a.ndim))) for kind, a, b in pairs
            ]
            yield f"{name}{manifold}", np.sqrt(np.sum(parts, axis=0)), False


def long_turn_words(angle: float) -> str:
    """Words on a turn in one step that is too long to be trusted; empty for a shorter one."""
    if not angle > LONGEST_TURN:
        return ""
    words = "increase steps, and check that angles and rates are in radians"
    return f"a step turns by {np.degrees(angle):.0f} degrees: {words}"


def _turn(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Root of the sum of the squared angles of the rotation between two, each of which is in two singular values."""
    chords = np.linalg.svd(first - second, compute_uv=False)
    return np.linalg.norm(2 * np.arcsin(np.minimum(chords / 2, 1)), axis=-1) / np.sqrt(2)
