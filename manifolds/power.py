"""Powers of a manifold: many copies in one stacked array."""

from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .manifold import Manifold
from .numerics import ambient as vec
from .numerics.ambient import Ambient, Frame
from .numerics.errors import InvalidInputError
from .numerics.sizes import are_whole


@final
class Power(Manifold):
    r"""The power of a manifold: ``k`` copies, with the copies along the first axis of every array.

    Parameters
    ----------
    factor : Manifold
        The manifold ``M`` of a copy.
    k : int
        The number of copies, at least 1.

    Raises
    ------
    InvalidInputError
        For another manifold or number.

    Notes
    -----
    Points are :math:`(x_1, \dots, x_k)`, and :math:`\dim M^k = k \dim M`. A path of ``k`` attitudes is a point of
    ``Power(SO(3), k)``, shape ``(k, 3, 3)``. ``jax.vmap`` acts on all copies at once; use ``Product`` for a few
    different manifolds.
    """

    factor: Manifold
    k: int = eqx.field(static=True)

    def __init__(self, factor: Manifold, k: int) -> None:
        if not isinstance(factor, Manifold) or not are_whole(k) or k < 1:
            raise InvalidInputError(
                f"Power takes a manifold and a whole number of copies of at least 1, got {factor!r} and {k!r}; "
                "try Power(Sphere(2), 3)"
            )
        self.factor, self.k = factor, int(k)

    @property
    def dimension(self) -> int:
        return self.k * self.factor.dimension

    @property
    def ambient(self) -> Any:
        return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((self.k, *leaf.shape), leaf.dtype), self.factor.ambient)

    def projection(self, x: Ambient, a: Ambient) -> Ambient:
        return jax.vmap(self.factor.projection)(x, a)

    def basis(self, x: Ambient) -> Frame:
        return self.pad(jax.vmap(self.factor.basis)(x))

    def restore(self, x: Ambient) -> Ambient:
        return jax.vmap(self.factor.restore)(x)

    def violations(self, x: Ambient) -> dict[str, Array]:
        found = jax.vmap(self.factor.violations)(x)
        return {f"in the worst copy: {words}": vec.size(values) for words, values in found.items()}

    def length(self, x: Ambient, a: Ambient) -> Array:
        return vec.size(jax.vmap(self.factor.length)(x, a))

    def random_point(self, key: Array) -> Ambient:
        return jax.vmap(self.factor.random_point)(jax.random.split(key, self.k))

    def pad(self, frames: Frame) -> Frame:
        """Frames of the copies as one frame, each vector zero on the other copies.

        Parameters
        ----------
        frames : pytree of arrays
            Leaves of shape ``(k, m, *leaf)``.
        """

        def padded(leaf: Array) -> Array:
            apart = jnp.einsum("ij,im...->imj...", jnp.eye(self.k, dtype=leaf.dtype), leaf)
            return apart.reshape(-1, self.k, *leaf.shape[2:])

        return jax.tree.map(padded, frames)
