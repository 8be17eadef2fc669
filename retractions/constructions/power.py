"""Retractions of powers, all copies at once."""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds import InvalidInputError, Power
from ...manifolds.numerics.ambient import Ambient
from ..differential import DifferentiatedRetraction, differential_adjoint, differentiated
from ..retraction import Retraction


@final
class PowerRetraction(DifferentiatedRetraction):
    """The retraction of ``Power(M, k)`` that applies a retraction of ``M`` to each copy.

    Parameters
    ----------
    factor : Retraction
        The retraction of a copy.
    k : int
        The number of copies.

    Raises
    ------
    InvalidInputError
        For another retraction, and for a number below 1.

    Notes
    -----
    :math:`R(x, v)_i = R_M(x_i, v_i)`.
    """

    factor: Retraction
    k: int = eqx.field(static=True)

    def __init__(self, factor: Retraction, k: int) -> None:
        if not isinstance(factor, Retraction):
            raise InvalidInputError(f"PowerRetraction takes a retraction and a number of copies, got {factor!r}")
        self.factor, self.k = factor, Power(factor.manifold, k).k

    @property
    def manifold(self) -> Power:
        return Power(self.factor.manifold, self.k)

    def retract(self, x: Ambient, v: Ambient) -> Ambient:
        return jax.vmap(self.factor)(x, v)

    def preimage(self, x: Ambient, y: Ambient) -> Ambient:
        return jax.vmap(self.factor.preimage)(x, y)

    def fibre_derivative(self, x: Ambient, v: Ambient, w: Ambient) -> Ambient:
        return jax.vmap(lambda *parts: differentiated(self.factor, *parts))(x, v, w)

    def differential_adjoint(self, x: Ambient, v: Ambient, xi: Ambient) -> Ambient:
        return jax.vmap(lambda *parts: differential_adjoint(self.factor, *parts))(x, v, xi)

    def domain(self, x: Ambient, v: Ambient) -> Bool[Array, ""]:
        return jnp.all(jax.vmap(self.factor.domain)(x, v))
