"""The special linear group."""

from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..numerics.sizes import plain, require_size
from .matrix_lie_group import MatrixLieGroup


@final
class SL(MatrixLieGroup):
    r"""The special linear group: matrices of determinant one, of dimension ``n^2 - 1``.

    Parameters
    ----------
    n : int
        The size; points have shape ``(n, n)``.

    Notes
    -----
    The basis of the algebra is :math:`E_{ij}` with :math:`i \ne j`, row by row, then :math:`E_{ii} - E_{i+1,i+1}`.

    Examples
    --------
    >>> SL(2).dimension
    3
    """

    n: int = eqx.field(static=True, converter=plain)

    def __check_init__(self) -> None:
        require_size(self, self.n, 2)

    @property
    def algebra(self) -> np.ndarray:
        units = np.eye(self.n * self.n).reshape(self.n, self.n, self.n, self.n)
        mixed = [units[i, j] for i in range(self.n) for j in range(self.n) if i != j]
        return np.stack(mixed + [units[i, i] - units[i + 1, i + 1] for i in range(self.n - 1)])

    def algebra_part(self, a: Array) -> Array:
        return a - jnp.trace(a) / self.n * jnp.eye(self.n, dtype=a.dtype)
