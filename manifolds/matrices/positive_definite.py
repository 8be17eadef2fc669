"""Symmetric positive definite matrices."""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Float

from ..manifold import HomogeneousSpace
from ..metric import Metric
from ..numerics import ambient as vec
from ..numerics.matrices import symmetric
from ..numerics.precision import real
from ..numerics.sizes import plain, require_size


def symmetric_basis(n: int) -> np.ndarray:
    """Orthonormal basis of the symmetric ``n x n`` matrices, shape ``(n(n+1)/2, n, n)``."""
    rows, columns = np.triu_indices(n)
    out = np.zeros((rows.size, n, n))
    size = np.where(rows == columns, 1.0, np.sqrt(0.5))
    out[np.arange(rows.size), rows, columns] = size
    out[np.arange(rows.size), columns, rows] = size
    return out


@final
class SPD(HomogeneousSpace):
    r"""The manifold of symmetric positive definite matrices, an open cone in the symmetric matrices.

    Parameters
    ----------
    n : int
        The size; points have shape ``(n, n)``.

    Notes
    -----
    Invertible matrices ``g`` act by :math:`x \mapsto g x g^T`; the ``n^2`` generators are
    :math:`e_{ij} x + x e_{ij}^T`.

    Examples
    --------
    >>> SPD(3).dimension
    6
    """

    n: int = eqx.field(static=True, converter=plain)

    def __check_init__(self) -> None:
        require_size(self, self.n, 1)

    @property
    def dimension(self) -> int:
        return self.n * (self.n + 1) // 2

    @property
    def ambient(self) -> jax.ShapeDtypeStruct:
        return real((self.n, self.n))

    def projection(self, x: Array, a: Array) -> Array:
        return symmetric(a)

    def basis(self, x: Array) -> Float[Array, "k n n"]:
        return jnp.asarray(symmetric_basis(self.n), x.dtype)

    def restore(self, x: Array) -> Array:
        return symmetric(x)

    def violations(self, x: Array) -> dict[str, Array]:
        negative = jnp.sum(jnp.linalg.eigvalsh(symmetric(x)) <= 0)
        return {"max |x - x'|": vec.size(x - x.T), "number of eigenvalues not positive": negative}

    def generators(self, x: Array) -> Array:
        units = jnp.eye(self.n**2, dtype=x.dtype).reshape(-1, self.n, self.n)
        return 2 * jax.vmap(symmetric)(units @ x)

    def length(self, x: Array, a: Array) -> Array:
        """The largest entry of :math:`l^{-1} a l^{-T}` with :math:`x = l l^T`: relative to ``x``, invariant under
        the action.
        """
        factor = jnp.linalg.cholesky(x)
        return vec.size(solve_triangular(factor, solve_triangular(factor, a, lower=True).T, lower=True))

    def distance(self, x: Array, y: Array) -> Array:
        r"""The distance in ``AffineInvariantMetric``, :math:`|\log(x^{-1/2} y x^{-1/2})|`.

        Parameters
        ----------
        x, y : array of shape (n, n)
            Two points.

        Notes
        -----
        With :math:`x = l l^T` and :math:`y = k k^T` it is twice the norm of the logarithms of the singular values of
        :math:`l^{-1} k`. The smallest of these keeps its digits, unlike the eigenvalues of :math:`x^{-1} y`. Its
        derivative at ``x = y`` is set to 0.
        """
        ratio = solve_triangular(jnp.linalg.cholesky(x), jnp.linalg.cholesky(y), lower=True)
        logarithms = 2 * jnp.log(jnp.linalg.svd(ratio, compute_uv=False))
        apart = vec.size(logarithms) > 0
        return jnp.where(apart, jnp.linalg.norm(jnp.where(apart, logarithms, 1.0)), 0.0)

    def random_point(self, key: Array) -> Array:
        """``I`` plus a Wishart matrix: well conditioned."""
        a = jax.random.normal(key, (self.n, self.n))
        return jnp.eye(self.n) + a @ a.T / self.n


@final
class AffineInvariantMetric(Metric):
    r"""The affine-invariant metric :math:`g_x(v, w) = \mathrm{tr}(x^{-1} v x^{-1} w)` of the positive definite
    matrices.

    Parameters
    ----------
    manifold : SPD
        The manifold.

    Examples
    --------
    >>> I = jnp.eye(2)
    >>> float(AffineInvariantMetric(SPD(2)).inner_product(2 * I, I, I))
    0.5
    """

    manifold: SPD

    def inner_product(self, x: Array, v: Array, w: Array) -> Array:
        return jnp.trace(jnp.linalg.solve(x, v) @ jnp.linalg.solve(x, w))

    def kinetic_energy(self, x: Array, p: Array) -> Array:
        moved = x @ symmetric(p)
        return jnp.trace(moved @ moved) / 2
