"""pymanopt's conventions for our manifolds, and the scales that its trust regions start from."""

import math
from functools import singledispatch
from typing import Any

import jax

from ...manifolds import SO, Grassmann, Manifold, Oblique, Power, Product, Sphere, Stiefel
from ..conventions import Conventions, Listed, Representatives, Same, SkewFactors, Stacked


@singledispatch
def conventions_of(manifold: Manifold) -> Conventions:
    """How pymanopt writes the points and tangent vectors of a manifold."""
    several = len(jax.tree.leaves(manifold.ambient)) > 1
    return Listed(jax.tree.map(lambda _: Same(), manifold.ambient)) if several else Same()


@conventions_of.register
def _(manifold: SO) -> Conventions:
    return SkewFactors()


@conventions_of.register
def _(manifold: Grassmann) -> Conventions:
    return Representatives(manifold.p)


@conventions_of.register
def _(manifold: Product) -> Conventions:
    return Listed(tuple(_nested(factor) for factor in manifold.factors))


@conventions_of.register
def _(manifold: Power) -> Conventions:
    base = conventions_of(manifold.factor)
    if isinstance(base, Listed):
        return Listed(base.nest.unflatten([Stacked(part) for part in base.parts]))
    return Stacked(base)


def _nested(manifold: Manifold) -> Any:
    conventions = conventions_of(manifold)
    return conventions.nest.unflatten(conventions.parts) if isinstance(conventions, Listed) else conventions


@singledispatch
def typical_distance(manifold: Manifold) -> float:
    """Scale of a manifold by pymanopt's rules: an injectivity radius, or the root of a dimension."""
    return math.sqrt(manifold.dimension)


@typical_distance.register
def _(manifold: Sphere) -> float:
    return math.pi


@typical_distance.register
def _(manifold: SO) -> float:
    return math.pi * math.sqrt(manifold.n)


@typical_distance.register
def _(manifold: Stiefel | Grassmann) -> float:
    return math.sqrt(manifold.p)


@typical_distance.register
def _(manifold: Oblique) -> float:
    return math.pi * math.sqrt(manifold.m)


@typical_distance.register
def _(manifold: Product) -> float:
    return math.hypot(*map(typical_distance, manifold.factors))


@typical_distance.register
def _(manifold: Power) -> float:
    return math.sqrt(manifold.k * typical_distance(manifold.factor) ** 2)
