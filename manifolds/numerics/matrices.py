"""Functions of matrices with derivatives that are right everywhere, repeated eigenvalues included."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from . import series

Matrix = Float[Array, "n n"]

# Diagonal Pade approximant of degree 7: rounding accuracy up to norm 0.95 [Higham 2005, table 2.3].
_PADE = (17297280.0, 8648640.0, 1995840.0, 277200.0, 25200.0, 1512.0, 56.0, 1.0)
_PADE_RADIUS = 0.95
_SQUARINGS = 16  # for norms to 6e4, of skew matrices; others overflow before


def symmetric(a: Matrix) -> Matrix:
    """Symmetric part ``(a + a')/2``."""
    return (a + a.T) / 2


def lyapunov(s: Matrix, c: Matrix) -> Matrix:
    """Symmetric-definite Lyapunov equation ``s x + x s = c``, closed under differentiation and transposition."""

    def solve(_: object, right: Matrix) -> Matrix:
        values, vectors = jnp.linalg.eigh(jax.lax.stop_gradient(s))
        return vectors @ ((vectors.T @ right @ vectors) / (values[:, None] + values[None, :])) @ vectors.T

    return jax.lax.custom_linear_solve(lambda x: s @ x + x @ s, c, solve, transpose_solve=solve, symmetric=True)


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def spd_sqrt(a: Matrix, rounding: float = 0.0) -> Matrix:
    """Square root of a symmetric positive definite matrix; eigenvalues from ``-rounding`` to 0 count as 0.

    The derivative solves a Lyapunov equation: differentiating the eigenvectors instead divides by the gaps between
    eigenvalues, which are zero at the identity.
    """
    values, vectors = jnp.linalg.eigh(a)
    return (vectors * jnp.sqrt(jnp.where(values < -rounding, values, jnp.maximum(values, 0.0)))) @ vectors.T


@spd_sqrt.defjvp
def _spd_sqrt_jvp(rounding: float, primals: tuple[Matrix], tangents: tuple[Matrix]) -> tuple[Matrix, Matrix]:
    root = spd_sqrt(primals[0], rounding)
    return root, lyapunov(root, tangents[0])


def exponential(a: Matrix) -> Matrix:
    """Exponential of a square matrix by scaling and squaring of a Pade approximant [Higham 2005]."""
    norm = jax.lax.stop_gradient(jnp.max(jnp.sum(jnp.abs(a), axis=0)))
    halvings = jnp.clip(jnp.ceil(jnp.log2(jnp.maximum(norm, _PADE_RADIUS) / _PADE_RADIUS)), 0, _SQUARINGS)
    a = a * 2.0**-halvings
    eye, square = jnp.eye(a.shape[0], dtype=a.dtype), a @ a
    fourth = square @ square
    sixth = fourth @ square
    odd = a @ (_PADE[7] * sixth + _PADE[5] * fourth + _PADE[3] * square + _PADE[1] * eye)
    even = _PADE[6] * sixth + _PADE[4] * fourth + _PADE[2] * square + _PADE[0] * eye

    def squared(power: Matrix, index: Array) -> tuple[Matrix, None]:
        return jnp.where(index < halvings, power @ power, power), None

    return jax.lax.scan(squared, jnp.linalg.solve(even - odd, even + odd), jnp.arange(_SQUARINGS))[0]


@jax.custom_jvp
def sym_exp(a: Matrix) -> Matrix:
    """Exponential of the symmetric part of a matrix, by eigenvalues; its derivatives are those of the Pade approximant."""
    values, vectors = jnp.linalg.eigh(a)
    return (vectors * jnp.exp(values)) @ vectors.T


@sym_exp.defjvp
def _sym_exp_jvp(primals: tuple[Matrix], tangents: tuple[Matrix]) -> tuple[Matrix, Matrix]:
    return sym_exp(primals[0]), jax.jvp(exponential, (symmetric(primals[0]),), (symmetric(tangents[0]),))[1]


@jax.custom_jvp
def spd_log(a: Matrix) -> Matrix:
    """Logarithm of the positive definite symmetric part of a matrix; its derivative solves ``D exp(log a)[x] = h``."""
    values, vectors = jnp.linalg.eigh(a)
    return (vectors * jnp.log(values)) @ vectors.T


@spd_log.defjvp
def _spd_log_jvp(primals: tuple[Matrix], tangents: tuple[Matrix]) -> tuple[Matrix, Matrix]:
    log, right = spd_log(primals[0]), symmetric(tangents[0])

    def solve(_: object, right: Matrix) -> Matrix:
        # Divided differences (e^s - e^t)/(s - t) in the eigenbasis [Daleckii, Krein 1965].
        values, vectors = jnp.linalg.eigh(jax.lax.stop_gradient(log))
        mean, half = (values[:, None] + values) / 2, (values[:, None] - values) / 2
        divided = jnp.exp(mean) * series.sinhc(half * half)
        return vectors @ ((vectors.T @ right @ vectors) / divided) @ vectors.T

    def derivative(x: Matrix) -> Matrix:
        return jax.jvp(exponential, (log,), (x,))[1]

    return log, jax.lax.custom_linear_solve(derivative, right, solve, transpose_solve=solve, symmetric=True)


def symmetric_factor(a: Matrix, c: Matrix) -> Matrix:
    """Symmetric ``t`` with ``a t + t a' = c`` for a symmetric ``c``; Hermitian both where ``a`` is complex."""
    units = _triangular_units(a)
    return _factor(a, c, units + units.conj().swapaxes(1, 2))


def triangular_factor(a: Matrix, c: Matrix) -> Matrix:
    """Upper triangular ``t``, its diagonal real, with ``a t + t'a' = c`` for a symmetric (Hermitian) ``c``.

    The determinant of the equations is that of the leading principal minors of ``a``, multiplied, up to a power of two.
    """
    return _factor(a, c, _triangular_units(a))


def _factor(a: Matrix, c: Matrix, units: np.ndarray) -> Matrix:
    """``t`` in the real span of ``units`` with ``a t + (a t)' = c``, from one dense system."""
    moved = a @ jnp.asarray(units, a.dtype)
    equations = jax.vmap(_hermitian_entries)(moved + moved.conj().swapaxes(1, 2)).T
    coordinates = jnp.linalg.solve(equations, _hermitian_entries(c))
    return jnp.tensordot(coordinates.astype(a.dtype), jnp.asarray(units, a.dtype), 1)


def _triangular_units(a: Matrix) -> np.ndarray:
    """Real basis, shape ``(k, n, n)``, of the upper triangular matrices with real diagonal, complex if ``a`` is."""
    n = a.shape[0]
    units = np.eye(n * n).reshape(n, n, n, n)
    real = units[np.triu_indices(n)]
    return np.concatenate([real, 1j * units[np.triu_indices(n, 1)]]) if jnp.iscomplexobj(a) else real


def _hermitian_entries(h: Matrix) -> Float[Array, " k"]:
    """Real coordinates of a symmetric or Hermitian matrix: its upper triangle, real parts and then imaginary ones."""
    n = h.shape[0]
    real = h.real[np.triu_indices(n)]
    return jnp.concatenate([real, h.imag[np.triu_indices(n, 1)]]) if jnp.iscomplexobj(h) else real
