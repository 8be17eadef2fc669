"""Lie algebras of matrices, by a basis. Everything here is numpy: known before anything is traced."""

from functools import cached_property, lru_cache

import numpy as np

from ..numerics.errors import InvalidInputError
from ..numerics.rank import numerical_rank
from .invariants import STRUCTURE, Invariants, find_invariants, invariant_dimension


class LieAlgebra:
    """Real span of ``basis`` ``A_i``, shape ``(d, n, n)``, with the pairing ``<A, B> = Re tr(A^H B)``.

    Raises ``InvalidInputError`` unless the ``A_i`` are independent and closed under commutators.
    """

    def __init__(self, basis: np.ndarray) -> None:
        if basis.ndim != 3 or basis.shape[0] == 0 or basis.shape[1] != basis.shape[2]:
            raise InvalidInputError(f"the basis of a Lie algebra has shape (d, n, n) with d > 0, got {basis.shape}")
        if not np.all(np.isfinite(basis)):
            raise InvalidInputError("the basis of a Lie algebra has entries that are NaN or infinite")
        self.basis = basis
        rank = numerical_rank(self._rows(basis), limit=STRUCTURE).rank
        if rank < len(basis):
            raise InvalidInputError(
                f"the {len(basis)} matrices of a Lie algebra's basis must be independent; their rank is {rank}"
            )
        a, b = self._generic(2)
        if not self.contains(a @ b - b @ a):
            i, j = self._open_pair()
            raise InvalidInputError(
                f"a Lie algebra holds the commutators AB - BA of its elements, and its basis does not span that of A = "
                f"basis[{i}] and B = basis[{j}]; check the signs of their entries, or add it to the basis"
            )

    def _open_pair(self) -> tuple[int, int]:
        """The pair of matrices whose commutator is farthest from what the basis spans."""
        a = self.basis
        pairs = [(i, j) for j in range(len(a)) for i in range(j)]
        return max(pairs, key=lambda pair: self._outside(a[pair[0]] @ a[pair[1]] - a[pair[1]] @ a[pair[0]]))

    @staticmethod
    def _rows(matrices: np.ndarray) -> np.ndarray:
        """Matrices as rows of real numbers."""
        flat = matrices.reshape(len(matrices), -1)
        return np.concatenate([np.real(flat), np.imag(flat)], axis=1) if np.iscomplexobj(flat) else flat

    def _generic(self, count: int) -> np.ndarray:
        """Elements in general position: a polynomial identity that holds at them holds on the whole algebra."""
        return np.tensordot(np.random.default_rng(0).standard_normal((count, len(self.basis))), self.basis, 1)

    @cached_property
    def gram(self) -> np.ndarray:
        """``<A_i, A_j>``."""
        rows = self._rows(self.basis)
        return rows @ rows.T

    @cached_property
    def dual(self) -> np.ndarray:
        """The ``B_i`` of the algebra with ``<B_i, A_j> = 1`` for ``i = j``, else 0."""
        return np.tensordot(np.linalg.inv(self.gram), self.basis, 1)

    @cached_property
    def orthonormal(self) -> np.ndarray:
        """Orthonormal basis, by Gram-Schmidt: multiples of the ``A_i`` if these are orthogonal."""
        return np.linalg.solve(np.linalg.cholesky(self.gram), self.basis.reshape(len(self.basis), -1)).reshape(
            self.basis.shape
        )

    def contains(self, a: np.ndarray) -> bool:
        """Whether a matrix lies in the algebra, up to rounding."""
        return bool(self._outside(a) <= STRUCTURE * np.max(np.abs(a)))

    def _outside(self, a: np.ndarray) -> float:
        """Largest entry of the part of a matrix that the basis does not span."""
        c = np.real(np.tensordot(self.dual.conj(), a, 2))
        return float(np.max(np.abs(a - np.tensordot(c, self.basis, 1))))

    @cached_property
    def acts_unitarily(self) -> bool:
        """Whether the group keeps lengths on the span ``W`` of the ranges of the ``A_i``.

        Then ``<xA, xB> = <A, B>`` for all ``x`` in the group: an orthonormal basis stays one when it is translated.
        """
        ranges = np.concatenate(list(self.basis), axis=1)
        u, s, _ = np.linalg.svd(ranges, full_matrices=False)
        w = u[:, s > STRUCTURE * s[0]]
        strain = w.conj().T @ (self.basis + self.basis.conj().swapaxes(1, 2)) @ w
        return bool(np.max(np.abs(strain)) <= STRUCTURE * np.max(np.abs(self.basis)))

    @cached_property
    def closed_under_adjoints(self) -> bool:
        """Whether ``A^H`` is in the algebra with ``A``."""
        (a,) = self._generic(1)
        return self.contains(a.conj().T)

    @cached_property
    def closed_under_cubes(self) -> bool:
        """Whether ``A^3`` is in the algebra with ``A``.

        Exactly then is the Cayley transform ``(I - A/2)^-1 (I + A/2) = exp(A + A^3/12 + ...)`` in the group.
        """
        (a,) = self._generic(1)
        return self.contains(a @ a @ a)

    @cached_property
    def invariants(self) -> Invariants:
        """The tensors that the algebra leaves fixed.

        Raises ``InvalidInputError`` where a larger algebra leaves the same fixed.
        """
        found = find_invariants(self.basis)
        dimension = invariant_dimension(found, self.basis.shape[1], np.iscomplexobj(self.basis))
        if dimension > len(self.basis):
            raise InvalidInputError(
                "this group is not known by the vectors, covectors, forms and volume that it leaves fixed: a group of "
                f"dimension {dimension} fixes the same, expected {len(self.basis)}; write equations(x), zero on the "
                "group"
            )
        return found


@lru_cache(maxsize=256)
def _cached(data: bytes, shape: tuple[int, ...], dtype: str) -> LieAlgebra:
    return LieAlgebra(np.frombuffer(data, dtype).reshape(shape))


def lie_algebra(basis: np.ndarray) -> LieAlgebra:
    """The Lie algebra of a basis, the same object for equal bases."""
    entries = np.asarray(basis)
    entries = np.ascontiguousarray(entries, complex if np.iscomplexobj(entries) else float)
    return _cached(entries.tobytes(), entries.shape, entries.dtype.str)
