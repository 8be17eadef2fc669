"""The metric that a manifold goes with in another library, and the exponential map of a metric."""

from functools import singledispatch

import numpy as np

from ..integrators import KAHAN_LI_8, Composition, GeodesicRetraction, SymplecticIntegrator
from ..manifolds import (
    SE,
    SL,
    SO,
    SPD,
    SU,
    AffineInvariantMetric,
    CanonicalMetric,
    ComplexStiefel,
    EmbeddedMetric,
    Euclidean,
    Grassmann,
    Hyperbolic,
    LeftInvariantMetric,
    LorentzMetric,
    Manifold,
    Metric,
    Oblique,
    Power,
    PowerMetric,
    Product,
    ProductMetric,
    ScaledMetric,
    Sphere,
    Stiefel,
    U,
)
from ..manifolds.numerics.ambient import is_traced
from ..retractions import (
    CotangentLift,
    Exponential,
    FrobeniusExponential,
    Midpoint,
    PowerRetraction,
    ProductRetraction,
    Retraction,
    SEDecoupled,
    StiefelCanonicalExponential,
    default_retraction,
)

_GRAM_ROUNDING = 1e-12  # relative: a smaller difference of two Gram matrices is rounding
# Symmetric spaces in the metric of the ambient space.
_SYMMETRIC = (Euclidean, Sphere, SO, SE, U, SU, Grassmann, Oblique)


@singledispatch
def natural_metric(manifold: Manifold) -> Metric:
    """The metric that the literature gives a manifold: affine-invariant on SPD, Lorentz on hyperbolic space, else
    embedded.

    On SL(n) it is left-invariant, the Frobenius inner product at the identity.
    """
    return EmbeddedMetric(manifold)


@natural_metric.register
def _(manifold: SL) -> Metric:
    return LeftInvariantMetric(manifold, manifold.lie_algebra.gram)


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


def exponential_map(metric: Metric) -> Retraction:
    """The exponential map of a metric: a closed form where one is known, else geodesics in 8 steps of order 8.

    On SE(n), U(n) and SU(n) the embedded metric is meant, whose geodesics are decoupled motions and one-parameter
    subgroups.
    """
    metric = split(metric)
    manifold = metric.manifold
    match metric:
        case ProductMetric():
            return ProductRetraction(*map(exponential_map, metric.factors))
        case PowerMetric():
            return PowerRetraction(exponential_map(metric.factor), metric.k)
        case CanonicalMetric() if not isinstance(manifold, ComplexStiefel):
            return StiefelCanonicalExponential(metric.manifold)
        case EmbeddedMetric(manifold=SE() as group):
            return SEDecoupled(group)
        case EmbeddedMetric(manifold=Stiefel()) | AffineInvariantMetric() | LorentzMetric():
            return Exponential(manifold)
        case EmbeddedMetric() if isinstance(manifold, _SYMMETRIC):
            return Exponential(manifold)
        case LeftInvariantMetric(manifold=group) if FrobeniusExponential.applies(group) and _is_frobenius(metric):
            return Exponential(group) if group.lie_algebra.acts_unitarily else FrobeniusExponential(group)
    step = SymplecticIntegrator(CotangentLift(Midpoint(default_retraction(manifold))))
    return GeodesicRetraction(metric, integrator=Composition(step, KAHAN_LI_8))


def is_symmetric(metric: Metric) -> bool:
    """Whether a manifold with this metric is known to be a symmetric space, with an exponential map in closed form."""
    return all(
        (isinstance(part, EmbeddedMetric) and isinstance(part.manifold, _SYMMETRIC))
        or isinstance(part, AffineInvariantMetric | LorentzMetric)
        for part in _parts(metric)
    )


def has_unique_geodesics(metric: Metric) -> bool:
    """Whether any two points are known to have one shortest geodesic: spaces of curvature at most zero."""
    return all(
        isinstance(part.manifold, Euclidean) or isinstance(part, AffineInvariantMetric | LorentzMetric)
        for part in _parts(metric)
    )


def _parts(metric: Metric) -> list[Metric]:
    """The metrics that a metric is made of, such as the metrics of the factors of a product."""
    match split(metric):
        case ProductMetric(factors=factors):
            return [part for factor in factors for part in _parts(factor)]
        case PowerMetric(factor=factor):
            return _parts(factor)
        case other:
            return [other]


def _is_frobenius(metric: LeftInvariantMetric) -> bool:
    """Whether a left-invariant metric is a multiple of the Frobenius inner product at the identity."""
    if is_traced(metric.inertia):
        return False
    inertia, gram = np.asarray(metric.inertia), metric.manifold.lie_algebra.gram
    matrix = np.diag(inertia) if inertia.ndim == 1 else inertia
    return np.allclose(matrix / matrix[0, 0], gram / gram[0, 0], rtol=0, atol=_GRAM_ROUNDING)


def split(metric: Metric) -> Metric:
    """A metric with the same geodesics, without scale, and for products and powers as the sum of the metrics of the
    factors."""
    while isinstance(metric, ScaledMetric):
        metric = metric.base
    if not isinstance(metric, EmbeddedMetric):
        return metric
    match metric.manifold:
        case Product(factors=factors):
            return ProductMetric(*map(EmbeddedMetric, factors))
        case Power(factor=factor, k=k):
            return PowerMetric(EmbeddedMetric(factor), k)
    return metric
