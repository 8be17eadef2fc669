"""Subspaces, as orthogonal projectors."""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..groups.special_orthogonal import skew_basis
from ..manifold import HomogeneousSpace
from ..numerics import ambient as vec
from ..numerics.errors import InvalidInputError
from ..numerics.frames import adapted_frame, qr_factor
from ..numerics.precision import real
from ..numerics.sizes import are_whole, plain


@final
class Grassmann(HomogeneousSpace):
    r"""The Grassmann manifold of ``p``-dimensional subspaces of ``R^n``, as
    :math:`\{x : x^T = x,\ x^2 = x,\ \mathrm{tr}\,x = p\}`.

    Parameters
    ----------
    n : int
        The dimension of the space; points have shape ``(n, n)``.
    p : int
        The dimension of the subspaces.

    Notes
    -----
    A point is the orthogonal projector on the subspace; no frame is necessary. Tangent vectors are the symmetric ``v``
    with :math:`x v + v x = v`. A rotation of one direction by a small angle ``t`` has length :math:`\sqrt2\, t` in the
    ambient metric. Rotations act by :math:`x \mapsto g x g^T` with momentum :math:`J_i = \langle p, [e_i, x] \rangle`.

    References
    ----------
    Bendokat, Zimmermann, Absil, A Grassmann manifold handbook, 2024.

    Examples
    --------
    >>> Grassmann(5, 2).dimension
    6
    """

    n: int = eqx.field(static=True, converter=plain)
    p: int = eqx.field(static=True, converter=plain)

    def __check_init__(self) -> None:
        if not are_whole(self.n, self.p) or not 1 <= self.p < self.n:
            raise InvalidInputError(
                "Grassmann(n, p) holds the p-dimensional subspaces of R^n, whole numbers 1 <= p < n; "
                f"got n = {self.n!r}, p = {self.p!r}; try Grassmann(3, 1)"
            )

    @property
    def dimension(self) -> int:
        return self.p * (self.n - self.p)

    @property
    def ambient(self) -> jax.ShapeDtypeStruct:
        return real((self.n, self.n))

    def rotation(self, x: Array, v: Array) -> Array:
        """The infinitesimal rotation ``[v, x]``, exactly skew, that moves ``x`` along ``v``: ``v = [[v, x], x]``.

        Parameters
        ----------
        x : array of shape (n, n)
            A point.
        v : array of shape (n, n)
            A tangent vector there.
        """
        s = (v + v.T) @ x / 2
        return s - s.T

    def projection(self, x: Array, a: Array) -> Array:
        s = x @ (a + a.T) / 2
        return s + s.T - 2 * s @ x

    def basis(self, x: Array) -> Array:
        frame = adapted_frame(x, self.p)
        turns = jnp.einsum("ni,mj->ijnm", frame[:, : self.p], frame[:, self.p :]).reshape(-1, self.n, self.n)
        return (turns + jnp.swapaxes(turns, 1, 2)) / np.sqrt(2)

    def restore(self, x: Array) -> Array:
        # McWeeny's purification: eigenvalues go to 0 and 1 quadratically.
        s = (x + x.T) / 2
        return 3 * s @ s - 2 * s @ s @ s

    def violations(self, x: Array) -> dict[str, Array]:
        return {
            "max |x - x'|": vec.size(x - x.T),
            "max |x^2 - x|": vec.size(x @ x - x),
            f"|tr x - {self.p}|": jnp.abs(jnp.trace(x) - self.p),
        }

    def generators(self, x: Array) -> Array:
        e = jnp.asarray(skew_basis(self.n), x.dtype)
        return e @ x - x @ e

    def hint_for_shape(self, k: int, shape: tuple[int, ...], role: str) -> str:
        return "; a point is a projector, of a frame try frame @ frame.T" if shape == (self.n, self.p) else ""

    def random_point(self, key: Array) -> Array:
        q = qr_factor(jax.random.normal(key, (self.n, self.p)))
        return q @ q.T
