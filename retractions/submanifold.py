"""Retraction of a submanifold of a manifold with a retraction."""

from typing import final

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..manifolds import InvalidInputError, Submanifold
from ..manifolds.bundles import same_manifold
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.root import find_root
from .retraction import Retraction, is_reached, nan_unless


@final
class Orthographic(Retraction):
    r"""The orthographic retraction of a submanifold: it corrects a step along the normals at its start.

    Parameters
    ----------
    manifold : Submanifold
        The submanifold.
    parent : Retraction
        The retraction :math:`R_M` of its parent manifold.

    Notes
    -----
    :math:`R(x, v) = R_M(x, v + \sum_i l_i n_i(x))` with the gradients :math:`n_i` of the equations at ``x`` and the
    multipliers ``l`` for which it lies on the submanifold; entries are NaN without convergence. Inverse: the tangential
    part of the inverse of :math:`R_M`; NaN if ``R`` does not lead back.

    References
    ----------
    Absil, Malick, Projection-like retractions on matrix manifolds, 2012.

    Examples
    --------
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
