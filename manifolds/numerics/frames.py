"""Orthonormal frames and the projectors on their spans, smooth where singular value decompositions are not.

The derivative of a singular vector divides by the gaps between singular values; a projector on a span of singular
vectors needs only the one gap between those inside and those outside. Where a frame is chosen, the choice is frozen and
the frame moves smoothly from there.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .matrices import lyapunov
from .tolerances import HALF, tolerance

Frame = Float[Array, "n p"]
Matrix = Float[Array, "n n"]


def qr_factor(a: Frame) -> Frame:
    """Orthonormal factor ``q`` of ``a = q r`` with a positive diagonal of the triangular ``r``."""
    q, r = jnp.linalg.qr(a)
    d = jnp.diagonal(r)
    return q * (d / jnp.abs(d) if jnp.iscomplexobj(d) else jnp.where(d < 0, -1.0, 1.0))


def polar_factor(a: Frame) -> Frame:
    """Orthonormal factor ``y`` of ``a = y s``, ``s`` symmetric positive definite: the nearest orthonormal frame.

    Unitary, and ``s`` Hermitian, for a complex ``a``, which is worked on as the real ``[[Re a, -Im a], [Im a, Re a]]``.
    """
    if not jnp.iscomplexobj(a):
        return _real_polar_factor(a)
    n, p = a.shape
    y = _real_polar_factor(jnp.block([[a.real, -a.imag], [a.imag, a.real]]))
    return made_orthonormal(y[:n, :p] + 1j * y[n:, :p])


def made_orthonormal(y: Frame) -> Frame:
    """A nearly orthonormal frame after a step of Newton and Schulz, NaN unless half of its digits were right.

    Functions of a large matrix with small eigenvalues, as of a rotation in a plane, lose as many digits as it has.
    """
    defect = y.conj().T @ y - jnp.eye(y.shape[1], dtype=y.dtype)
    seen = jnp.max(jnp.abs(jax.lax.stop_gradient(defect))) <= tolerance(y, HALF)
    return jnp.where(seen, y - y @ defect / 2, jnp.nan)


@jax.custom_jvp
def _real_polar_factor(a: Frame) -> Frame:
    """Derivative: ``y t + (I - yy') da s^-1`` with the skew ``t`` of ``s t + t s = y'da - da'y``."""
    if a.shape[0] == a.shape[1]:
        u, _, w = jnp.linalg.svd(a)
        return u @ w
    q, r = jnp.linalg.qr(a)
    return q @ _real_polar_factor(r)


@_real_polar_factor.defjvp
def _real_polar_factor_jvp(primals: tuple[Frame], tangents: tuple[Frame]) -> tuple[Frame, Frame]:
    (a,), (da,) = primals, tangents
    y = _real_polar_factor(a)
    s, inside = y.T @ a, y.T @ da
    s = (s + s.T) / 2
    return y, y @ lyapunov(s, inside - inside.T) + jnp.linalg.solve(s, (da - y @ inside).T).T


def complement(x: Frame) -> Float[Array, "n n-p"]:
    """Orthonormal frame of the orthogonal complement of the span of an orthonormal frame.

    With ``e`` the first ``p`` columns of the identity, ``s`` diagonal with entries of size one and ``w = x - e s``, the
    matrix ``I + w (w'e s)^-1 w'`` is orthogonal, unitary for a complex ``x``, and takes ``e s`` to ``x``, hence the
    other columns of the identity to the complement. The signs are those of Householder's reflections, which keep
    ``w'e s`` invertible.
    """
    p = x.shape[1]
    s = _reflection_signs(jax.lax.stop_gradient(x[:p]))
    w = jnp.asarray(x).at[:p].add(-jnp.diag(s))
    z = w @ jnp.linalg.solve(w[:p].conj().T * s, w[p:].conj().T)
    return z.at[p:].add(jnp.eye(z.shape[1], dtype=x.dtype))


def _reflection_signs(top: Matrix) -> Float[Array, " p"]:
    """Signs opposite to the pivots in the elimination of ``top - diag(s)`` [Ballard et al. 2014, modified LU]."""
    return jax.lax.fori_loop(0, top.shape[0], _eliminate, (top, jnp.zeros_like(top[0])))[1]


def _eliminate(k: Array, state: tuple[Matrix, Array]) -> tuple[Matrix, Array]:
    a, s = state
    sign = jnp.where(a[k, k].real < 0, 1.0, -1.0).astype(a.dtype)
    return a - jnp.outer(a[:, k], a[k] / (a[k, k] - sign)), s.at[k].set(sign)


def null_frame(rows: Float[Array, "m n"]) -> Float[Array, "n-m n"]:
    """Orthonormal rows that span the null space of independent rows."""
    return complement(_orthonormalized(rows.T)).T


def adapted_frame(projector: Matrix, rank: int) -> Matrix:
    """Orthogonal matrix whose first ``rank`` columns span the image of an orthogonal projector, and the last columns
    its kernel.

    Columns of the projector, and of that on the kernel, made orthonormal; which ones is frozen, they move with it.
    """
    n = projector.shape[0]
    image = _spanned(projector, rank)
    kernel = _spanned(jnp.eye(n, dtype=projector.dtype) - image @ image.T, n - rank)
    return jnp.concatenate([image, kernel], axis=1)


def _spanned(projector: Matrix, rank: int) -> Frame:
    """Orthonormal columns, as many as the rank of a projector, that span its image."""
    return _orthonormalized(projector @ _pivots(jax.lax.stop_gradient(projector), rank).T)


def _orthonormalized(columns: Frame) -> Frame:
    """Orthonormal columns with the span of independent columns, by Gram and Schmidt's process.

    Twice, because the rounding of the first time grows with the square of the condition of the columns.
    """
    for _ in range(2):
        factor = jnp.linalg.cholesky(columns.T @ columns)
        columns = jax.scipy.linalg.solve_triangular(factor, columns.T, lower=True).T
    return columns


def _pivots(projector: Matrix, rank: int) -> Float[Array, "p n"]:
    """The unit vectors whose images elimination finds farthest from the span of the earlier images."""
    names = jnp.arange(projector.shape[0])

    def eliminate(a: Matrix, _: None) -> tuple[Matrix, Array]:
        chosen = jnp.where(names == jnp.argmax(jnp.diagonal(a)), 1.0, 0.0).astype(a.dtype)
        column = a @ chosen
        return a - jnp.outer(column, column) / (column @ chosen), chosen

    return jax.lax.scan(eliminate, projector, None, length=rank)[1]


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def leading_projector(a: Float[Array, "m n"], rank: int) -> Float[Array, "m m"]:
    """Orthogonal projector on the span of the ``rank`` leading left singular vectors, ``rank < min(m, n)``.

    ``2 p - I`` is the sign ``s`` of ``b = aa' - mu``, for a number ``mu`` between the two squared singular values; it
    is differentiated by ``|b| ds + ds |b| = db - s db s``, which needs the gap between these two values and no other.
    """
    u = jnp.linalg.svd(a, full_matrices=False)[0][:, :rank]
    return u @ u.T


@leading_projector.defjvp
def _leading_projector_jvp(rank: int, primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    (a,), (da,) = primals, tangents
    p = leading_projector(a, rank)
    eye = jnp.eye(p.shape[0], dtype=p.dtype)
    inside, outside = jnp.linalg.svd(jax.lax.stop_gradient(a), compute_uv=False)[rank - 1 : rank + 1]
    sign, db = 2 * p - eye, da @ a.T + a @ da.T
    size = sign @ (a @ a.T - (inside**2 + outside**2) / 2 * eye)
    return p, lyapunov((size + size.T) / 2, db - sign @ db @ sign) / 2
