"""The group of rigid motions."""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..numerics import ambient as vec
from ..numerics.sizes import plain, require_size
from .matrix_lie_group import MatrixLieGroup
from .special_orthogonal import nearly_orthogonal, random_rotation, rotation_violations, skew_basis


@final
class SE(MatrixLieGroup):
    r"""The special Euclidean group: rigid motions of n-space as homogeneous matrices ``[[R, t], [0, 1]]``.

    Parameters
    ----------
    n : int
        The dimension of the space; points have shape ``(n + 1, n + 1)``.

    Notes
    -----
    ``x`` maps body to spatial coordinates, :math:`y \mapsto R y + t`. Tangent vectors are
    :math:`x [[\Omega, v], [0, 0]]`. Coordinates are twists :math:`(\omega, v)` with the angular part first: for n = 3
    the angular and linear velocity in body coordinates; for n = 2 :math:`\omega` is one number. Body and spatial
    covectors are wrenches ``(moment, force)``.

    References
    ----------
    Lynch, Park, Modern Robotics, 2017, section 3.3.

    Examples
    --------
    >>> SE(3).dimension
    6
    """

    n: int = eqx.field(static=True, converter=plain)

    def __check_init__(self) -> None:
        require_size(self, self.n, 2)

    @property
    def algebra(self) -> np.ndarray:
        n, rotations = self.n, skew_basis(self.n)
        out = np.zeros((len(rotations) + n, n + 1, n + 1))
        out[: len(rotations), :n, :n] = rotations
        out[len(rotations) :, :n, n] = np.eye(n)
        return out

    def pose(self, rotation: Float[Array, "n n"], translation: Float[Array, " n"]) -> Array:
        r"""The motion :math:`y \mapsto R y + t`, shape ``(n + 1, n + 1)``.

        Parameters
        ----------
        rotation : array of shape (n, n)
            The rotation ``R``.
        translation : array of shape (n,)
            The translation ``t``.
        """
        return homogeneous(jnp.asarray(rotation), jnp.asarray(translation), 1.0)

    def tangent(self, turn: Float[Array, "n n"], shift: Float[Array, " n"]) -> Array:
        """The matrix ``[[turn, shift], [0, 0]]``: a tangent vector ``(R Omega, R v)``, or an element ``(Omega, v)``
        of the algebra.

        Parameters
        ----------
        turn : array of shape (n, n)
            The angular part.
        shift : array of shape (n,)
            The linear part.
        """
        return homogeneous(jnp.asarray(turn), jnp.asarray(shift), 0.0)

    def parts(self, x: Array) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
        """The blocks ``(R, t)`` of a motion, or the blocks of a tangent vector.

        Parameters
        ----------
        x : array of shape (n + 1, n + 1)
            A motion or a tangent vector.
        """
        return blocks(x)

    def algebra_part(self, a: Array) -> Array:
        block, v = self.parts(a)
        return homogeneous((block - block.T) / 2, v, 0.0)

    def inverse(self, x: Array) -> Array:
        rotation, translation = self.parts(x)
        return homogeneous(rotation.T, -rotation.T @ translation, 1.0)

    def restore(self, x: Array) -> Array:
        rotation, translation = self.parts(x)
        return homogeneous(nearly_orthogonal(rotation), translation, 1.0)

    def violations(self, x: Array) -> dict[str, Array]:
        last = vec.size(x[-1] - jnp.eye(self.n + 1, dtype=x.dtype)[-1])
        return {**rotation_violations("R", self.parts(x)[0]), "max |last row - (0, ..., 0, 1)|": last}

    def random_point(self, key: Array) -> Array:
        """A uniformly distributed rotation and a normally distributed translation."""
        turn, shift = jax.random.split(key)
        return homogeneous(random_rotation(turn, self.n), jax.random.normal(shift, (self.n,)), 1.0)


def blocks(x: Array) -> tuple[Array, Array]:
    """``block`` and ``column`` of ``[[block, column], [0, corner]]``."""
    return x[:-1, :-1], x[:-1, -1]


def homogeneous(block: Array, column: Array, corner: float) -> Array:
    """``[[block, column], [0, corner]]``."""
    last = jnp.zeros((1, block.shape[0] + 1), block.dtype).at[0, -1].set(corner)
    return jnp.concatenate([jnp.concatenate([block, column[:, None]], axis=1), last])
