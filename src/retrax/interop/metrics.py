"""The metric whose geodesics the exponential map of a manifold gives, of products and powers too."""

from functools import singledispatch
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..manifolds import (
    SO,
    SPD,
    AffineInvariantMetric,
    EmbeddedMetric,
    Euclidean,
    Grassmann,
    Hyperbolic,
    LorentzMetric,
    Manifold,
    Metric,
    Oblique,
    Power,
    Product,
    Sphere,
    Stiefel,
)
from ..manifolds.numerics.ambient import Ambient
from ..retractions import Exponential

_EMBEDDED = (Euclidean, Sphere, SO, Stiefel, Grassmann, Oblique)  # the exponential map is that of the embedded metric
_SYMMETRIC = (Euclidean, Sphere, SO, SPD, Hyperbolic, Grassmann, Oblique)


@final
class ProductMetric(Metric):
    """The sum of metrics of the factors of a product."""

    factors: tuple[Metric, ...]

    def __init__(self, *factors: Metric) -> None:
        self.factors = factors

    @property
    def manifold(self) -> Product:
        return Product(*(factor.manifold for factor in self.factors))

    def inner_product(self, x: tuple, v: tuple, w: tuple) -> Array:
        return sum((g.inner_product(*parts) for g, *parts in zip(self.factors, x, v, w, strict=True)), start=jnp.zeros(()))

    def kinetic_energy(self, x: tuple, p: tuple) -> Array:
        return sum((g.kinetic_energy(*parts) for g, *parts in zip(self.factors, x, p, strict=True)), start=jnp.zeros(()))


@final
class PowerMetric(Metric):
    """The sum of one metric over the copies of a power."""

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
    """A positive multiple of a metric: the same geodesics, other lengths."""

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


@singledispatch
def natural_metric(manifold: Manifold) -> Metric:
    """The metric of the exponential map: affine-invariant on SPD, Lorentz on hyperbolic space, else the embedded one."""
    return EmbeddedMetric(manifold)


@natural_metric.register
def _(manifold: SPD) -> Metric:
    return AffineInvariantMetric(manifold)


@natural_metric.register
def _(manifold: Hyperbolic) -> Metric:
    return LorentzMetric(manifold)


@natural_metric.register
def _(manifold: Product) -> Metric:
    return ProductMetric(*map(natural_metric, manifold.factors))


@natural_metric.register
def _(manifold: Power) -> Metric:
    return PowerMetric(natural_metric(manifold.factor), manifold.k)


def has_exponential(metric: Metric) -> bool:
    """Whether the closed form of the exponential map of a manifold is known, and is that of this metric."""
    if isinstance(metric, ProductMetric):
        return all(map(has_exponential, metric.factors))
    if isinstance(metric, PowerMetric):
        return has_exponential(metric.factor)
    if isinstance(metric, ScaledMetric):
        return has_exponential(metric.base)
    if isinstance(metric, EmbeddedMetric) and not isinstance(metric.manifold, _EMBEDDED):
        return isinstance(metric.manifold, Product | Power) and has_exponential(_split(metric.manifold))
    return isinstance(metric, EmbeddedMetric | AffineInvariantMetric | LorentzMetric) and Exponential.knows(metric.manifold)


def is_symmetric(manifold: Manifold) -> bool:
    """Whether a manifold with its natural metric is known to be a symmetric space."""
    if isinstance(manifold, Product):
        return all(map(is_symmetric, manifold.factors))
    return is_symmetric(manifold.factor) if isinstance(manifold, Power) else isinstance(manifold, _SYMMETRIC)


def _split(manifold: Product | Power) -> Metric:
    """The embedded metric of a product or of a power, as the sum that it is."""
    if isinstance(manifold, Power):
        return PowerMetric(EmbeddedMetric(manifold.factor), manifold.k)
    return ProductMetric(*map(EmbeddedMetric, manifold.factors))
