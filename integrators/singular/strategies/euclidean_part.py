"""A manifold as the product of its curved factors and one Euclidean space."""

from collections.abc import Iterator
from typing import Any, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ....manifolds import Euclidean, Manifold, Product
from ....manifolds.numerics.ambient import Ambient


@final
class EuclideanPart(eqx.Module):
    """All Euclidean factors of a product, however nested, gathered in one space ``R^k``, beside the other factors.

    Points, tangent vectors and covectors are taken apart alike.
    """

    manifold: Manifold

    @property
    def others(self) -> tuple[Manifold, ...]:
        """The factors that are not Euclidean, in their order."""
        return tuple(m for m in self._factors if not isinstance(m, Euclidean))

    @property
    def dimension(self) -> int:
        """Dimension ``k`` of the Euclidean part."""
        return sum(m.dimension for m in self._factors if isinstance(m, Euclidean))

    def split(self, a: Ambient) -> tuple[tuple[Ambient, ...], Float[Array, " k"]]:
        """The parts of an ambient vector in the other factors, and in ``R^k``."""
        pairs = list(euclidean_part(self.manifold, a))
        flat = [jnp.ravel(part) for m, part in pairs if isinstance(m, Euclidean)]
        return tuple(part for m, part in pairs if not isinstance(m, Euclidean)), jnp.concatenate([jnp.zeros(0), *flat])

    def join(self, others: tuple[Ambient, ...], x: Float[Array, " k"]) -> Ambient:
        """The ambient vector with these parts."""
        rest, sizes = iter(others), [m.dimension for m in self._factors if isinstance(m, Euclidean)]
        flat = iter(jnp.split(x, np.cumsum(sizes)[:-1]))

        def build(manifold: Manifold) -> Ambient:
            if isinstance(manifold, Product):
                return tuple(build(factor) for factor in manifold.factors)
            return next(flat).reshape(manifold.shape) if isinstance(manifold, Euclidean) else next(rest)

        return build(self.manifold)

    @property
    def _factors(self) -> list[Manifold]:
        return [m for m, *_ in euclidean_part(self.manifold)]


def euclidean_part(manifold: Manifold, *parallel: Any) -> Iterator[tuple[Any, ...]]:
    """The factors of a product of products, each with its part of every tuple of the same nesting."""
    if isinstance(manifold, Product):
        for factor, *parts in zip(manifold.factors, *parallel, strict=True):
            yield from euclidean_part(factor, *parts)
    else:
        yield manifold, *parallel
