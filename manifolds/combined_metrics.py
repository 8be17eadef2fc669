"""Metrics made of metrics: sums over the factors of a product or the copies of a power, and multiples."""

from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .manifold import Manifold
from .metric import Metric
from .numerics.ambient import Ambient
from .power import Power
from .product import Product


@final
class ProductMetric(Metric):
    r"""The sum of metrics of the factors of a product, :math:`g(v, w) = \sum_i g_i(v_i, w_i)`.

    Parameters
    ----------
    *factors : Metric
        The metrics, one for each factor.

    Raises
    ------
    InvalidInputError
        For other factors.

    Examples
    --------
    >>> print(ProductMetric(EmbeddedMetric(SO(3)), EmbeddedMetric(Euclidean(3))).manifold)
    SO(3) x R^3
    """

    factors: tuple[Metric, ...]

    def __init__(self, *factors: Metric) -> None:
        self.factors = factors

    @property
    def manifold(self) -> Product:
        return Product(*(factor.manifold for factor in self.factors))

    def inner_product(self, x: tuple[Any, ...], v: tuple[Any, ...], w: tuple[Any, ...]) -> Array:
        return sum(
            (g.inner_product(*parts) for g, *parts in zip(self.factors, x, v, w, strict=True)), start=jnp.zeros(())
        )

    def kinetic_energy(self, x: tuple[Any, ...], p: tuple[Any, ...]) -> Array:
        return sum(
            (g.kinetic_energy(*parts) for g, *parts in zip(self.factors, x, p, strict=True)), start=jnp.zeros(())
        )


@final
class PowerMetric(Metric):
    r"""The sum of one metric over the copies of a power, :math:`g(v, w) = \sum_i g_M(v_i, w_i)`.

    Parameters
    ----------
    factor : Metric
        The metric of a copy.
    k : int
        The number of copies.

    Raises
    ------
    InvalidInputError
        For another metric or number.

    Examples
    --------
    >>> print(PowerMetric(EmbeddedMetric(Sphere(2)), 3).manifold)
    Power(Sphere(2), 3)
    """

    factor: Metric
    k: int = eqx.field(static=True)

    def __init__(self, factor: Metric, k: int) -> None:
        self.factor, self.k = factor, k

    @property
    def manifold(self) -> Power:
        return Power(self.factor.manifold, self.k)

    def inner_product(self, x: Ambient, v: Ambient, w: Ambient) -> Array:
        return jnp.sum(jax.vmap(self.factor.inner_product)(x, v, w))

    def kinetic_energy(self, x: Ambient, p: Ambient) -> Array:
        return jnp.sum(jax.vmap(self.factor.kinetic_energy)(x, p))


@final
class ScaledMetric(Metric):
    """A positive multiple of a metric: the same geodesics with other lengths.

    Parameters
    ----------
    base : Metric
        The metric.
    scale : float
        The factor, positive; ``InvalidInputError`` for another number.

    Examples
    --------
    >>> q, v = jnp.zeros(2), jnp.array([3.0, 4.0])
    >>> float(ScaledMetric(EmbeddedMetric(Euclidean(2)), 2.0).inner_product(q, v, v))
    50.0
    """

    base: Metric
    scale: float = eqx.field(static=True)

    def __init__(self, base: Metric, scale: float) -> None:
        self.base, self.scale = base, scale

    @property
    def manifold(self) -> Manifold:
        return self.base.manifold

    def inner_product(self, x: Ambient, v: Ambient, w: Ambient) -> Array:
        return self.scale * self.base.inner_product(x, v, w)

    def kinetic_energy(self, x: Ambient, p: Ambient) -> Array:
        return self.base.kinetic_energy(x, p) / self.scale
