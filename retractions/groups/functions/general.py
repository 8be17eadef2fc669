"""Functions of matrices without further structure: the exponential, its inverse, and the Cayley transform [Higham
2008]."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Shaped

from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.matrices import exponential
from ....manifolds.numerics.precision import same_point
from ....manifolds.numerics.tolerances import tolerance

Matrix = Shaped[Array, "n n"]

_SQUARE_ROOTS = 5  # square roots before the series of the logarithm, whose argument is small then
_FIRST, _LATER = 30, 8  # iterations of the first square root, up to 1e-8 from the negative axis, and of those after it
_GREGORY = tuple(2.0 / (2 * k + 1) for k in range(12))


def logarithm(a: Matrix) -> Matrix:
    """Principal logarithm of a matrix without eigenvalues on the closed negative axis, NaN on it and within rounding of
    it.

    Repeated square roots, then Gregory's series [Higham 2008, 11.3 and 11.5]; for logarithms of norm up to about 10.
    The rounding of the roots comes 2^5-fold: a step of Newton's method takes it away.
    """
    root = _product_root(a, _FIRST)
    root, _ = jax.lax.scan(lambda b, _: (_product_root(b, _LATER), None), root, length=_SQUARE_ROOTS - 1)
    log = 2.0**_SQUARE_ROOTS * gregory(root)
    step = jax.lax.stop_gradient(_newton_step(log, a))
    # Near a half turn, at a distance d, the roots err by eps / d^2 and Newton's method converges from errors below d:
    # from those below eps^(1/3).
    error = vec.size(step)
    log = log + jnp.where(error < tolerance(a, 1 / 3), step, 0.0)
    return jnp.where(error < tolerance(a, 0.25), log, jnp.nan)


def _newton_step(log: Matrix, a: Matrix) -> Matrix:
    """The ``e`` with ``D exp(log)[e] = a - exp(log)``."""
    value, push = jax.linearize(exponential, log)
    units = jnp.eye(a.size, dtype=a.dtype).reshape(-1, *a.shape)
    derivative = jax.vmap(push)(units).reshape(a.size, a.size).T
    return jnp.linalg.solve(derivative, jnp.ravel(a - value)).reshape(a.shape)


def gregory(a: Matrix) -> Matrix:
    """Logarithm of a matrix near the identity by the series of Gregory.

    ``log a = 2 artanh c`` with ``c = (a - I)(a + I)^-1``, to rounding for ``|c| < 0.2``.
    """
    c = cayley_inverse(a) / 2
    total, power, square = jnp.zeros_like(c), c, c @ c
    for coefficient in _GREGORY:
        total, power = total + coefficient * power, power @ square
    return total


def square_root(a: Matrix) -> Matrix:
    """Principal square root of a matrix without eigenvalues on the closed negative axis."""
    return _product_root(a, _FIRST)


def _product_root(a: Matrix, iterations: int) -> Matrix:
    """Principal square root by the product form of the Denman-Beavers iteration [Higham 2008, (6.29)]."""
    eye = jnp.eye(a.shape[0], dtype=a.dtype)

    def step(pair: tuple[Matrix, Matrix], _: None) -> tuple[tuple[Matrix, Matrix], None]:
        x, m = pair
        inverse = jnp.linalg.inv(m)
        return (x @ (eye + inverse) / 2, (2 * eye + m + inverse) / 4), None

    return jax.lax.scan(step, (a, a), length=iterations)[0][0]


def injective(a: Matrix) -> Bool[Array, ""]:
    """Whether the logarithm of the exponential comes back, to 1e-11 in double precision: to 1e-4 from a half turn."""
    return same_point(logarithm(exponential(a)), a, tolerance(a, 0.7))


def cayley(a: Matrix) -> Matrix:
    """Cayley transform ``(I - A/2)^-1 (I + A/2)``."""
    eye = jnp.eye(a.shape[0], dtype=a.dtype)
    return jnp.linalg.solve(eye - a / 2, eye + a / 2)


def cayley_inverse(a: Matrix) -> Matrix:
    """``2 (a + I)^-1 (a - I)`` for a matrix without the eigenvalue -1."""
    eye = jnp.eye(a.shape[0], dtype=a.dtype)
    return 2 * jnp.linalg.solve(a + eye, a - eye)
