"""Euclidean space of arrays of any shape."""

from collections.abc import Sequence
from math import prod
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..manifold import HomogeneousSpace
from ..numerics.precision import real
from ..numerics.sizes import as_shape


@final
class Euclidean(HomogeneousSpace):
    """The vector space of real arrays of one shape, on which translations act.

    Parameters
    ----------
    shape : int or tuple of int
        The shape of points: ``Euclidean(3)``, ``Euclidean((2, 3))``.

    Notes
    -----
    The dimension is the number of entries; the projection is :math:`P_x a = a`; the momentum is ``p``.

    Examples
    --------
    >>> Euclidean((2, 3)).dimension
    6
    """

    shape: tuple[int, ...] = eqx.field(static=True)

    def __init__(self, shape: int | Sequence[int]) -> None:
        self.shape = as_shape(shape)

    def __str__(self) -> str:
        shape = " x ".join(map(str, self.shape)) or "1"
        return f"R^{shape}" if len(self.shape) < 2 else f"R^({shape})"

    @property
    def dimension(self) -> int:
        return prod(self.shape)

    @property
    def ambient(self) -> jax.ShapeDtypeStruct:
        return real(self.shape)

    def projection(self, x: Array, a: Array) -> Array:
        return a

    def basis(self, x: Array) -> Array:
        return jnp.asarray(np.eye(self.dimension).reshape(self.dimension, *self.shape), x.dtype)

    def restore(self, x: Array) -> Array:
        return x

    def violations(self, x: Array) -> dict[str, Array]:
        return {}

    def generators(self, x: Array) -> Array:
        return self.basis(x)

    def random_point(self, key: Array) -> Array:
        return jax.random.normal(key, self.shape)
