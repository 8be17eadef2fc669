"""Projection onto a level set, by Newton's method [Absil, Malick 2012; Boumal 2023, 7.7]."""

from typing import final

import jax.numpy as jnp
from jaxtyping import Array

from ..manifolds import LevelSet
from ..manifolds.level_set import positive_norms
from ..manifolds.numerics.root import find_root, solve_small
from .retraction import Retraction, is_reached, nan_unless


@final
class LevelSetProjection(Retraction):
    """The projection of ``x + v`` on a level set: the nearest point for small ``v``.

    Parameters
    ----------
    manifold : LevelSet
        The level set.

    Notes
    -----
    It solves :math:`y = x + v + c'(y)^T l`, :math:`c(y) = 0` for ``y`` and ``l`` by Newton's method from ``x + v``;
    entries are NaN without convergence. Inverse: :math:`v = y - x + c'(y)^T l` with the ``l`` for which ``v`` is
    tangent at ``x``, a linear equation.

    Examples
    --------
    >>> class Circle(LevelSet):
    ...     def constraint(self, x):
    ...         return x @ x - 1.0
    >>> isinstance(Projection(Circle((2,))), LevelSetProjection)
    True
    """

    manifold: LevelSet

    def retract(self, x: Array, v: Array) -> Array:
        shape, a = self.manifold.shape, jnp.ravel(x + v)
        start = jnp.ravel(self.manifold.restore(x + v))
        lengths = positive_norms(self.manifold.jacobian(start.reshape(shape)))

        def residual(unknown: Array) -> Array:
            y, multipliers = unknown[: a.size], unknown[a.size :] / lengths
            point = y.reshape(shape)
            normal = self.manifold.jacobian(point).T @ multipliers
            return jnp.concatenate([y - a - normal, self.manifold.equations(point) / lengths])

        root, converged = find_root(residual, jnp.concatenate([start, jnp.zeros_like(lengths)]))
        return nan_unless(converged, root[: a.size].reshape(shape))

    def preimage(self, x: Array, y: Array) -> Array:
        (_, here), (_, there) = self.manifold.in_lengths(x), self.manifold.in_lengths(y)
        chord = jnp.ravel(y - x)
        multipliers = solve_small(here @ there.T, -(here @ chord))
        v = (chord + there.T @ multipliers).reshape(self.manifold.shape)
        # The equation has a solution also where y is a far critical point of the distance to x + v.
        return nan_unless(is_reached(self.manifold, y, self(x, v), x, v), v)
