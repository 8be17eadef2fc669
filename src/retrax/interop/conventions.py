"""How another library writes down a point and a tangent vector of one of our manifolds.

``x``, ``a``, ``v`` are theirs: a point, a vector of the space around it, a tangent vector in their coordinates. ``q``
and ``w`` are ours. Every map is a JAX function of single points.
"""

from abc import abstractmethod
from math import prod
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.matrices import spd_sqrt

Theirs = Any


class Conventions(eqx.Module):
    """The conventions of another library: its points and tangent vectors for a manifold of retrax. A base class."""

    @abstractmethod
    def point(self, x: Theirs) -> Ambient:
        """The point ``q`` of retrax for a point ``x`` of the other library.

        Parameters
        ----------
        x : array or list of arrays
            A point of the other library.
        """

    @abstractmethod
    def push(self, x: Theirs, a: Theirs) -> Ambient:
        """The derivative of ``point`` at ``x`` along a vector of the space around the points of the other library.

        Parameters
        ----------
        x, a : array or list of arrays
            A point and a vector.
        """

    @abstractmethod
    def embedding(self, x: Theirs, v: Theirs) -> Theirs:
        """The vector of the space around the points with the coordinates ``v`` of a tangent vector.

        Parameters
        ----------
        x, v : array or list of arrays
            A point, and the coordinates of a tangent vector.
        """

    @abstractmethod
    def lift(self, q: Ambient, near: Theirs | None = None) -> Theirs:
        """The point of the other library for a point of retrax.

        Parameters
        ----------
        q : point
            A point of retrax.
        near : array or list of arrays, optional
            If several points represent ``q``, the result is the one closest to ``near``.
        """

    @abstractmethod
    def coordinates(self, x: Theirs, w: Ambient) -> Theirs:
        """The coordinates, in the other library, of a tangent vector of retrax at ``x``.

        Parameters
        ----------
        x : array or list of arrays
            A point of the other library.
        w : tangent vector
            A tangent vector of retrax.
        """

    def tangent(self, x: Theirs, v: Theirs) -> Ambient:
        """The tangent vector of retrax for a tangent vector of the other library.

        Parameters
        ----------
        x, v : array or list of arrays
            A point, and the coordinates of a tangent vector.
        """
        return self.push(x, self.embedding(x, v))

    def elsewhere(self, x: Theirs, y: Theirs, v: Theirs) -> Theirs:
        """The vector around ``y`` with the coordinates of a tangent vector at ``x`` that is moved to ``y``.

        Parameters
        ----------
        x, y, v : array or list of arrays
            Two points, and the coordinates of a tangent vector at ``x``.
        """
        return self.embedding(y, v)


@final
class SameConvention(Conventions):
    """Points and tangent vectors are the same arrays."""

    def point(self, x: Theirs) -> Ambient:
        return x

    def push(self, x: Theirs, a: Theirs) -> Ambient:
        return a

    def embedding(self, x: Theirs, v: Theirs) -> Theirs:
        return v

    def lift(self, q: Ambient, near: Theirs | None = None) -> Theirs:
        return q

    def coordinates(self, x: Theirs, w: Ambient) -> Theirs:
        return w


@final
class SkewFactors(Conventions):
    """pymanopt's rotations and unitary matrices: a tangent vector ``x Omega`` is written as its skew factor
    ``Omega``."""

    def point(self, x: Array) -> Array:
        return x

    def push(self, x: Array, a: Array) -> Array:
        return a

    def embedding(self, x: Array, v: Array) -> Array:
        return x @ v

    def lift(self, q: Array, near: Array | None = None) -> Array:
        return q

    def coordinates(self, x: Array, w: Array) -> Array:
        factor = jnp.conj(x.T) @ w
        return (factor - jnp.conj(factor.T)) / 2


@final
class Representatives(Conventions):
    """pymanopt's Grassmann manifold: a subspace is written as an ``(n, p)`` matrix ``x`` of orthonormal columns that
    span it.

    Our point is the projector ``x x'``. Tangent vectors are horizontal, ``x'v = 0``, and mean ``v x' + x v'``.
    """

    p: int = eqx.field(static=True)

    def point(self, x: Array) -> Array:
        return x @ x.T

    def push(self, x: Array, a: Array) -> Array:
        return a @ x.T + x @ a.T

    def embedding(self, x: Array, v: Array) -> Array:
        return v

    def lift(self, q: Array, near: Array | None = None) -> Array:
        if near is None:
            return jnp.linalg.eigh(q)[1][:, q.shape[0] - self.p :]
        # The polar factor of the projection of the old representative.
        return jnp.linalg.solve(spd_sqrt(near.T @ q @ near), near.T @ q).T

    def coordinates(self, x: Array, w: Array) -> Array:
        v = w @ x
        return v - x @ (x.T @ v)


