"""Tensors that a matrix group leaves fixed, found from its Lie algebra, and the equations of the group.

A connected group of matrices that is cut out by the tensors it fixes is found here from those of lowest degree: vectors
``b`` and covectors ``c``, Hermitian forms ``x^H J x = J`` and ``x K x^H = K``, and the volume ``det x = 1``. That
covers orthogonal, unitary, special linear, symplectic, Euclidean, Galilean and unitriangular groups.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..numerics.rank import null_space, numerical_rank

STRUCTURE = 1e-10  # relative: less in the matrices of a basis is rounding of what a user writes


class Invariants(NamedTuple):
    """Bases of the fixed tensors of each kind, and whether volume is one of them."""

    vectors: np.ndarray  # (k, n), A b = 0
    covectors: np.ndarray  # (k, n), c A = 0
    forms: np.ndarray  # (k, n, n), A^H J + J A = 0
    coforms: np.ndarray  # (k, n, n), A K + K A^H = 0
    volume: bool  # tr A = 0


def find_invariants(basis: np.ndarray) -> Invariants:
    """The tensors that every element of a Lie algebra with this basis, shape ``(d, n, n)``, annihilates."""
    n, eye = basis.shape[1], np.eye(basis.shape[1])
    on_forms = [np.kron(a.conj().T, eye) + np.kron(eye, a.T) for a in basis]
    on_coforms = [np.kron(a, eye) + np.kron(eye, a.conj()) for a in basis]
    return Invariants(
        _null_rows(np.concatenate(list(basis))),
        _null_rows(np.concatenate([a.T for a in basis])),
        _null_rows(np.concatenate(on_forms)).reshape(-1, n, n),
        _null_rows(np.concatenate(on_coforms)).reshape(-1, n, n),
        bool(np.max(np.abs(np.trace(basis, axis1=1, axis2=2))) <= STRUCTURE * np.max(np.abs(basis))),
    )


def invariant_dimension(found: Invariants, n: int, is_complex: bool) -> int:
    """Real dimension of the largest algebra of ``n x n`` matrices that annihilates all of these."""
    units = np.eye(n * n).reshape(-1, n, n)
    units = np.concatenate([units, 1j * units]) if is_complex else units
    rows = []
    for b in units:
        parts = (
            b @ found.vectors.T,
            found.covectors @ b,
            b.conj().T @ found.forms + found.forms @ b,
            b @ found.coforms + found.coforms @ b.conj().T,
            np.atleast_1d(np.trace(b) * found.volume),
        )
        flat = np.concatenate([part.ravel() for part in parts])
        rows.append(np.concatenate([flat.real, flat.imag]))
    return len(units) - numerical_rank(np.array(rows), unit=1.0, limit=STRUCTURE).rank


def equations(found: Invariants, x: Array) -> Array:
    """The equations ``x b = b``, ``c x = c``, ``x^H J x = J``, ``x K x^H = K``, ``det x = 1`` as one real vector."""
    adjoint = x.conj().T
    # In the precision of x: a constant of numpy keeps that in which a process has used it first.
    tensors = found.vectors.T, found.covectors, found.forms, found.coforms
    vectors, covectors, forms, coforms = (
        jnp.asarray(a, jnp.result_type(x.dtype, jnp.complex64) if np.iscomplexobj(a) else x.dtype) for a in tensors
    )
    parts = (
        x @ vectors - vectors,
        covectors @ x - covectors,
        adjoint @ forms @ x - forms,
        x @ coforms @ adjoint - coforms,
        jnp.atleast_1d(jnp.linalg.det(x) - 1) if found.volume else jnp.zeros(0, x.dtype),
    )
    flat = jnp.concatenate([jnp.ravel(part) for part in parts])
    return jnp.concatenate([flat.real, flat.imag]) if jnp.iscomplexobj(flat) else flat


def _null_rows(matrix: np.ndarray) -> np.ndarray:
    """Orthonormal basis, by rows, of the vectors that a matrix takes to zero."""
    return null_space(matrix, limit=STRUCTURE).T
