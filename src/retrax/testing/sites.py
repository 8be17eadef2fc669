"""Points at which an object is checked: points of the user, and points at which formulas often fail."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..interop.wrapped.manifold import WrappedManifold
from ..manifolds import InvalidInputError, Manifold, MatrixLieGroup, Power, Product
from ..manifolds.bundles import VectorBundle
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from .numerics import flat, violation_kernel
from .precision import precision

Violation = Callable[[np.ndarray], np.ndarray]

SPECIAL = 2  # most special points of one manifold: each is one more sample of every kind


@dataclass(frozen=True, eq=False)
class Site:
    """A flat point ``x`` with words on its origin, and the ``seed`` of the directions drawn there."""

    words: str
    seed: int
    x: np.ndarray
    special: bool = False


def given_sites(manifold: Manifold, points: Iterable[Ambient]) -> list[Site]:
    """Sites of the points that a user gives. Raises ``InvalidInputError`` for what is not a point."""
    sites = []
    for i, x in enumerate(points):
        verdict = manifold.contains(x)
        if not verdict:
            raise InvalidInputError(f"points[{i}] is not a point: {verdict.reason}; try a list of points of {manifold}")
        sites.append(Site(f"points[{i}]", i, np.asarray(flat(x))))
    return sites


def special_sites(manifold: Manifold, violation: Violation) -> list[Site]:
    """Sites of the first special points of a manifold; ``violation`` is the kernel of its equations."""
    points = islice(special_points(manifold, violation), SPECIAL)
    return [Site("a special point", i, np.asarray(flat(x)), special=True) for i, x in enumerate(points)]


def special_points(manifold: Manifold, violation: Violation | None = None) -> Iterator[Ambient]:
    """Points with zeros, ones and equal entries, where angles, roots, singular values and their derivatives are not
    defined.

    The identity, zero, poles, barycentres: those of a few arrays that satisfy the manifold's equations.
    """
    if isinstance(manifold, Product):
        parts = [list(islice(special_points(factor), SPECIAL)) for factor in manifold.factors]
        for i in range(max(map(len, parts)) if all(parts) else 0):
            yield tuple(part[min(i, len(part) - 1)] for part in parts)
    elif isinstance(manifold, VectorBundle):
        yield from ((x, vec.zeros(manifold.base.ambient)) for x in special_points(manifold.base))
    elif isinstance(manifold, Power):
        for x in special_points(manifold.factor):
            yield jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (manifold.k, *leaf.shape)), x)
    elif isinstance(manifold, MatrixLieGroup):
        yield manifold.identity
    else:
        if isinstance(manifold, WrappedManifold):  # the libraries it comes from may fail far from their own points
            return
        violation = violation or violation_kernel(manifold)
        yield from (x for x in _candidates(manifold) if _is_inside(np.asarray(flat(x)), violation))


def _is_inside(x: np.ndarray, violation: Violation) -> bool:
    """Whether a flat point satisfies the equations, and is not on the edge of an inequality: beside it they are nearly
    satisfied.

    A violation without its absolute value is negative inside: such a point is not one either.
    """
    tolerance, beside = precision().tolerance, precision().half
    aside = beside * np.random.default_rng(0).standard_normal(x.size)
    return violation(x)[1] <= tolerance and all(violation(y)[1] <= 1e3 * beside for y in (x - aside, x + aside))


def _candidates(manifold: Manifold) -> Iterator[Any]:
    """Zero, the identity, unit vectors, diagonal projectors, and vectors of equal entries, where points are single
    arrays."""
    leaf, *others = jax.tree.leaves(manifold.ambient)
    if others:
        return
    zero = np.zeros(leaf.shape)
    units = np.eye(*leaf.shape) if leaf.ndim == 2 else np.eye(leaf.size, 1)
    arrays = [
        np.where(np.arange(units.shape[1]) < rank, units, 0.0).reshape(leaf.shape)
        for rank in range(1, 1 + min(units.shape))
    ]
    if leaf.size > 1:
        arrays += [arrays[0].reshape(-1)[::-1].reshape(leaf.shape)]
        arrays += [zero + 1 / leaf.size] * (leaf.ndim == 1)
    wrapped = jax.tree.structure(manifold.ambient)
    yield from (jax.tree.unflatten(wrapped, [jnp.asarray(a, leaf.dtype)]) for a in (zero, *arrays))
