"""Functions of matrices with derivatives that are right everywhere, repeated eigenvalues included."""

from functools import partial
from math import factorial

import jax
import jax.numpy as jnp
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Shaped

from . import ambient as vec
from . import series
from .tolerances import HALF, tolerance

Matrix = Shaped[Array, "n n"]

# Diagonal Pade approximant of degree 13: rounding accuracy up to norm 5.37 [Higham 2005, table 2.3]. Every squaring
# doubles rounding, and up to there none is needed.
_PADE = tuple(factorial(26 - k) * factorial(13) / (factorial(26) * factorial(k) * factorial(13 - k)) for k in range(14))
_PADE_RADIUS = 5.37  # norm up to which the approximant is exact to rounding
_SIGN_STEPS = 60  # of Newton's method for the sign of a matrix: enough for eigenvalues from 1e-16 to 1e16
_SQUARINGS = 14  # for norms to 9e4, of skew matrices; others overflow before


def symmetric(a: Matrix) -> Matrix:
    """Symmetric part ``(a + a')/2``, the Hermitian one of a complex matrix."""
    return (a + a.conj().T) / 2


def lyapunov(s: Matrix, c: Matrix) -> Matrix:
    """Lyapunov equation ``s x + x s = c`` of a symmetric (Hermitian) definite ``s``, closed under differentiation and
    transposition."""
    fixed = jax.lax.stop_gradient(s)

    def solve(s: Matrix, right: Matrix) -> Matrix:
        values, vectors = jnp.linalg.eigh(s)
        adjoint = vectors.conj().T
        return vectors @ ((adjoint @ right @ vectors) / (values[:, None] + values[None, :])) @ adjoint

    return jax.lax.custom_linear_solve(
        lambda x: s @ x + x @ s,
        c,
        lambda _, right: solve(fixed, right),
        transpose_solve=lambda _, right: solve(fixed.T, right),
    )


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def spd_sqrt(a: Matrix, rounding: float = 0.0) -> Matrix:
    """Square root of a symmetric positive definite matrix; eigenvalues up to ``rounding`` below 0 count as 0.

    ``rounding`` is relative to the largest eigenvalue, or to 1 if that is larger.
    The derivative solves a Lyapunov equation: differentiating the eigenvectors instead divides by the gaps between
    eigenvalues, which are zero at the identity.
    """
    values, vectors = jnp.linalg.eigh(a)
    lowest = -rounding * jnp.maximum(values[-1], 1.0)
    return (vectors * jnp.sqrt(jnp.where(values < lowest, values, jnp.maximum(values, 0.0)))) @ vectors.T


@spd_sqrt.defjvp
def _spd_sqrt_jvp(rounding: float, primals: tuple[Matrix], tangents: tuple[Matrix]) -> tuple[Matrix, Matrix]:
    root = spd_sqrt(primals[0], rounding)
    return root, lyapunov(root, tangents[0])


def exponential(a: Matrix) -> Matrix:
    """Exponential of a square matrix by scaling and squaring of a Pade approximant [Higham 2005].

    NaN where a rounding of ``a`` changes it in more than half of its digits, and at norms above ``9e4``.
    """
    norm = vec.size(jnp.sum(jnp.abs(jax.lax.stop_gradient(a)), axis=0))
    halvings = jnp.clip(jnp.ceil(jnp.log2(jnp.maximum(norm, _PADE_RADIUS) / _PADE_RADIUS)), 0, _SQUARINGS)
    # Rounding of a changes the exponential by eps |a|; every squaring doubles rounding, which comes to the same.
    known = norm <= min(_PADE_RADIUS * 2.0**_SQUARINGS, 1 / tolerance(a, HALF))
    a = jnp.where(known, a * 2.0**-halvings, jnp.nan)
    eye, square = jnp.eye(a.shape[0], dtype=a.dtype), a @ a
    fourth = square @ square
    sixth = fourth @ square

    def every_other(k: int) -> Matrix:
        high = _PADE[k + 8] * square + _PADE[k + 10] * fourth + _PADE[k + 12] * sixth
        return _PADE[k] * eye + _PADE[k + 2] * square + _PADE[k + 4] * fourth + _PADE[k + 6] * sixth + sixth @ high

    even, odd = every_other(0), a @ every_other(1)

    def squared(power: Matrix, index: Array) -> tuple[Matrix, None]:
        return jnp.where(index < halvings, power @ power, power), None

    return jax.lax.scan(squared, jnp.linalg.solve(even - odd, even + odd), jnp.arange(_SQUARINGS))[0]


@jax.custom_jvp
def sym_exp(a: Matrix) -> Matrix:
    """Exponential of the symmetric part of a matrix by eigenvalues, with the derivatives of the Pade approximant."""
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
    """Symmetric ``t`` with ``a t + t a' = c`` for a symmetric ``c``; Hermitian both where ``a`` is complex.

    NaN unless all eigenvalues of ``a`` have positive real parts, where there is one such ``t``.
    """
    fixed = jax.lax.stop_gradient(a)
    t = jax.lax.custom_linear_solve(
        lambda t: a @ t + t @ a.conj().T,
        c,
        lambda _, right: _lyapunov_by_sign(fixed, right),
        transpose_solve=lambda _, right: _lyapunov_by_sign(fixed.T, right),
    )
    return (t + t.conj().T) / 2


