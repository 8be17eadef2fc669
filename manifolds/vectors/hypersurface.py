"""The base class of manifolds of vectors with one dimension less."""

import equinox as eqx
import jax

from ..manifold import Manifold
from ..numerics.precision import real
from ..numerics.sizes import plain, require_size


class Hypersurface(Manifold):
    """An ``n``-dimensional manifold of vectors of shape ``(n + 1,)``."""

    n: int = eqx.field(static=True, converter=plain)

    def __check_init__(self) -> None:
        require_size(self, self.n, 1)

    @property
    def dimension(self) -> int:
        return self.n

    @property
    def ambient(self) -> jax.ShapeDtypeStruct:
        return real((self.n + 1,))
