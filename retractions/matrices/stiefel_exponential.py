"""Geodesics of the Stiefel manifold, in the metric of its ambient space and in the canonical one, and their
logarithms."""

from typing import final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...manifolds import ComplexStiefel, InvalidInputError, Stiefel
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.frames import complement, polar_factor, qr_factor
from ...manifolds.numerics.matrices import exponential
from ...manifolds.numerics.root import approach_root
from ...manifolds.numerics.tolerances import HALF, tolerance
from ..groups.functions import rotations, unitary
from ..retraction import Retraction, nan_unless, newton_preimage
from ..rounding import keeps_half_the_digits, length

_TURNS = 60  # of the second half of the frame in the canonical logarithm


@final
class StiefelExponential(Retraction):
    r"""The exponential map of the embedded metric on frames.

    Parameters
    ----------
    manifold : Stiefel
        The manifold.

    Notes
    -----
    With :math:`a = x^T v` and :math:`s = v^T v`,

    .. math::
        R(x, v) = [x, v] \exp \begin{pmatrix} a & -s \\ I & a \end{pmatrix} \begin{pmatrix} I \\ 0 \end{pmatrix}
        \exp(-a) = \exp(v x^T - x v^T)\, x \exp(-a),

    the second form if its matrices are not larger, :math:`n \le 2p`. Inverse: shooting from the chord, by
    Levenberg-Marquardt steps with derivatives of the geodesic, then by Newton's method. Its domain is the ball of
    radius :math:`\pi` in the Frobenius norm, the injectivity radius, except its last :math:`4\pi\sqrt\epsilon`. Its
    image is the set of points at a distance below :math:`\pi`.

    For complex frames too: sectional curvatures are at most :math:`\langle v^H v, w^H w \rangle \le 1`, and geodesics,
    with the curvature :math:`|v^H v| \le 1` in the ambient space, are not closed below :math:`2\pi`.

    References
    ----------
    Edelman, Arias, Smith, 1998, 2.2.2. Hüper, Markina, Silva Leite, 2021, for alpha = -1/2. Zimmermann, Hüper, 2022.
    Zimmermann, Stoye, 2024.

    Examples
    --------
    >>> Exponential(Stiefel(3, 2))
    StiefelExponential(manifold=Stiefel(n=3, p=2))
    """

    manifold: Stiefel

    def retract(self, x: Array, v: Array) -> Array:
        n, p = x.shape
        v = self.manifold.projection(x, v)
        a, s = self.manifold.skew(x, v), v.conj().T @ v
        turned = unitary.exponential if jnp.iscomplexobj(x) else rotations.exponential
        back = turned(-a)
        if n <= 2 * p:
            return turned(v @ x.conj().T - x @ v.conj().T) @ x @ back
        flow = exponential(jnp.block([[a, -s], [jnp.eye(p, dtype=x.dtype), a]]))[:, :p]
        return (x @ flow[:p] + v @ flow[p:]) @ back

    def preimage(self, x: Array, y: Array) -> Array:
        v = newton_preimage(self, x, y, start=self._near(*jax.lax.stop_gradient((x, y))))
        return nan_unless(length(v) < jnp.pi, v)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        # One column that turns by almost pi arrives from every direction: magnified by pi / gap.
        gap = jnp.pi - length(v)
        return (gap > 0) & keeps_half_the_digits(jnp.pi / gap)

    def _near(self, x: Array, y: Array) -> Array:
        """A tangent vector whose geodesic ends near ``y``: the direction of the chord, its length, then least
        squares."""
        basis = self.manifold.basis(x)
        chord = vec.components(basis, y - x)
        start = chord * length(y - x) / jnp.maximum(jnp.sqrt(chord @ chord), jnp.finfo(x.dtype).tiny)
        c = approach_root(lambda c: vec.flatten_frame((self(x, vec.combine(basis, c)) - y)[None])[0], start)
        return vec.combine(basis, c)


