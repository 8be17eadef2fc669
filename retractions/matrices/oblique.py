"""Retractions of matrices with unit columns, column by column."""

from typing import final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds import Oblique
from ..differential import DifferentiatedRetraction, differential_adjoint, differentiated
from ..retraction import MidpointRetraction


@final
class Columnwise(MidpointRetraction, DifferentiatedRetraction):
    """A retraction of the sphere for each column of an oblique manifold.

    Parameters
    ----------
    manifold : Oblique
        The manifold.
    column : MidpointRetraction
        The retraction :math:`R_S` of the sphere.

    Notes
    -----
    :math:`R(x, v)_j = R_S(x_j, v_j)` for the columns, arrays of shape ``(n,)``; likewise inverse, domain, derivative
    and midpoints.

    Examples
    --------
    >>> isinstance(Exponential(Oblique(3, 2)), Columnwise)
    True
    """

    manifold: Oblique
    column: MidpointRetraction

    def retract(self, x: Array, v: Array) -> Array:
        return jax.vmap(self.column, 1, 1)(x, v)

    def preimage(self, x: Array, y: Array) -> Array:
        return jax.vmap(self.column.preimage, 1, 1)(x, y)

    def fibre_derivative(self, x: Array, v: Array, w: Array) -> Array:
        return jax.vmap(lambda *parts: differentiated(self.column, *parts), 1, 1)(x, v, w)

    def differential_adjoint(self, x: Array, v: Array, xi: Array) -> Array:
        return jax.vmap(lambda *parts: differential_adjoint(self.column, *parts), 1, 1)(x, v, xi)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return jnp.all(jax.vmap(self.column.domain, 1)(x, v))

    def midpoint(self, x0: Array, x1: Array) -> Array:
        return jax.vmap(self.column.midpoint, 1, 1)(x0, x1)
