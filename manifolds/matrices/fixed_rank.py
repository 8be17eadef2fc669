"""Matrices of one rank."""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..manifold import Manifold
from ..numerics.errors import InvalidInputError
from ..numerics.frames import adapted_frame, leading_projector, qr_factor
from ..numerics.precision import default_tolerance, real
from ..numerics.sizes import are_whole, plain


@final
class FixedRank(Manifold):
    r"""The manifold of matrices of shape ``(m, n)`` and rank ``r``; points are the matrices themselves.

    Parameters
    ----------
    m, n : int
        The shape of points.
    r : int
        Their rank.

    Notes
    -----
    With the orthogonal projectors ``c`` and ``d`` on the spans of the columns and rows of a point, normal vectors are
    :math:`(I - c)\, a\, (I - d)`. Off the manifold the spans belong to the ``r`` leading singular vectors. All of this
    is smooth if the ``r``-th singular value is larger than the next one.

    References
    ----------
    Vandereycken, Low-rank matrix completion by Riemannian optimization, 2013.

    Examples
    --------
    >>> FixedRank(5, 4, 2).dimension
    14
    """

    m: int = eqx.field(static=True, converter=plain)
    n: int = eqx.field(static=True, converter=plain)
    r: int = eqx.field(static=True, converter=plain)

    def __check_init__(self) -> None:
        if not are_whole(self.m, self.n, self.r) or not 1 <= self.r < min(self.m, self.n):
            raise InvalidInputError(
                "FixedRank(m, n, r) holds m x n matrices of rank r, whole numbers 1 <= r < min(m, n); "
                f"got m = {self.m!r}, n = {self.n!r}, r = {self.r!r}. Full rank is an open set: try Euclidean((m, n))"
            )

    @property
    def dimension(self) -> int:
        return self.r * (self.m + self.n - self.r)

    @property
    def ambient(self) -> jax.ShapeDtypeStruct:
        return real((self.m, self.n))

    def projectors(self, x: Array) -> tuple[Array, Array]:
        """The orthogonal projectors on the spans of the columns, shape ``(m, m)``, and of the rows, shape ``(n,
        n)``.

        Parameters
        ----------
        x : array of shape (m, n)
            A point.
        """
        return leading_projector(x, self.r), leading_projector(x.T, self.r)

    def projection(self, x: Array, a: Array) -> Array:
        c, d = self.projectors(x)
        inside = c @ a
        return inside + (a - inside) @ d

    def basis(self, x: Array) -> Array:
        columns, rows = (adapted_frame(projector, self.r) for projector in self.projectors(x))
        normal = np.add.outer(np.arange(self.m) >= self.r, np.arange(self.n) >= self.r, dtype=int) == 2
        i, j = np.nonzero(~normal)
        return jnp.einsum("mk,nk->kmn", columns[:, i], rows[:, j])

    def restore(self, x: Array) -> Array:
        """The nearest matrix of rank ``r``."""
        return leading_projector(x, self.r) @ x

    def violations(self, x: Array) -> dict[str, Array]:
        singular = jnp.linalg.svd(x, compute_uv=False)
        lost = jnp.sum(singular[: self.r] <= default_tolerance() * singular[0])
        return {
            f"singular value {self.r + 1} over the first": singular[self.r] / singular[0],
            f"singular values that vanish among the first {self.r}": lost,
        }

    def random_point(self, key: Array) -> Array:
        """Columns and rows in random directions, singular values between 1 and 2."""
        left, middle, right = jax.random.split(key, 3)
        u = qr_factor(jax.random.normal(left, (self.m, self.r)))
        w = qr_factor(jax.random.normal(right, (self.n, self.r)))
        return u * jax.random.uniform(middle, (self.r,), minval=1.0, maxval=2.0) @ w.T
