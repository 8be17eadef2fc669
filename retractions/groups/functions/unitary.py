"""Functions of skew-Hermitian and unitary matrices, real ones included, with derivatives that are right everywhere.

[Higham, "Functions of matrices", 2008, chapters 8 and 11.]
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Shaped

from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics import frames, series
from ....manifolds.numerics.matrices import exponential as matrix_exponential
from ....manifolds.numerics.matrices import triangular_factor
from .general import gregory

Matrix = Shaped[Array, "n n"]

_HALVINGS = 3
_DEFECT = 1e-7  # of the squared angles, where rounding has mixed planes that are all close to a half turn


def exponential(a: Matrix) -> Matrix:
    """Exponential of a skew-Hermitian matrix; for n = 2 a phase times ``cos t I + (sin t / t) A``."""
    if a.shape[0] != 2:
        return matrix_exponential(a)
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


def polar(a: Matrix) -> Matrix:
    """Unitary polar factor of ``I + a``."""
    return frames.polar_factor(jnp.eye(a.shape[0], dtype=a.dtype) + a)


def polar_inverse(a: Matrix) -> Matrix:
    """Skew-Hermitian ``A`` whose ``I + A`` has the polar factor ``a``: ``(a + a^H)^-1 (a - a^H)``."""
    log = jnp.linalg.solve(a + a.conj().T, a - a.conj().T)
    return (log - log.conj().T) / 2


def qr_factor(a: Matrix) -> Matrix:
    """Unitary factor of ``I + A = q r`` with a positive diagonal of ``r``."""
    return frames.qr_factor(jnp.eye(a.shape[0], dtype=a.dtype) + a)


def qr_inverse(a: Matrix) -> tuple[Matrix, Matrix]:
    """Skew-Hermitian ``A`` and upper triangular ``t``, its diagonal real, with ``a t = I + A``.

    The inverse exists where the diagonal of ``t`` is positive.
    """
    eye = jnp.eye(a.shape[0], dtype=a.dtype)
    change = triangular_factor(a, 2 * eye - a - a.conj().T)
    skew = a + a @ change
    return (skew - skew.conj().T) / 2, eye + change
