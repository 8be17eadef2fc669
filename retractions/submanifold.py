"""Retraction of a submanifold of a manifold with a retraction."""

from typing import final

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..manifolds import InvalidInputError, Submanifold
from ..manifolds.manifold import same_manifold
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.root import find_root
from .retraction import Retraction, is_reached, nan_unless


@final
class Orthographic(Retraction):
    """``R(x, v) = R_M(x, v + sum_i l_i n_i(x))`` with the multipliers ``l`` that put it on the submanifold.

    ``R_M`` is a retraction of the parent manifold and ``n_i`` are the gradients of the equations at ``x``: the step is
    corrected along the normals where it starts [Absil, Malick, "Projection-like retractions on matrix manifolds",
    2012]. Entries are NaN where Newton's method fails. Inverse: the tangential part of the inverse of ``R_M``, NaN
    where ``R`` does not lead back.

    >>> line = Submanifold(Euclidean(2), lambda x: x[1:])
    >>> isinstance(Projection(line), Orthographic)
    True
    """

    manifold: Submanifold
    parent: Retraction

    def __check_init__(self) -> None:
        super().__check_init__()
        if not same_manifold(self.parent.manifold, self.manifold.parent):
            raise InvalidInputError(
                f"Orthographic corrects a retraction of {self.manifold.parent}, got one of {self.parent.manifold}"
            )

    def retract(self, x: Ambient, v: Ambient) -> Ambient:
        normals = self.manifold.normals(x)

        def reached(multipliers: Array) -> Ambient:
            return self.parent(x, vec.add(v, vec.combine(normals, multipliers)))

        count = self.manifold.parent.dimension - self.manifold.dimension
        start = jnp.zeros(count)
        root, found = find_root(lambda multipliers: self.manifold.equations(reached(multipliers)), start)
        return nan_unless(found, reached(root))

    def preimage(self, x: Ambient, y: Ambient) -> Ambient:
        v = self.manifold.projection(x, self.parent.preimage(x, y))
        # Far away the multipliers that lead to y are not those that Newton's method finds.
        return nan_unless(is_reached(self.manifold, y, self(x, jax.lax.stop_gradient(v)), x, v), v)
