"""Hyperbolic space, the Lorentz model."""

from functools import partial
from typing import final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..groups.special_orthogonal import skew_basis
from ..manifold import HomogeneousSpace
from ..metric import Metric
from ..numerics import ambient as vec
from .hypersurface import Hypersurface

Vector = Float[Array, " n+1"]


def lorentz(v: Vector, w: Vector) -> Array:
    """Lorentz form ``<v, w>_L = -v_0 w_0 + v_1 w_1 + ... + v_n w_n``."""
    return v[1:] @ w[1:] - v[0] * w[0]


@final
class Hyperbolic(Hypersurface, HomogeneousSpace):
    r"""The hyperbolic space :math:`\{x : \langle x, x \rangle_L = -1,\ x_0 > 0\}`, with the time coordinate first.

    Parameters
    ----------
    n : int
        The dimension; points have shape ``(n + 1,)``.

    Notes
    -----
    It is a subset of a Euclidean space: projection and basis are orthogonal for the sum of products, which also pairs
    covectors with vectors. ``LorentzMetric`` is its metric of constant curvature -1. The Lorentz group acts on it.

    Examples
    --------
    >>> Hyperbolic(2).dimension, Hyperbolic(2).ambient.shape
    (2, (3,))
    """

    def projection(self, x: Array, a: Array) -> Array:
        normal = _flipped(x)
        return a - (normal @ a) / (normal @ normal) * normal

    def basis(self, x: Array) -> Float[Array, "n n+1"]:
        # The reflection that takes the first axis to the normal, up to sign, takes the other axes to the tangent space.
        w = (_flipped(x) / jnp.sqrt(x @ x)).at[0].add(-1.0)
        return (jnp.eye(self.n + 1, dtype=x.dtype) - 2 * jnp.outer(w, w) / (w @ w))[1:]

    def restore(self, x: Array) -> Array:
        """The point with the same space coordinates: exact also far out, where ``<x, x>_L`` has lost its digits."""
        unit = jax.lax.stop_gradient(jnp.maximum(vec.size(x[1:]), 1.0))
        space = x[1:] / unit  # its square is a number
        return jnp.asarray(x).at[0].set(unit * jnp.sqrt(unit**-2 + space @ space))

    def violations(self, x: Array) -> dict[str, Array]:
        return {"|x_0 / sqrt(1 + x_1^2 + ... + x_n^2) - 1|": jnp.abs(x[0] / self.restore(x)[0] - 1)}

    def generators(self, x: Array) -> Array:
        """Boosts and rotations ``J S x`` with ``J = diag(-1, 1, ..., 1)`` and ``S`` the basis of skew matrices."""
        return _flipped((jnp.asarray(skew_basis(self.n + 1), x.dtype) @ x).T).T

    def random_point(self, key: Array) -> Array:
        return self.restore(jax.random.normal(key, (self.n + 1,)))

    def at_apex(self, x: Array, v: Array) -> Float[Array, " n"]:
        r"""The space part of a tangent vector ``v`` at ``x``, boosted to the apex ``(1, 0, ..., 0)``, shape
        ``(n,)``.

        Parameters
        ----------
        x : array of shape (n + 1,)
            A point.
        v : array of shape (n + 1,)
            A tangent vector there. The Euclidean length of the result is :math:`|v|_L`, without the cancellation of
            :math:`\langle v, v \rangle_L`.
        """
        return v[1:] - v[0] / (1 + x[0]) * x[1:]

    def from_apex(self, x: Array, u: Float[Array, " n"]) -> Array:
        """The tangent vector at ``x`` whose boost to the apex has the space part ``u``.

        Parameters
        ----------
        x : array of shape (n + 1,)
            A point.
        u : array of shape (n,)
            The space part.
        """
        along = x[1:] @ u
        return jnp.concatenate([along[None], u + along / (1 + x[0]) * x[1:]])

    def seen_from(self, x: Array, y: Array) -> tuple[Array, Float[Array, " n"]]:
        """The time and space part of ``y``, boosted so that ``x`` is at the apex: ``cosh d``, and ``sinh d`` times
        a direction.

        Parameters
        ----------
        x, y : array of shape (n + 1,)
            Two points.

        Notes
        -----
        Near ``x`` the result comes from the difference of the points, which keeps its digits; elsewhere from their
        form.
        """
        e = y - x
        far = -lorentz(x, y)
        excess = jnp.where(far < 2, lorentz(e, e) / 2, far - 1)
        return 1 + excess, e[1:] - (e[0] + excess) / (1 + x[0]) * x[1:]

    def length(self, x: Array, a: Array) -> Array:
        """The Lorentz length ``|a|_L`` of a tangent vector."""
        return vec.size(self.at_apex(x, a))

    def distance(self, x: Array, y: Array) -> Array:
        r"""The distance :math:`\mathrm{arcosh}(-\langle x, y \rangle_L)`, as exact as the points.

        Parameters
        ----------
        x, y : array of shape (n + 1,)
            Two points.

        Notes
        -----
        It has no derivative at ``x = y``: automatic differentiation gives 0 there, a subgradient.
        """
        return _distance(self, jnp.asarray(x), jnp.asarray(y))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _distance(manifold: Hyperbolic, x: Vector, y: Vector) -> Array:
    """``d`` from ``sinh^2(d/2) = sinh^2((a - b)/2) + sinh a sinh b sin^2(t/2)``, where nothing cancels.

    ``a`` and ``b`` are the distances of the points from the apex, and ``t`` is the angle between them there.
    """
    largest = jnp.maximum(vec.size(x[1:]), vec.size(y[1:]))
    unit = jnp.where(largest > 0, largest, 1.0)
    here, there, chord = x[1:] / unit, y[1:] / unit, (x[1:] - y[1:]) / unit  # their squares are numbers
    r, s = jnp.linalg.norm(here), jnp.linalg.norm(there)
    total = jnp.where(largest > 0, r + s, 1.0)
    apart = chord @ (here + there) * (unit / jnp.where(largest > 0, r * y[0] + s * x[0], 1.0))  # sinh(a - b)
    first, second = here / jnp.where(r > 0, r, 1.0), there / jnp.where(s > 0, s, 1.0)
    mean = (first + second) / jnp.linalg.norm(jnp.where(first @ second > 0, first + second, 1.0))
    near = chord - chord @ mean * mean
    sine = jnp.where(first @ second > 0, jnp.linalg.norm(near) / total, jnp.linalg.norm(first - second) / 2)
    across = jnp.sqrt(unit * r) * jnp.sqrt(unit * s) * sine
    return 2 * jnp.arcsinh(jnp.hypot(jnp.sinh(jnp.arcsinh(apart) / 2), across))