@final
class PartList(Conventions):
    """A point with several arrays is written as one flat list of the points of its parts, however ours are nested.

    ``parts`` has the structure of our points, with conventions instead of the points of the factors.
    """

    parts: tuple[Conventions, ...]
    nest: Any = eqx.field(static=True)

    def __init__(self, parts: Any) -> None:
        leaves, self.nest = jax.tree.flatten(parts, is_leaf=lambda part: isinstance(part, Conventions))
        self.parts = tuple(leaves)

    def point(self, x: list) -> Ambient:
        return self.nest.unflatten([part.point(xi) for part, xi in zip(self.parts, x, strict=True)])

    def push(self, x: list, a: list) -> Ambient:
        return self.nest.unflatten([part.push(xi, ai) for part, xi, ai in zip(self.parts, x, a, strict=True)])

    def embedding(self, x: list, v: list) -> list:
        return [part.embedding(xi, vi) for part, xi, vi in zip(self.parts, x, v, strict=True)]

    def lift(self, q: Ambient, near: list | None = None) -> list:
        old = [None] * len(self.parts) if near is None else near
        return [part.lift(qi, xi) for part, qi, xi in zip(self.parts, self.nest.flatten_up_to(q), old, strict=True)]

    def elsewhere(self, x: list, y: list, v: list) -> list:
        return [part.elsewhere(xi, yi, vi) for part, xi, yi, vi in zip(self.parts, x, y, v, strict=True)]

    def coordinates(self, x: list, w: Ambient) -> list:
        split = self.nest.flatten_up_to(w)
        return [part.coordinates(xi, wi) for part, xi, wi in zip(self.parts, x, split, strict=True)]


@final
class Stack(Conventions):
    """Copies of one manifold along the leading axis, on both sides."""

    base: Conventions

    def point(self, x: Theirs) -> Ambient:
        return jax.vmap(self.base.point)(x)

    def push(self, x: Theirs, a: Theirs) -> Ambient:
        return jax.vmap(self.base.push)(x, a)

    def embedding(self, x: Theirs, v: Theirs) -> Theirs:
        return jax.vmap(self.base.embedding)(x, v)

    def elsewhere(self, x: Theirs, y: Theirs, v: Theirs) -> Theirs:
        return jax.vmap(self.base.elsewhere)(x, y, v)

    def lift(self, q: Ambient, near: Theirs | None = None) -> Theirs:
        return jax.vmap(self.base.lift)(q) if near is None else jax.vmap(self.base.lift)(q, near)

    def coordinates(self, x: Theirs, w: Ambient) -> Theirs:
        return jax.vmap(self.base.coordinates)(x, w)


@final
class Reshaping(Conventions):
    """A point is written as one array with the entries of our arrays one after the other, of shape ``theirs``."""

    theirs: tuple[int, ...] = eqx.field(static=True)
    ours: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    nest: Any = eqx.field(static=True)

    def __init__(self, ambient: Any, theirs: tuple[int, ...] | None = None) -> None:
        leaves, self.nest = jax.tree.flatten(ambient)
        self.ours = tuple(leaf.shape for leaf in leaves)
        self.theirs = (sum(map(prod, self.ours)),) if theirs is None else theirs

    def point(self, x: Array) -> Ambient:
        parts = jnp.split(jnp.ravel(x), np.cumsum([prod(shape) for shape in self.ours])[:-1])
        return self.nest.unflatten([jnp.reshape(part, shape) for part, shape in zip(parts, self.ours, strict=True)])

    def push(self, x: Array, a: Array) -> Ambient:
        return self.point(a)

    def embedding(self, x: Array, v: Array) -> Array:
        return v

    def lift(self, q: Ambient, near: Array | None = None) -> Array:
        return jnp.reshape(jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(q)]), self.theirs)

    def coordinates(self, x: Array, w: Ambient) -> Array:
        return self.lift(w)
