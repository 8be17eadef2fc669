"""The rotation group."""

from functools import cache
from itertools import combinations
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..numerics import ambient as vec
from ..numerics.frames import qr_factor
from ..numerics.sizes import plain, require_size
from .matrix_lie_group import MatrixLieGroup


@cache
def skew_basis(n: int) -> np.ndarray:
    """Basis ``e_i`` of the skew ``n x n`` matrices, shape ``(n(n-1)/2, n, n)``: ``hat`` of the axes for n = 3."""
    planes = [(1, 2), (2, 0), (0, 1)] if n == 3 else list(combinations(range(n), 2))
    out = np.zeros((len(planes), n, n))
    for k, (i, j) in enumerate(planes):
        out[k, j, i], out[k, i, j] = 1.0, -1.0
    out.setflags(write=False)
    return out


def hat(w: Float[ArrayLike, "... 3"]) -> Float[Array, "... 3 3"]:
    r"""The skew matrix of a vector, with :math:`\hat w\, y = w \times y`.

    Parameters
    ----------
    w : array_like of shape (..., 3)
        Vectors; ``TypeError`` if the last axis has another length.

    Returns
    -------
    Array of shape (..., 3, 3)
        Skew matrices.

    Examples
    --------
    >>> hat([0.0, 0.0, 1.0])[0, 1].item()
    -1.0
    """
    w = _real_array("hat", w, (3,))
    return jnp.tensordot(w, jnp.asarray(skew_basis(3), w.dtype), 1)


def vee(a: Float[ArrayLike, "... 3 3"]) -> Float[Array, "... 3"]:
    """The vector of the skew part of a matrix: ``vee(hat(w)) = w``.

    Parameters
    ----------
    a : array_like of shape (..., 3, 3)
        Matrices; ``TypeError`` for another shape.

    Returns
    -------
    Array of shape (..., 3)
        Vectors.

    Examples
    --------
    >>> vee(hat([1.0, 2.0, 3.0])).tolist()
    [1.0, 2.0, 3.0]
    """
    a = _real_array("vee", a, (3, 3))
    return jnp.einsum("kij,...ij->...k", jnp.asarray(skew_basis(3) / 2, a.dtype), a)


def _real_array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """``value`` as an array with the last axes ``shape``; whole numbers become floats."""
    array = jnp.asarray(value)
    if array.shape[-len(shape) :] != shape:
        raise TypeError(f"{name} takes an array whose last axes are {shape}, got one of shape {array.shape}")
    return array if jnp.issubdtype(array.dtype, jnp.inexact) else array.astype(float)


@final
class SO(MatrixLieGroup):
    r"""The special orthogonal group: rotations :math:`\{x : x^T x = I,\ \det x = 1\}` of n-space.

    Parameters
    ----------
    n : int
        The dimension of the space; points have shape ``(n, n)``.

    Notes
    -----
    Tangent vectors are :math:`x \Omega` with :math:`\Omega` skew. The group acts by multiplication from the left. With
    the basis :math:`e_i` of skew matrices (``hat`` of the axes for n = 3), the body covector is
    :math:`\langle p, x e_i \rangle` and the spatial covector :math:`\langle p, e_i x \rangle`, the momentum of the
    action. For n = 3 these are the vectors :math:`\mu` with :math:`\langle p, x \hat w \rangle = \mu \cdot w`, and
    :math:`x \mu`.

    Examples
    --------
    >>> SO(3).dimension, bool(SO(3).contains(jnp.eye(3)))
    (3, True)
    """

    n: int = eqx.field(static=True, converter=plain)

    def __check_init__(self) -> None:
        require_size(self, self.n, 2)

    @property
    def algebra(self) -> np.ndarray:
        return skew_basis(self.n)

    def algebra_part(self, a: Array) -> Array:
        return (a - a.T) / 2

    def inverse(self, x: Array) -> Array:
        return x.T

    def restore(self, x: Array) -> Array:
        return nearly_orthogonal(x)

    def violations(self, x: Array) -> dict[str, Array]:
        return rotation_violations("x", x)

    def hint_for_shape(self, k: int, shape: tuple[int, ...], role: str) -> str:
        kind = next((word for word in ("covector", "vector") if word in role), "point")
        match self.n, shape, kind:
            case 3, (3,), "point":
                return "; for a rotation vector try scipy's Rotation.from_rotvec(v).as_matrix()"
            case 3, (3,), "vector":
                return "; for a body rate w try R @ hat(w)"
            case 3, (3,), "covector":
                return "; for a body momentum m try SO(3).covector(R, m)"
            case 3, (4,), "point":
                reader = 'retrax.interop.from_quaternions(q, "last")'
                return f'; for a quaternion try {reader}, or "first" for its scalar part'
        return ""

    def random_point(self, key: Array) -> Array:
        return random_rotation(key, self.n)


def nearly_orthogonal(x: Array) -> Array:
    """The polar factor of a nearly orthogonal or unitary matrix, to second order in its error (Newton-Schulz)."""
    return x @ (3 * jnp.eye(x.shape[0], dtype=x.dtype) - x.conj().T @ x) / 2


def rotation_violations(name: str, x: Array) -> dict[str, Array]:
    """The equations of rotations in words, and how much ``x`` violates them."""
    gram = vec.size(x.T @ x - jnp.eye(x.shape[0], dtype=x.dtype))
    return {f"max |{name}'{name} - I|": gram, f"|det {name} - 1|": jnp.abs(jnp.linalg.det(x) - 1)}


def random_rotation(key: Array, n: int) -> Array:
    """A rotation drawn from the uniform distribution."""
    q = qr_factor(jax.random.normal(key, (n, n)))
    # Not by q.at[:, 0].multiply: XLA 0.10 writes that over q where the caller takes one of a batch,
    # jit(vmap(...))(...)[0].
    return q * jnp.where((jnp.arange(n) == 0) & (jnp.linalg.det(q) < 0), -1.0, 1.0)
