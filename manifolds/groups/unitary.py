"""The unitary groups: complex entries, real dimension."""

from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..numerics import ambient as vec
from ..numerics.frames import qr_factor
from ..numerics.matrices import determinant
from ..numerics.precision import complex_entries
from ..numerics.sizes import plain, require_size
from .matrix_lie_group import MatrixLieGroup
from .special_orthogonal import nearly_orthogonal


def gell_mann_basis(n: int) -> np.ndarray:
    """Basis ``-i lambda_k / 2`` of the traceless skew-Hermitian matrices, shape ``(n^2 - 1, n, n)``.

    ``lambda_k`` are the generalised Gell-Mann matrices in their usual order, the Pauli matrices for n = 2, with
    ``tr(lambda_j lambda_k) = 2 delta_jk``. For n = 2 the commutators are those of ``hat`` of the axes: ``[e_1, e_2] =
    e_3``.
    """
    out = np.zeros((n * n - 1, n, n), complex)
    row = 0
    for k in range(1, n):
        for j in range(k):
            out[row, j, k] = out[row, k, j] = 1
            out[row + 1, j, k], out[row + 1, k, j] = -1j, 1j
            row += 2
        out[row] = np.sqrt(2 / (k * (k + 1))) * np.diag([1.0] * k + [-k] + [0.0] * (n - k - 1))
        row += 1
    return -0.5j * out


def _skew_hermitian_part(a: Array) -> Array:
    return (a - a.conj().T) / 2


def _gram_violation(x: Array) -> dict[str, Array]:
    return {"max |x^H x - I|": vec.size(x.conj().T @ x - jnp.eye(x.shape[0], dtype=x.dtype))}


def _random_unitary(key: Array, n: int) -> Array:
    """A unitary matrix drawn from the uniform distribution [Mezzadri 2007]."""
    return qr_factor(vec.normal(key, complex_entries((n, n))))


def _without_phase(x: Array) -> Array:
    """A unitary matrix times the phase that makes its determinant one."""
    return x * jnp.exp(-1j * jnp.angle(determinant(x)) / x.shape[0])


@final
class U(MatrixLieGroup):
    r"""The unitary group :math:`\{x : x^H x = I\}`, of dimension ``n^2``; points are complex.

    Parameters
    ----------
    n : int
        The size; points have shape ``(n, n)``.

    Notes
    -----
    The basis of the algebra is :math:`-i \sqrt{2/n}\, I / 2`, followed by the basis of SU(n).

    Examples
    --------
    >>> U(2).dimension
    4
    """

    n: int = eqx.field(static=True, converter=plain)

    def __check_init__(self) -> None:
        require_size(self, self.n, 1)

    @property
    def algebra(self) -> np.ndarray:
        phase = -0.5j * np.sqrt(2 / self.n) * np.eye(self.n)
        return np.concatenate([phase[None], gell_mann_basis(self.n)])

    def algebra_part(self, a: Array) -> Array:
        return _skew_hermitian_part(a)

    def inverse(self, x: Array) -> Array:
        return x.conj().T

    def restore(self, x: Array) -> Array:
        return nearly_orthogonal(x)

    def violations(self, x: Array) -> dict[str, Array]:
        return _gram_violation(x)

    def random_point(self, key: Array) -> Array:
        return _random_unitary(key, self.n)


@final
class SU(MatrixLieGroup):
    r"""The special unitary group :math:`\{x : x^H x = I,\ \det x = 1\}`, of dimension ``n^2 - 1``; points are
    complex.

    Parameters
    ----------
    n : int
        The size; points have shape ``(n, n)``.

    Notes
    -----
    The basis of the algebra is :math:`-i \lambda_k / 2` with the generalised Gell-Mann matrices :math:`\lambda_k`. For
    n = 2, the unit quaternions, coordinates ``w`` are the coordinates of SO(3): ``exp(hat(w))`` rotates space by the
    rotation vector ``w``.

    Examples
    --------
    >>> SU(2).dimension
    3
    """

    n: int = eqx.field(static=True, converter=plain)

    def __check_init__(self) -> None:
        require_size(self, self.n, 2)

    @property
    def algebra(self) -> np.ndarray:
        return gell_mann_basis(self.n)

    def algebra_part(self, a: Array) -> Array:
        skew = _skew_hermitian_part(a)
        return skew - jnp.trace(skew) / self.n * jnp.eye(self.n)

    def inverse(self, x: Array) -> Array:
        return x.conj().T

    def restore(self, x: Array) -> Array:
        return _without_phase(nearly_orthogonal(x))

    def violations(self, x: Array) -> dict[str, Array]:
        return {**_gram_violation(x), "|det x - 1|": jnp.abs(determinant(x) - 1)}

    def random_point(self, key: Array) -> Array:
        return _without_phase(_random_unitary(key, self.n))
