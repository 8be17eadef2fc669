"""Retractions of products, factor by factor."""

from typing import Any, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from ...manifolds import InvalidInputError, Product
from ..differential import DifferentiatedRetraction, differential_adjoint, differentiated
from ..retraction import Retraction


@final
class ProductRetraction(DifferentiatedRetraction):
    """The retraction of a product with one retraction for each factor.

    Parameters
    ----------
    *factors : Retraction
        The retractions, in the order of the factors.

    Raises
    ------
    InvalidInputError
        Without factors, and for other factors.

    Notes
    -----
    :math:`R(x, v)_i = R_i(x_i, v_i)`.

    Examples
    --------
    >>> isinstance(Cayley(SO(3) * Euclidean(3)), ProductRetraction)
    True
    """

    factors: tuple[Retraction, ...]

    def __init__(self, *factors: Retraction) -> None:
        if not factors or not all(isinstance(factor, Retraction) for factor in factors):
            raise InvalidInputError(f"ProductRetraction takes one or more retractions, got {factors!r}")
        self.factors = factors

    @property
    def manifold(self) -> Product:
        return Product(*(factor.manifold for factor in self.factors))

    def retract(self, x: tuple[Any, ...], v: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(r(xi, vi) for r, xi, vi in zip(self.factors, x, v, strict=True))

    def frame(self, x: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(r.frame(xi) for r, xi in zip(self.factors, x, strict=True))

    def chart(self, x: tuple[Any, ...], frame: tuple[Any, ...], c: Array) -> tuple[Any, ...]:
        ends = np.cumsum([factor.manifold.dimension for factor in self.factors])[:-1]
        return tuple(r.chart(*part) for r, *part in zip(self.factors, x, frame, jnp.split(c, ends), strict=True))

    def both_ways(self, x: tuple[Any, ...], v: tuple[Any, ...]) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        pairs = [r.both_ways(xi, vi) for r, xi, vi in zip(self.factors, x, v, strict=True)]
        return tuple(first for first, _ in pairs), tuple(second for _, second in pairs)

    def preimage(self, x: tuple[Any, ...], y: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(r.preimage(xi, yi) for r, xi, yi in zip(self.factors, x, y, strict=True))

    def fibre_derivative(self, x: tuple[Any, ...], v: tuple[Any, ...], w: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(differentiated(r, *parts) for r, *parts in zip(self.factors, x, v, w, strict=True))

    def differential_adjoint(self, x: tuple[Any, ...], v: tuple[Any, ...], xi: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(differential_adjoint(r, *parts) for r, *parts in zip(self.factors, x, v, xi, strict=True))

    def domain(self, x: tuple[Any, ...], v: tuple[Any, ...]) -> Bool[Array, ""]:
        return jnp.all(jnp.stack([r.domain(xi, vi) for r, xi, vi in zip(self.factors, x, v, strict=True)]))
