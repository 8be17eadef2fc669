"""Orthonormal frames."""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..groups.special_orthogonal import skew_basis
from ..groups.unitary import U
from ..manifold import HomogeneousSpace
from ..metric import Metric
from ..numerics import ambient as vec
from ..numerics.errors import InvalidInputError
from ..numerics.frames import complement, qr_factor
from ..numerics.matrices import symmetric
from ..numerics.precision import complex_entries, real
from ..numerics.sizes import are_whole, plain


class Stiefel(HomogeneousSpace):
    r"""The Stiefel manifold :math:`\{x : x^T x = I\}` of ``p`` orthonormal columns in ``R^n``.

    Parameters
    ----------
    n : int
        The number of rows.
    p : int
        The number of columns; points have shape ``(n, p)``.

    Notes
    -----
    Tangent vectors are the ``v`` with :math:`x^T v` skew. ``St(n, 1)`` is the sphere; ``St(n, n)`` is the orthogonal
    group with both components. Rotations of ``R^n`` act from the left with momentum
    :math:`J_i = \langle p, e_i x \rangle`, :math:`e_i` the basis of skew matrices. The metric is the ambient metric.

    Examples
    --------
    >>> Stiefel(3, 2).dimension
    3
    """

    n: int = eqx.field(static=True, converter=plain)
    p: int = eqx.field(static=True, converter=plain)

    def __check_init__(self) -> None:
        if not are_whole(self.n, self.p) or not 1 <= self.p <= self.n:
            raise InvalidInputError(
                f"{type(self).__name__}(n, p) holds p orthonormal columns of n entries, whole numbers 1 <= p <= n; "
                f"got n = {self.n!r}, p = {self.p!r}; try {type(self).__name__}(3, 2)"
            )

    @property
    def dimension(self) -> int:
        return self.n * self.p - self.p * (self.p + 1) // 2

    @property
    def ambient(self) -> jax.ShapeDtypeStruct:
        return real((self.n, self.p))

    def turns(self, k: int) -> np.ndarray:
        """An orthogonal basis of the skew ``k x k`` matrices, all of one length.

        Parameters
        ----------
        k : int
            The size.
        """
        return skew_basis(k)

    def skew(self, x: Array, v: Array) -> Array:
        r"""The rotation of the frame in its own span, :math:`\mathrm{skew}(x^T v)`, shape ``(p, p)``; exactly skew
        for any ``v``.

        Parameters
        ----------
        x : array of shape (n, p)
            A point.
        v : array of shape (n, p)
            A tangent vector there.
        """
        a = x.conj().T @ v
        return (a - a.conj().T) / 2

    def projection(self, x: Array, a: Array) -> Array:
        return a - x @ symmetric(x.conj().T @ a)

    def basis(self, x: Array) -> Array:
        """Rotations of the frame in its span, then turns of each column towards each direction of the complement."""
        turns, units = self.turns(self.p), jnp.eye(self.p, dtype=x.dtype)
        inside = x @ jnp.asarray(turns / np.linalg.norm(turns, axis=(1, 2), keepdims=True), x.dtype)
        units = jnp.concatenate([units, 1j * units]) if jnp.iscomplexobj(x) else units
        outside = jnp.einsum("ni,jk->ijnk", complement(x), units)
        return jnp.concatenate([inside, outside.reshape(-1, self.n, self.p)])

    def restore(self, x: Array) -> Array:
        # Newton-Schulz: the polar factor to second order.
        return x @ (3 * jnp.eye(self.p, dtype=x.dtype) - x.conj().T @ x) / 2

    def violations(self, x: Array) -> dict[str, Array]:
        return {"max |x'x - I|": vec.size(x.conj().T @ x - jnp.eye(self.p, dtype=x.dtype))}

    def generators(self, x: Array) -> Array:
        return jnp.asarray(self.turns(self.n), x.dtype) @ x

    def random_point(self, key: Array) -> Array:
        return qr_factor(jax.random.normal(key, (self.n, self.p), self.ambient.dtype))


@final
class ComplexStiefel(Stiefel):
    r"""The complex Stiefel manifold :math:`\{x : x^H x = I\}` of ``p`` orthonormal columns in ``C^n``.

    Parameters
    ----------
    n : int
        The number of rows.
    p : int
        The number of columns; points are complex, shape ``(n, p)``.

    Notes
    -----
    The dimension is :math:`2np - p^2`. ``ComplexStiefel(n, 1)`` is the sphere of dimension ``2n - 1``: the states of a
    quantum system with their phases. ``ComplexStiefel(n, n)`` is U(n). The basis :math:`e_i` of the momentum is the
    basis of U(n).

    Examples
    --------
    >>> ComplexStiefel(2, 1).dimension
    3
    """

    @property
    def dimension(self) -> int:
        return self.p * (2 * self.n - self.p)

    @property
    def ambient(self) -> jax.ShapeDtypeStruct:
        return complex_entries((self.n, self.p))

    def turns(self, k: int) -> np.ndarray:
        return U(k).algebra


@final
class CanonicalMetric(Metric):
    r"""The canonical metric :math:`g_x(v, w) = \mathrm{tr}\, v^T (I - x x^T / 2) w` of the frames, as a quotient of
    the rotations.

    Parameters
    ----------
    manifold : Stiefel
        The manifold.

    Notes
    -----
    A rotation of the frame in its own span counts half as much as in the ambient metric.

    References
    ----------
    Edelman, Arias, Smith, The geometry of algorithms with orthogonality constraints, 1998, 2.4.1.

    Examples
    --------
    >>> x = jnp.eye(3)[:, :2]
    >>> v = jnp.array([[0.0, -1.0], [1.0, 0.0], [0.0, 0.0]])
    >>> float(CanonicalMetric(Stiefel(3, 2)).inner_product(x, v, v))
    1.0
    """

    manifold: Stiefel

    def inner_product(self, x: Array, v: Array, w: Array) -> Array:
        return vec.pairing(v, w) - vec.pairing(x.conj().T @ v, x.conj().T @ w) / 2

    def kinetic_energy(self, x: Array, p: Array) -> Array:
        p = self.manifold.projection(x, p)
        inside = x.conj().T @ p
        return (vec.pairing(p, p) + vec.pairing(inside, inside)) / 2
