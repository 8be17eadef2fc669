"""pymanopt's conventions for our manifolds, and the scales that its trust regions start from."""

import math
from functools import partial, singledispatch
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array
from pymanopt.manifolds.fixed_rank import _FixedRankPoint, _FixedRankTangentVector

from ...manifolds import SO, SU, FixedRank, Grassmann, Manifold, Oblique, Power, Product, Sphere, Stiefel, U
from ..conventions import Conventions, PartList, Representatives, SameConvention, SkewFactors, Stack, Theirs


@final
class Factors(Conventions):
    """pymanopt's matrices of rank ``r``: a point is its singular value decomposition ``(u, s, vt)``.

    A tangent vector ``u M vt + Up vt + u Vp'`` is written ``(Up, M, Vp)``, with ``u'Up = 0`` and ``vt Vp = 0``. A
    vector of the space around the points is a matrix ``z``, or ``(U, S, V)`` with ``z = U S V'``.
    """

    r: int = eqx.field(static=True)

    def point(self, x: tuple) -> Array:
        u, s, vt = x
        return (u * s) @ vt

    def push(self, x: tuple, a: Theirs) -> Array:
        return a[0] @ a[1] @ a[2].T if isinstance(a, tuple | list) else a

    def embedding(self, x: tuple, v: tuple) -> tuple[Array, Array, Array]:
        (u, _, vt), (up, m, vp) = x, v
        return jnp.hstack([u @ m + up, u]), jnp.eye(2 * self.r, dtype=u.dtype), jnp.hstack([vt.T, vp])

    def lift(self, q: Array, near: tuple | None = None) -> _FixedRankPoint:
        u, s, vt = _factors(q, self.r)
        if near is not None:
            signs = jnp.where(jnp.sum(u * near[0], axis=0) < 0, -1.0, 1.0).astype(u.dtype)
            u, vt = u * signs, signs[:, None] * vt
        return _FixedRankPoint(u, s, vt)

    def coordinates(self, x: tuple, w: Array) -> _FixedRankTangentVector:
        u, _, vt = x
        right, left = w @ vt.T, w.T @ u
        m = u.T @ right
        return _FixedRankTangentVector(right - u @ m, m, left - vt.T @ m.T)

    def elsewhere(self, x: tuple, y: tuple, v: tuple) -> tuple[Array, Array, Array]:
        return self.embedding(x, v)


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def _factors(q: Array, r: int) -> tuple[Array, Array, Array]:
    """Singular value decomposition ``u, s, vt`` of a matrix of rank ``r``, its derivative that among such matrices.

    It exists where the singular values are different [Townsend, "Differentiating the singular value decomposition",
    2016].
    """
    u, s, vt = jnp.linalg.svd(q, full_matrices=False)
    return u[:, :r], s[:r], vt[:r]


@_factors.defjvp
def _factors_jvp(r: int, primals: tuple[Array], tangents: tuple[Array]) -> tuple[tuple, tuple]:
    (u, s, vt), (dq,) = _factors(primals[0], r), tangents
    right, left = dq @ vt.T, dq.T @ u
    m = u.T @ right
    gaps = s**2 - s[:, None] ** 2 + jnp.eye(r, dtype=s.dtype)
    turned = (m * s + s[:, None] * m.T) / gaps * (1 - jnp.eye(r, dtype=s.dtype))
    turned_rows = (s[:, None] * m + m.T * s) / gaps * (1 - jnp.eye(r, dtype=s.dtype))
    du = u @ turned + (right - u @ m) / s
    dv = vt.T @ turned_rows + (left - vt.T @ m.T) / s
    return (u, s, vt), (du, jnp.diagonal(m), dv.T)


@singledispatch
def conventions_of(manifold: Manifold) -> Conventions:
    """The form of the points and tangent vectors of a manifold in pymanopt.

    Parameters
    ----------
    manifold : Manifold
        The manifold.

    Returns
    -------
    Conventions
        The conventions.
    """
    several = len(jax.tree.leaves(manifold.ambient)) > 1
    return PartList(jax.tree.map(lambda _: SameConvention(), manifold.ambient)) if several else SameConvention()


@conventions_of.register
def _(manifold: SO | U | SU) -> Conventions:
    return SkewFactors()


@conventions_of.register
def _(manifold: FixedRank) -> Conventions:
    return Factors(manifold.r)


@conventions_of.register
def _(manifold: Grassmann) -> Conventions:
    return Representatives(manifold.p)


@conventions_of.register
def _(manifold: Product) -> Conventions:
    return PartList(tuple(_nest(factor) for factor in manifold.factors))


@conventions_of.register
def _(manifold: Power) -> Conventions:
    base = conventions_of(manifold.factor)
    if isinstance(base, PartList):
        return PartList(base.nest.unflatten([Stack(part) for part in base.parts]))
    return Stack(base)


def _nest(manifold: Manifold) -> Any:
    conventions = conventions_of(manifold)
    return conventions.nest.unflatten(conventions.parts) if isinstance(conventions, PartList) else conventions


@singledispatch
def typical_distance(manifold: Manifold) -> float:
    """The scale of a manifold by the rules of pymanopt: an injectivity radius, or the root of a dimension.

    Parameters
    ----------
    manifold : Manifold
        The manifold.

    Returns
    -------
    float
        The scale.
    """
    return math.sqrt(manifold.dimension)


@typical_distance.register
def _(manifold: Sphere) -> float:
    return math.pi


@typical_distance.register
def _(manifold: SO | U | SU) -> float:
    return math.pi * math.sqrt(manifold.n)


@typical_distance.register
def _(manifold: FixedRank) -> float:
    return float(manifold.dimension)


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