def _lyapunov_by_sign(a: Matrix, c: Matrix) -> Matrix:
    """Solution of ``a t + t a' = c`` by Newton's method for the sign of ``[[a, c], [0, -a']]``, ``[[I, 2t], [0, -I]]``.

    Of two blocks only one has to be inverted; scaled so that both have one norm [Roberts 1980; Higham 2008, 5.5].
    """
    close, eye = tolerance(c, HALF), jnp.eye(a.shape[0], dtype=a.dtype)

    def step(state: tuple[Matrix, Matrix, Array, Array]) -> tuple[Matrix, Matrix, Array, Array]:
        a, c, _, count = state
        inverse = jnp.linalg.inv(a)
        scale = jnp.sqrt(jnp.linalg.norm(a) / jnp.linalg.norm(inverse))
        new = (a / scale + scale * inverse) / 2
        return new, (c / scale + scale * inverse @ c @ inverse.conj().T) / 2, jnp.linalg.norm(new - a), count + 1

    def unfinished(state: tuple[Matrix, Matrix, Array, Array]) -> Array:
        return (state[2] > close) & (state[3] < _SIGN_STEPS)

    start = a, c, jnp.asarray(jnp.inf, c.real.dtype), jnp.zeros((), int)
    sign, double, _, _ = jax.lax.while_loop(unfinished, step, start)
    return jnp.where(jnp.linalg.norm(sign - eye) < 1, double / 2, jnp.nan)


def determinant(a: Matrix) -> Array:
    """Determinant of a complex matrix by elimination with interchanges of rows, in operations that the tape has."""
    rows = jnp.arange(a.shape[0])

    def eliminate(k: Array, state: tuple[Matrix, Array]) -> tuple[Matrix, Array]:
        a, product = state
        column = jnp.where(rows >= k, a[:, k].real ** 2 + a[:, k].imag ** 2, -1)
        here, there = rows == k, rows == jnp.argmax(column)
        a = a + jnp.outer(1.0 * here - there, jnp.where(there, 1, 0) @ a - a[k])
        factors = jnp.where(rows > k, a[:, k] / jnp.where(a[k, k] == 0, 1, a[k, k]), 0)
        return a - jnp.outer(factors, a[k]), product * jnp.where(jnp.any(here & there), a[k, k], -a[k, k])

    return jax.lax.fori_loop(0, a.shape[0], eliminate, (a, jnp.ones((), a.dtype)))[1]


def triangular_factor(a: Matrix, c: Matrix) -> Matrix:
    """Upper triangular ``t``, its diagonal real, with ``a t + t'a' = c`` for a symmetric (Hermitian) ``c``.

    With ``a = l u`` the matrix ``b = u t l'^-1`` is upper triangular, and ``b + b' = l^-1 c l'^-1`` tells its entries:
    as many operations as a few factorisations. The solution exists where no leading principal minor of ``a`` is zero.
    """
    lower, upper = lu_factors(a)
    pivots = jnp.diagonal(upper)

    def solve(c: Matrix) -> Matrix:
        half = solve_triangular(lower, c, lower=True, unit_diagonal=True)
        total = solve_triangular(lower, half.conj().T, lower=True, unit_diagonal=True)
        # The imaginary part of the diagonal is the one that makes t's real.
        b = jnp.triu(total.conj().T, 1) + jnp.diag(jnp.diagonal(total).real / 2 * (pivots / pivots.real))
        t = solve_triangular(upper, b @ lower.conj().T)
        return jnp.triu(t, 1) + jnp.diag(jnp.diagonal(t).real)

    t = solve(c)
    moved = a @ t
    return t + solve(c - moved - moved.conj().T)  # refined: the factors have no pivots


@jax.custom_jvp
def lu_factors(a: Matrix) -> tuple[Matrix, Matrix]:
    """Unit lower and upper triangular ``l``, ``u`` with ``a = l u``; not finite where a leading principal minor is
    zero.

    Derivatives are ``l tril(m)``, strictly, and ``triu(m) u`` with ``m = l^-1 da u^-1``.
    """
    rows = jnp.arange(a.shape[0])

    def eliminate(k: Array, factors: tuple[Matrix, Matrix]) -> tuple[Matrix, Matrix]:
        lower, upper = factors
        column = jnp.where(rows > k, upper[:, k] / upper[k, k], 0)
        return lower.at[:, k].add(column), upper - jnp.outer(column, upper[k])

    lower, upper = jax.lax.fori_loop(0, a.shape[0], eliminate, (jnp.eye(a.shape[0], dtype=a.dtype), a))
    return lower, jnp.triu(upper)


@lu_factors.defjvp
def _lu_factors_jvp(primals: tuple[Matrix], tangents: tuple[Matrix]) -> tuple[tuple, tuple]:
    lower, upper = lu_factors(*primals)
    half = solve_triangular(lower, tangents[0], lower=True, unit_diagonal=True)
    m = solve_triangular(upper, half.T, trans=1).T
    return (lower, upper), (lower @ jnp.tril(m, -1), jnp.triu(m) @ upper)
