"""Functions of skew-Hermitian and unitary matrices, real ones included, with derivatives that are right everywhere."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.scipy.linalg import expm
from jaxtyping import Array, Bool, Shaped

from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics import series
from ....manifolds.numerics.matrices import spd_sqrt
from .general import gregory

Matrix = Shaped[Array, "n n"]

_HALVINGS = 3
_DEFECT = 1e-7  # of the squared angles, where rounding has mixed planes that are all close to a half turn


def exponential(a: Matrix) -> Matrix:
    """Exponential of a skew-Hermitian matrix; for n = 2 a phase times ``cos t I + (sin t / t) A``."""
    if a.shape[0] != 2:
        return expm(a)
    eye = jnp.eye(2, dtype=a.dtype)
    phase = jnp.trace(a) / 2
    traceless = a - phase * eye
    s = vec.pairing(traceless, traceless) / 2
    return jnp.exp(phase) * (series.cosine(s) * eye + series.sinc(s) * traceless)


def logarithm(a: Matrix) -> Matrix:
    """Principal logarithm of a unitary matrix without the eigenvalue -1, NaN for one with it."""
    return unitary_logarithm(a)


def special_logarithm(a: Matrix) -> Matrix:
    """Principal logarithm in SU(n): NaN also where the angles of the eigenvalues do not sum to 0."""
    if a.shape[0] == 2:
        cosine = jnp.trace(a).real / 2
        sine = (a - a.conj().T) / 2
        sine = sine - jnp.trace(sine) / 2 * jnp.eye(2)
        return series.angle_over_sine(vec.pairing(sine, sine) / 2, cosine) * sine
    log = unitary_logarithm(a)
    return jnp.where(jnp.abs(jnp.trace(log)) < 1, log, jnp.nan)


def square_root(a: Matrix) -> Matrix:
    """Square root of a unitary matrix without the eigenvalue -1."""
    return exponential(unitary_logarithm(a) / 2)


def injective(a: Matrix) -> Bool[Array, ""]:
    """Whether all angles of a skew-Hermitian matrix are below pi."""
    return jnp.linalg.norm(a, 2) < jnp.pi


@jax.custom_jvp
def unitary_logarithm(a: Matrix) -> Matrix:
    """Principal logarithm of an orthogonal or unitary matrix, from its Hermitian part ``C`` and skew-Hermitian part ``S``.

    They commute. In eigenvectors of ``C``, with eigenvalues ``cos t_j``, row j of ``S`` has length ``sin t_j``, and the
    logarithm is ``S`` with its entries times ``t / sin t``, the smaller of the two: between rows of different angles there
    is only rounding, not to be magnified by the row that is close to a half turn. NaN at the eigenvalue -1, and where
    several planes are so close to a half turn that rounding has mixed them.

    The derivative is that of ``logarithm_by_roots``: eigenvectors have none at repeated eigenvalues.
    """
    adjoint = a.conj().T
    cosines, vectors = jnp.linalg.eigh((a + adjoint) / 2)
    sine = vectors.conj().T @ ((a - adjoint) / 2) @ vectors
    sine = (sine - sine.conj().T) / 2
    sines = jnp.linalg.norm(sine, axis=1)
    angles = jnp.arctan2(sines, cosines)
    ratios = jnp.where(sines > 0, angles / jnp.where(sines > 0, sines, 1.0), 1.0)
    log = jnp.minimum(ratios[:, None], ratios) * sine
    defect = jnp.max(jnp.abs(log @ log.conj().T - jnp.diag(angles**2)))
    return jnp.where(defect < _DEFECT, vectors @ log @ vectors.conj().T, jnp.nan)


@unitary_logarithm.defjvp
def _unitary_logarithm_jvp(primals: tuple[Matrix], tangents: tuple[Matrix]) -> tuple[Matrix, Matrix]:
    return unitary_logarithm(*primals), jax.jvp(logarithm_by_roots, primals, tangents)[1]


def logarithm_by_roots(a: Matrix) -> Matrix:
    """Principal logarithm by repeated square roots until the angles are below ``pi/8``, then Gregory's series."""
    for _ in range(_HALVINGS):
        a = polar(a)
    return 2.0**_HALVINGS * gregory(a)


def _realified(function: Callable[[Matrix], Matrix]) -> Callable[[Matrix], Matrix]:
    """A function of real matrices that commutes with rotations, on complex ones: ``a + ib`` as ``[[a, -b], [b, a]]``."""

    def on_complex(a: Matrix) -> Matrix:
        if not jnp.iscomplexobj(a):
            return function(a)
        n = a.shape[0]
        value = function(jnp.block([[a.real, -a.imag], [a.imag, a.real]]))
        return value[:n, :n] + 1j * value[n:, :n]

    return on_complex


@_realified
def polar(a: Matrix) -> Matrix:
    """Unitary polar factor ``b (b^H b)^(-1/2)`` of ``b = I + a`` for a skew-Hermitian or unitary ``a``."""
    b = jnp.eye(a.shape[0], dtype=a.dtype) + a
    return jnp.linalg.solve(spd_sqrt(b.T @ b), b)


def polar_inverse(a: Matrix) -> Matrix:
    """Skew-Hermitian ``A`` whose ``I + A`` has the polar factor ``a``: ``(a + a^H)^-1 (a - a^H)``."""
    log = jnp.linalg.solve(a + a.conj().T, a - a.conj().T)
    return (log - log.conj().T) / 2


def qr_factor(a: Matrix) -> Matrix:
    """Unitary factor of ``I + A = q r`` with a positive diagonal of ``r``."""
    q, r = jnp.linalg.qr(jnp.eye(a.shape[0], dtype=a.dtype) + a)
    d = jnp.diagonal(r)
    return q * (d / jnp.abs(d) if jnp.iscomplexobj(d) else jnp.where(d < 0, -1.0, 1.0))


def qr_inverse(a: Matrix) -> tuple[Matrix, Matrix]:
    """Skew-Hermitian ``A`` and upper triangular ``t`` with ``a t = I + A``, column by column [Kaneko, Fiori, Tanaka 2013].

    The inverse exists where the diagonal of ``t`` is positive; it is real, for complex ``a`` by the choice of the imaginary
    diagonal of ``A``.
    """
    n = a.shape[0]
    t = jnp.zeros_like(a)
    for i in range(n):
        above = jnp.stack([a[i, : j + 1] @ t[: j + 1, j] for j in range(i)]) if i else jnp.zeros(0, a.dtype)
        right = jnp.concatenate([-above.conj(), jnp.ones(1, a.dtype)])
        block = a[: i + 1, : i + 1]
        column = jnp.linalg.solve(block, right)
        if jnp.iscomplexobj(a):
            turned = jnp.linalg.solve(block, 1j * jnp.zeros_like(right).at[i].set(1.0))
            column = column - column[i].imag / turned[i].imag * turned
        t = t.at[: i + 1, i].set(column)
    skew = a @ t
    return (skew - skew.conj().T) / 2, t
