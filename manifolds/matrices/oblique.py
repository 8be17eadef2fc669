"""Matrices with unit columns."""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..manifold import HomogeneousSpace
from ..numerics import ambient as vec
from ..numerics.errors import InvalidInputError
from ..numerics.precision import real
from ..numerics.sizes import are_whole, plain
from ..vectors import Sphere


@final
class Oblique(HomogeneousSpace):
    """The oblique manifold: matrices of shape ``(n, m)`` whose ``m`` columns are unit vectors.

    Parameters
    ----------
    n : int
        The number of rows: each column is a point of the sphere in ``R^n``.
    m : int
        The number of columns.

    Notes
    -----
    Rotations act on each column, as on the sphere; momenta are listed column by column.

    Examples
    --------
    >>> Oblique(3, 4).dimension, Oblique(3, 4).ambient.shape
    (8, (3, 4))
    """

    n: int = eqx.field(static=True, converter=plain)
    m: int = eqx.field(static=True, converter=plain)

    def __check_init__(self) -> None:
        if not are_whole(self.n, self.m) or self.n < 2 or self.m < 1:
            raise InvalidInputError(
                "Oblique(n, m) holds m unit columns in R^n, whole numbers n >= 2 and m >= 1; "
                f"got n = {self.n!r}, m = {self.m!r}; try Oblique(3, 2)"
            )

    @property
    def column(self) -> Sphere:
        """The sphere of one column."""
        return Sphere(self.n - 1)

    @property
    def dimension(self) -> int:
        return self.m * self.column.dimension

    @property
    def ambient(self) -> jax.ShapeDtypeStruct:
        return real((self.n, self.m))

    def projection(self, x: Array, a: Array) -> Array:
        return jax.vmap(self.column.projection, 1, 1)(x, a)

    def basis(self, x: Array) -> Array:
        return self.place(jax.vmap(self.column.basis, 1)(x))

    def restore(self, x: Array) -> Array:
        return jax.vmap(self.column.restore, 1, 1)(x)

    def violations(self, x: Array) -> dict[str, Array]:
        return {"max ||column|^2 - 1|": vec.size(jnp.sum(x * x, 0) - 1)}

    def generators(self, x: Array) -> Array:
        return self.place(jax.vmap(self.column.generators, 1)(x))

    def random_point(self, key: Array) -> Array:
        return jax.vmap(self.column.random_point, out_axes=1)(jax.random.split(key, self.m))

    def place(self, frames: Array) -> Array:
        """Frames of the columns as one frame, each vector zero in the other columns, shape ``(m k, n, m)``.

        Parameters
        ----------
        frames : array of shape (m, k, n)
            The frames of the columns.
        """
        placed = jnp.einsum("jkn,ji->jkni", frames, jnp.eye(self.m, dtype=frames.dtype))
        return placed.reshape(-1, self.n, self.m)
