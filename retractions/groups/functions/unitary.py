"""Functions of skew-Hermitian and unitary matrices, also real matrices, with derivatives that are right everywhere.

[Higham, "Functions of matrices", 2008, chapters 8 and 11.]
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Shaped

from ....manifolds import SU
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics import frames, series
from ....manifolds.numerics.matrices import exponential as matrix_exponential
from ....manifolds.numerics.matrices import triangular_factor
from ....manifolds.numerics.root import known_root
from ....manifolds.numerics.tolerances import tolerance
from ...rounding import SINGULAR_DISTANCE, keeps_half_the_digits, length
from . import general

Matrix = Shaped[Array, "n n"]

_HALVINGS = 3  # of the angles: they are below pi/8 after three
_SCHULZ_STEPS = 3  # from an error of 0.2, that at SINGULAR_DISTANCE, to rounding
_BISECTIONS = 60  # of an interval at most two full turns long
_UNITARITY = 0.45  # power of eps: what long products lose of it is far below


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


def special_square_root(a: Matrix) -> Matrix:
    """Square root of a matrix in SU(n) by ``special_logarithm``."""
    return exponential(special_logarithm(a) / 2)


def injective(a: Matrix) -> Bool[Array, ""]:
    """Whether the logarithm inverts the exponential at a skew-Hermitian matrix: angles below pi, and no two a full turn
    apart.

    Rounding of ``exp a`` turns the eigenvectors of angles ``s`` and ``t`` into each other, magnified by
    ``2 pi / (2 pi - |s - t|)``, but for those of one plane, ``t`` and ``-t`` of a real matrix.
    """
    angles = jnp.linalg.eigvalsh(1j * a)
    first = 0 if jnp.iscomplexobj(a) else min(1, a.shape[0] - 1)
    turn, largest = angles[-1] - angles[first], jnp.maximum(angles[-1], -angles[0])
    below = jnp.pi - largest > jnp.pi * SINGULAR_DISTANCE * a.shape[0] * jnp.finfo(a.dtype).eps
    return below & keeps_half_the_digits(2 * jnp.pi / (2 * jnp.pi - turn))


@jax.custom_jvp
def unitary_logarithm(a: Matrix) -> Matrix:
    """Principal logarithm of an orthogonal or unitary matrix, from its Hermitian part ``C`` and skew-Hermitian part
    ``S``.

    They commute and have the eigenvalues ``cos t`` and ``i sin t``. Near the identity the logarithm is ``arcsin S``,
    near a half turn ``pi sign S - arcsin S``. NaN at the eigenvalue -1, where the sign is unknown, and where ``a`` is
    not unitary.

    Both are taken in eigenvectors of ``C``. Rounding mixes those of nearly equal cosines, which does no harm: ``arcsin
    S`` is ``S`` times a smooth function of ``C``, and the sign is that of a whole block. The derivative is that of
    ``logarithm_by_roots``: eigenvectors have none at repeated eigenvalues.
    """
    adjoint = a.conj().T
    cosines, vectors = jnp.linalg.eigh((a + adjoint) / 2)
    sine = vectors.conj().T @ ((a - adjoint) / 2) @ vectors
    sine = (sine - sine.conj().T) / 2
    sines = jnp.linalg.norm(sine, axis=1)
    far = cosines < _widest_gap(cosines)
    angles = jnp.arctan2(sines, jnp.where(far, -cosines, cosines))
    ratios = jnp.where(sines > 0, angles / jnp.where(sines > 0, sines, 1.0), 1.0)
    arcsine = (ratios[:, None] + ratios) / 2 * sine
    sign, known = _sign_of_block(sine, far)
    log = jnp.where(far[:, None] & far, jnp.pi * sign - arcsine, jnp.where(far[:, None] | far, 0.0, arcsine))
    known &= vec.size(sines**2 + cosines**2 - 1) < tolerance(cosines, _UNITARITY)
    return jnp.where(known, vectors @ log @ vectors.conj().T, jnp.nan)


def _widest_gap(cosines: Float[Array, " n"]) -> Array:
    """The middle of the widest gap between cosines from -0.9 to 0: to both sides of it eigenvectors are not mixed."""
    ends = jnp.concatenate(
        [jnp.full(1, -0.9, cosines.dtype), jnp.clip(cosines, -0.9, 0.0), jnp.zeros(1, cosines.dtype)]
    )
    widest = jnp.argmax(jnp.diff(ends))
    return (ends[widest] + ends[widest + 1]) / 2


def _sign_of_block(s: Matrix, chosen: Bool[Array, " n"]) -> tuple[Matrix, Bool[Array, ""]]:
    """``S (-S^2)^(-1/2)`` of the ``chosen`` rows and columns of a skew-Hermitian ``S``, zero elsewhere; and whether it
    is known.

    It is the unitary polar factor. Newton and Schulz make it skew again, which that of a matrix of size ``d`` is to
    ``eps / d``.
    """
    block, eye = chosen[:, None] & chosen, jnp.diag(chosen.astype(s.dtype))
    u, singular, w = jnp.linalg.svd(jnp.where(block, s, 0.0) + jnp.eye(s.shape[0], dtype=s.dtype) - eye)
    sign = jnp.where(block, u @ w, 0.0)
    sign = (sign - sign.conj().T) / 2
    for _ in range(_SCHULZ_STEPS):
        sign = sign @ (3 * eye + sign @ sign) / 2
    return sign, singular[-1] > SINGULAR_DISTANCE * s.shape[0] * jnp.finfo(s.dtype).eps


@unitary_logarithm.defjvp
def _unitary_logarithm_jvp(primals: tuple[Matrix], tangents: tuple[Matrix]) -> tuple[Matrix, Matrix]:
    return unitary_logarithm(*primals), jax.jvp(logarithm_by_roots, primals, tangents)[1]


def logarithm_by_roots(a: Matrix) -> Matrix:
    """Principal logarithm by repeated square roots until the angles are below ``pi/8``, then Gregory's series."""
    for _ in range(_HALVINGS):
        a = polar(a)
    return 2.0**_HALVINGS * general.gregory(a)


