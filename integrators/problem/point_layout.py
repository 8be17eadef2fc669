"""Points as flat vectors of real numbers, the form in which the engine holds them."""

import math
from collections.abc import Callable
from itertools import accumulate, pairwise
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...manifolds import Manifold
from ...manifolds.numerics.ambient import Ambient, Frame, is_traced


def _complex(real: np.ndarray, imaginary: np.ndarray) -> np.ndarray:
    return real + 1j * imaginary


@final
class PointLayout:
    """Where the entries of a point are in a flat vector: array after array, a complex one as its real and imaginary
    part."""

    def __init__(self, ambient: Any) -> None:
        self._kinds, self._structure = jax.tree.flatten(ambient)
        self._complex = [np.issubdtype(kind.dtype, np.complexfloating) for kind in self._kinds]
        sizes = [math.prod(k.shape) * (1 + c) for k, c in zip(self._kinds, self._complex, strict=True)]
        ends = list(accumulate(sizes, initial=0))
        self.size: int = ends[-1]
        self.shapes: list[tuple[int, ...]] = [tuple(kind.shape) for kind in self._kinds]
        # Of each array.
        self.places: list[slice[int, int, None]] = [slice(*pair) for pair in pairwise(ends)]
        columns = [
            _columns(kind.shape, is_complex) for kind, is_complex in zip(self._kinds, self._complex, strict=True)
        ]
        counts = [1 + np.max(column, initial=-1) for column in columns]
        self.array_of_columns: np.ndarray = np.repeat(np.arange(len(columns)), counts)
        numbers = np.concatenate(
            [np.zeros(0, int), *(a + b for a, b in zip(columns, np.cumsum([0, *counts]), strict=False))]
        )
        # Of matrices, or whole arrays.
        self.columns: np.ndarray = numbers  # of the entries
        self.arrays: np.ndarray = self.array_of_columns[numbers]  # of the entries
        self.in_arrays: np.ndarray = np.equal(self.arrays, np.arange(len(columns))[:, None]).astype(float)
        self.in_columns: np.ndarray = np.equal(numbers, np.arange(sum(counts))[:, None]).astype(float)

    @classmethod
    def of(cls, manifold: Manifold) -> "PointLayout":
        """The layout of points, tangent vectors and covectors of a manifold."""
        return cls(manifold.ambient)

    def point(self, flat: Array) -> Ambient:
        """The point with these entries, in a function that is traced."""
        return self.points(flat, jax.lax.complex)

    def flat(self, point: Ambient) -> Array:
        """The entries of a point, in a function that is traced."""
        leaves = zip(jax.tree.leaves(point), self._complex, strict=True)
        return jnp.concatenate(
            [jnp.ravel(half) for leaf, c in leaves for half in ((leaf.real, leaf.imag) if c else (leaf,))]
        )

    def flat_frame(self, frame: Frame) -> Array:
        """The entries of the vectors of a frame, shape ``(n, size)``, in a function that is traced."""
        return jax.vmap(self.flat)(frame)

    def rows(self, points: Ambient, axes: int) -> np.ndarray:
        """NumPy array with the entries along the last axis from points with some leading axes."""
        return self._rows([np.asarray(leaf) for leaf in jax.tree.leaves(points)], axes)

    def _rows(self, arrays: list[np.ndarray], axes: int) -> np.ndarray:
        leading = arrays[0].shape[:axes] if arrays else ()
        count, parts = max(math.prod(leading), 1), [np.empty((*leading, 0))]
        for array, is_complex in zip(arrays, self._complex, strict=True):
            part = array.reshape(*leading, array.size // count)
            parts += [np.real(part), np.imag(part)] if is_complex else [part]
        return np.concatenate(parts, axis=-1, dtype=float)

    def finite_rows(self, points: Any, axes: int) -> np.ndarray | None:
        """The rows of points that are arrays of finite real numbers of the right shapes; None for all other input.

        Other input may still be points: this check accepts most points at once.
        """
        leaves, structure = jax.tree.flatten(points)
        if structure != self._structure:
            return None
        arrays = list[np.ndarray]()
        for leaf, shape in zip(leaves, self.shapes, strict=True):
            array = np.asarray(leaf) if isinstance(leaf, jax.Array) and not is_traced(leaf) else leaf
            if type(array) is not np.ndarray or array.dtype.kind != "f" or array.shape[axes:] != shape:
                return None
            arrays.append(array)
            if array.shape[:axes] != arrays[0].shape[:axes]:
                return None
        rows = self._rows(arrays, axes)
        return rows if np.isfinite(rows).all() else None

    def fits(self, points: Any, axes: int) -> bool:
        """Whether arrays with some leading axes have the shapes of points, and are complex only where points may be."""
        leaves, structure = jax.tree.flatten(points)
        if structure != self._structure:
            return False
        for leaf, shape, is_complex in zip(leaves, self.shapes, self._complex, strict=True):
            if np.shape(leaf)[axes:] != shape or (np.iscomplexobj(leaf) and not is_complex):
                return False
        return True

    def point_arrays(self, rows: np.ndarray) -> Ambient:
        """Points as NumPy arrays in the precision of the manifold, from an array with their entries along the last
        axis."""
        kinds = self._structure.unflatten(self._kinds)
        return jax.tree.map(lambda leaf, kind: np.asarray(leaf, kind.dtype), self.points(rows), kinds)

    def points(self, rows: Any, join: Callable[[Any, Any], Any] = _complex) -> Ambient:
        """Points with the leading axes of an array that has their entries along the last one."""
        leaves, leading = [], rows.shape[:-1]
        for own, is_complex, place in zip(self.shapes, self._complex, self.places, strict=True):
            part, shape = rows[..., place], (*leading, *own)
            if is_complex:
                half = part.shape[-1] // 2
                leaves.append(join(part[..., :half].reshape(shape), part[..., half:].reshape(shape)))
            else:
                leaves.append(part.reshape(shape))
        return self._structure.unflatten(leaves)


def _columns(shape: tuple[int, ...], is_complex: bool) -> np.ndarray:
    """The column of an array to which each of its entries in a flat vector belongs."""
    if len(shape) < 2:
        own = np.zeros(shape, int)
    else:
        own = np.broadcast_to(np.arange(math.prod(shape[:-2]) * shape[-1]).reshape(*shape[:-2], 1, shape[-1]), shape)
    return np.tile(own.ravel(), 1 + is_complex)


def parameter_layout(parameters: Any, axes: int = 0) -> PointLayout:
    """The layout of the parameters of a problem, any pytree of numbers and arrays, which may have leading axes in
    addition."""
    return PointLayout(
        jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(np.shape(leaf)[axes:], np.asarray(leaf).dtype), parameters)
    )
