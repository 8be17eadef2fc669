"""Cartesian products of manifolds."""

from collections.abc import Iterator
from typing import Any, final

import jax
import numpy as np
from jaxtyping import Array

from .manifold import HomogeneousSpace, Manifold, product_of
from .numerics import ambient as vec
from .numerics.errors import InvalidInputError


@final
class Product(Manifold):
    """The product of manifolds; a point is the tuple of the points of its factors.

    Parameters
    ----------
    *factors : Manifold
        At least one manifold; ``SO(3) * Euclidean(3)`` is short for ``Product(SO(3), Euclidean(3))``.

    Raises
    ------
    InvalidInputError
        Without factors, and for other factors.

    Examples
    --------
    >>> (SO(3) * Euclidean(3)).dimension
    6
    """

    factors: tuple[Manifold, ...]

    def __init__(self, *factors: Manifold) -> None:
        if not factors or not all(isinstance(factor, Manifold) for factor in factors):
            raise InvalidInputError(f"Product takes one or more manifolds, got {factors!r}")
        self.factors = factors

    def __str__(self) -> str:
        return " x ".join(f"({factor})" if isinstance(factor, Product) else str(factor) for factor in self.factors)

    @property
    def dimension(self) -> int:
        return sum(factor.dimension for factor in self.factors)

    @property
    def ambient(self) -> tuple[Any, ...]:
        return tuple(factor.ambient for factor in self.factors)

    def projection(self, x: tuple[Any, ...], a: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(m.projection(xi, ai) for m, xi, ai in zip(self.factors, x, a, strict=True))

    def basis(self, x: tuple[Any, ...]) -> tuple[Any, ...]:
        return self.pad([m.basis(xi) for m, xi in zip(self.factors, x, strict=True)])

    def restore(self, x: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(m.restore(xi) for m, xi in zip(self.factors, x, strict=True))

    def violations(self, x: tuple[Any, ...]) -> dict[str, Array]:
        pairs = enumerate(zip(self.factors, x, strict=True))
        return {
            f"{factor_name(i)}: {words}": value for i, (m, xi) in pairs for words, value in m.violations(xi).items()
        }

    def length(self, x: tuple[Any, ...], a: tuple[Any, ...]) -> Array:
        return vec.size([m.length(xi, ai) for m, xi, ai in zip(self.factors, x, a, strict=True)])

    def hint_for_shape(self, k: int, shape: tuple[int, ...], role: str) -> str:
        for factor in self.factors:
            count = len(jax.tree.leaves(factor.ambient))
            if k < count:
                return factor.hint_for_shape(k, shape, role)
            k -= count
        return ""

    def random_point(self, key: Array) -> tuple[Any, ...]:
        keys = jax.random.split(key, len(self.factors))
        return tuple(m.random_point(k) for m, k in zip(self.factors, keys, strict=True))

    def pad(self, frames: list[vec.Frame]) -> tuple[Any, ...]:
        """Frames of the factors as one frame, each vector zero on the other factors.

        Parameters
        ----------
        frames : list of frames
            A frame for each factor.
        """
        counts = [jax.tree.leaves(frame)[0].shape[0] for frame in frames]
        before = [sum(counts[:i]) for i in range(len(counts))]

        def padded(leaf: Array, i: int) -> Array:
            after = sum(counts) - before[i] - counts[i]
            return jax.lax.pad(leaf, np.zeros((), leaf.dtype), [(before[i], after, 0), *[(0, 0, 0)] * (leaf.ndim - 1)])

        return tuple(jax.tree.map(lambda leaf, i=i: padded(leaf, i), frame) for i, frame in enumerate(frames))


@product_of.register
def _flat_product(first: Manifold, second: Manifold) -> Product:
    """The product of two manifolds, or of their factors, in one tuple."""
    mine, theirs = (one.factors if isinstance(one, Product) else (one,) for one in (first, second))
    return Product(*mine, *theirs)


def factor_name(k: int) -> str:
    """The name of a factor without a label."""
    return f"factor {k}"


def homogeneous_factors(manifold: Manifold, point: Any, path: str = "") -> Iterator[tuple[str, HomogeneousSpace, Any]]:
    """Factors on which a group acts, each with a name such as ``factor 0, SO(3)`` and its part of ``point``."""
    if isinstance(manifold, Product):
        for i, (factor, part) in enumerate(zip(manifold.factors, point, strict=True)):
            yield from homogeneous_factors(factor, part, f"{path}{factor_name(i)}, ")
    elif isinstance(manifold, HomogeneousSpace):
        yield f"{path}{manifold}", manifold, point
