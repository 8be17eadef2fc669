"""Functions of matrices with derivatives that are right everywhere, repeated eigenvalues included."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Matrix = Float[Array, "n n"]


def lyapunov(s: Matrix, c: Matrix) -> Matrix:
    """Symmetric-definite Lyapunov equation ``s x + x s = c``, closed under differentiation and transposition."""

    def solve(_: object, right: Matrix) -> Matrix:
        values, vectors = jnp.linalg.eigh(jax.lax.stop_gradient(s))
        return vectors @ ((vectors.T @ right @ vectors) / (values[:, None] + values[None, :])) @ vectors.T

    return jax.lax.custom_linear_solve(lambda x: s @ x + x @ s, c, solve, transpose_solve=solve, symmetric=True)


@jax.custom_jvp
def spd_sqrt(a: Matrix) -> Matrix:
    """Square root of a symmetric positive definite matrix.

    The derivative solves a Lyapunov equation: differentiating the eigenvectors instead divides by the gaps between
    eigenvalues, which are zero at the identity.
    """
    values, vectors = jnp.linalg.eigh(a)
    return (vectors * jnp.sqrt(values)) @ vectors.T


@spd_sqrt.defjvp
def _spd_sqrt_jvp(primals: tuple[Matrix], tangents: tuple[Matrix]) -> tuple[Matrix, Matrix]:
    root = spd_sqrt(primals[0])
    return root, lyapunov(root, tangents[0])