def cayley(a: Matrix) -> Matrix:
    """Cayley transform of a skew-Hermitian matrix, unitary to rounding where the matrix is large and singular too."""
    return frames.made_orthonormal(general.cayley(a))


def special_cayley(a: Matrix) -> Matrix:
    """``cay(A) det(cay A)^(-1/n)`` of a traceless skew-Hermitian ``A``, with ``det(cay A)^(1/n) = exp(2i/n sum
    arctan(t_k/2))``.

    ``i t_k`` are the eigenvalues; ``-sum arctan(t_k/2)`` is the sum of the arguments of the pivots of ``I - A/2``. What
    rounding loses of the group is restored at last, without derivatives: it is zero. NaN where half of the digits are
    lost.
    """
    n = a.shape[0]
    if n == 2:
        return cayley(a)
    eye = jnp.eye(n, dtype=a.dtype)
    inverse, pivots = accretive_inverse(eye - a / 2)
    y = (2 * inverse - eye) * jnp.exp(2j / n * jnp.sum(jnp.angle(pivots)))
    lost = jnp.where(keeps_half_the_digits(length(a)), SU(n).restore(y) - y, jnp.nan)
    return y + jax.lax.stop_gradient(lost)


def accretive_inverse(a: Matrix) -> tuple[Matrix, Shaped[Array, " n"]]:
    """Inverse and pivots of a matrix with a positive definite Hermitian part, by Gauss and Jordan's elimination.

    Its Schur complements have such a part too: interchanges are not needed, and the argument of each pivot is below
    pi/2.
    """
    rows = jnp.arange(a.shape[0])

    def eliminate(k: Array, state: tuple[Matrix, Array]) -> tuple[Matrix, Array]:
        a, pivots = state
        row = jnp.where(rows == k, 1, a[k]) / a[k, k]
        rest = jnp.where(rows == k, 0, a) - jnp.outer(a[:, k], row)
        return jnp.where((rows == k)[:, None], row, rest), jnp.where(rows == k, a[k, k], pivots)

    return jax.lax.fori_loop(0, a.shape[0], eliminate, (a, jnp.diagonal(a)))


def special_cayley_inverse(a: Matrix) -> Matrix:
    """The traceless ``A`` with ``special_cayley(A) = a``, NaN where two angles of ``a`` are a full turn apart.

    Choose the angles ``s_k`` of ``a`` with the sum 0 and less than a full turn apart. Then ``A = 2 (b - I)(b + I)^-1``
    with ``b = e^(i p) a``, its eigenvalues are ``2i tan((s_k + p)/2)``, and their sum increases with ``p`` through zero
    once between its poles ``-pi - min s`` and ``pi - max s``.
    """
    if a.shape[0] == 2:
        return general.cayley_inverse(a)

    def trace(p: Float[Array, "1"]) -> Float[Array, "1"]:
        return jnp.trace(general.cayley_inverse(jnp.exp(1j * p[0]) * a)).imag[None]

    phase = known_root(trace, _phase(jax.lax.stop_gradient(a))[None])[0]
    log = general.cayley_inverse(jnp.exp(1j * phase) * a)
    return log - jnp.trace(log) / a.shape[0] * jnp.eye(a.shape[0], dtype=a.dtype)


def _phase(a: Matrix) -> Array:
    """The ``p`` of ``special_cayley_inverse``, by bisection."""
    angles = special_angles(a)

    def halved(_: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        middle = (low + high) / 2
        above = jnp.sum(jnp.tan((angles + middle) / 2)) > 0
        return jnp.where(above, low, middle), jnp.where(above, middle, high)

    ends = -jnp.pi - jnp.min(angles), jnp.pi - jnp.max(angles)
    apart = ends[1] - ends[0] > SINGULAR_DISTANCE * a.shape[0] * jnp.finfo(angles.dtype).eps
    low, high = jax.lax.fori_loop(0, _BISECTIONS, halved, ends)
    return jnp.where(apart, (low + high) / 2, jnp.nan)


def special_angles(a: Matrix) -> Float[Array, " n"]:
    """Angles of the eigenvalues of a matrix in SU(n), with the sum 0 and at most a full turn apart.

    These are the principal angles, with a full turn subtracted from the largest angles, or added to the smallest, as
    often as the sum needs.
    """
    angles = jnp.linalg.eigvalsh(-1j * unitary_logarithm(a))
    turns, order = jnp.round(jnp.sum(angles) / (2 * jnp.pi)), jnp.arange(angles.size)
    less, more = order >= angles.size - turns, order < -turns
    return angles + 2 * jnp.pi * (1.0 * more - less)


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