@final
class StiefelCanonicalExponential(Retraction):
    r"""The exponential map of ``CanonicalMetric`` on frames.

    Parameters
    ----------
    manifold : Stiefel
        The manifold.

    Notes
    -----
    With :math:`a = x^T v` and :math:`k = v - x a`,

    .. math::
        R(x, v) = [x, k] \exp \begin{pmatrix} a & -k^T k \\ I & 0 \end{pmatrix} \begin{pmatrix} I \\ 0 \end{pmatrix}.

    Inverse: the algorithm of Zimmermann, then Newton's method to rounding. Its domain is the ball of radius
    :math:`\sqrt{4/5}\,\pi` in this metric, a lower bound of the injectivity radius. On frames (6, 3) the inverse comes
    back to 4e-15, up to 1e-8 from the edge of the domain.

    References
    ----------
    Edelman, Arias, Smith, 1998, 2.4.2. Zimmermann, 2017, algorithm 3.1. Rentmeesters, 2013.

    Examples
    --------
    >>> StiefelCanonicalExponential(Stiefel(3, 2)).manifold
    Stiefel(n=3, p=2)
    """

    manifold: Stiefel

    def __check_init__(self) -> None:
        if isinstance(self.manifold, ComplexStiefel):
            raise InvalidInputError(
                f"StiefelCanonicalExponential takes real frames, got {self.manifold}; try Exponential"
            )

    def retract(self, x: Array, v: Array) -> Array:
        p = x.shape[1]
        a, k = self.manifold.skew(x, v), v - x @ (x.T @ v)
        flow = exponential(jnp.block([[a, -k.T @ k], [jnp.eye(p, dtype=x.dtype), jnp.zeros_like(a)]]))[:, :p]
        return x @ flow[:p] + k @ flow[p:]

    def preimage(self, x: Array, y: Array) -> Array:
        v = newton_preimage(self, x, y, start=self._near(*jax.lax.stop_gradient((x, y))))
        # A little beyond the domain, whose last vectors rounding moves over its edge.
        return nan_unless(self._squared_length(x, v) < 0.8 * jnp.pi**2 * (1 + tolerance(v, HALF)), v)

    def domain(self, x: Array, v: Array) -> Bool[Array, ""]:
        return self._squared_length(x, v) < 0.8 * jnp.pi**2

    def _squared_length(self, x: Array, v: Array) -> Array:
        return jnp.sum(v * v) - jnp.sum((x.T @ v) ** 2) / 2

    def _near(self, x: Array, y: Array) -> Array:
        """The rotation of ``[x, q]`` that takes ``x`` to ``y`` and whose logarithm does not turn ``q`` in its own
        span."""
        n, p = x.shape
        if n == p:
            return x @ rotations.logarithm(x.T @ y)
        # The factorisation of both frames keeps q orthogonal to x where y - x (x'y) has no digits.
        q = complement(x) if n < 2 * p else qr_factor(jnp.concatenate([x, y - x @ (x.T @ y)], axis=1))[:, p:]
        first = jnp.concatenate([x.T @ y, q.T @ y])
        second = complement(first)
        second = second @ polar_factor(second[p:]).T
        second = second * jnp.where((jnp.arange(second.shape[1]) == 0) & (_determinant(first, second) < 0), -1.0, 1.0)
        close = tolerance(x, 0.8)

        def turn(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            second, _, count = state
            log = rotations.logarithm(jnp.concatenate([first, second], axis=1))
            return second @ rotations.exponential(-log[p:, p:]), log, count + 1

        def unfinished(state: tuple[Array, Array, Array]) -> Array:
            return (state[2] < 1) | ((vec.size(state[1][p:, p:]) > close) & (state[2] < _TURNS))

        log = jax.lax.while_loop(unfinished, turn, (second, jnp.zeros((len(first),) * 2, x.dtype), jnp.zeros((), int)))[
            1
        ]
        return x @ log[:p, :p] + q @ log[p:, :p]


def _determinant(first: Array, second: Array) -> Array:
    return jnp.linalg.det(jnp.concatenate([first, second], axis=1))