@_distance.defjvp
def _distance_jvp(manifold: Hyperbolic, points: tuple, tangents: tuple) -> tuple[Array, Array]:
    (cosine, u), (_, rate) = jax.jvp(manifold.seen_from, points, tangents)
    unit = jax.lax.stop_gradient(vec.size(u))
    direction = jnp.where(unit > 0, u / unit / jnp.linalg.norm(jnp.where(unit > 0, u / unit, 1.0)), 0.0)
    return _distance(manifold, *points), direction @ rate / cosine


@final
class LorentzMetric(Metric):
    r"""The Lorentz metric :math:`g_x(v, w) = \langle v, w \rangle_L` of hyperbolic space, of constant curvature -1.

    Parameters
    ----------
    manifold : Hyperbolic
        The manifold.

    Examples
    --------
    >>> LorentzMetric(Hyperbolic(2)).manifold
    Hyperbolic(n=2)
    """

    manifold: Hyperbolic

    def inner_product(self, x: Array, v: Array, w: Array) -> Array:
        return self.manifold.at_apex(x, v) @ self.manifold.at_apex(x, w)

    def kinetic_energy(self, x: Array, p: Array) -> Array:
        p = self.manifold.projection(x, p)
        return (lorentz(p, p) + (x @ p) ** 2) / 2


def _flipped(x: Array) -> Array:
    """``J x``: the time coordinate with its sign changed."""
    return jnp.concatenate([-x[:1], x[1:]])
