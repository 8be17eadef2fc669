"""Geodesics of the Stiefel manifold in the metric of its ambient space, and their logarithm."""

from typing import final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds import Stiefel
from ...manifolds.numerics.matrices import exponential
from ...manifolds.numerics.root import approach_root
from ..retraction import Retraction, nan_unless, newton_preimage


@final
class StiefelExponential(Retraction):
    """Geodesics of the embedded metric [Edelman, Arias, Smith 1998, 2.2.2]: with ``a = x'v`` and ``s = v'v``,

        R(x, v) = [x, v] exp [[a, -s], [I, a]] [I; 0] exp(-a).

    Inverse (logarithm): Levenberg-Marquardt steps from the chord until Newton's method takes over. Its domain is the ball of
    radius pi in the Frobenius norm, the injectivity radius [Zimmermann, Stoye 2024]; its image the points nearer than pi.
    """

    manifold: Stiefel

    def __call__(self, x: Array, v: Array) -> Array:
        p = x.shape[1]
        v = self.manifold.projection(x, v)
        a, s = self.manifold.skew(x, v), v.T @ v
        flow = exponential(jnp.block([[a, -s], [jnp.eye(p, dtype=x.dtype), a]]))[:, :p]
        return (x @ flow[:p] + v @ flow[p:]) @ exponential(-a)

    def preimage(self, x: Array, y: Array) -> Array:
        v = newton_preimage(self, x, y, start=self._near(*jax.lax.stop_gradient((x, y))))
        return nan_unless(self.domain(x, v), v)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return jnp.sum(v * v) < jnp.pi**2

    def _near(self, x: Array, y: Array) -> Array:
        """A tangent vector whose geodesic ends near ``y``: the direction of the chord, its length, then least squares."""
        basis = self.manifold.basis(x)
        chord = jnp.tensordot(basis, y - x, 2)
        length = jnp.sqrt(jnp.sum((y - x) ** 2))
        start = chord * length / jnp.maximum(jnp.sqrt(chord @ chord), jnp.finfo(x.dtype).tiny)
        c = approach_root(lambda c: jnp.ravel(self(x, jnp.tensordot(c, basis, 1)) - y), start)
        return jnp.tensordot(c, basis, 1)
