"""Points as flat vectors of real numbers, the form in which the engine holds them."""

import math
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....manifolds import Manifold
from ....manifolds.numerics.ambient import Ambient, Frame


@final
class Layout:
    """Where the entries of a point are in a flat vector: array after array, a complex one as its real and imaginary part."""

    def __init__(self, ambient: Any) -> None:
        self._kinds, self._structure = jax.tree.flatten(ambient)
        self._complex = [np.issubdtype(kind.dtype, np.complexfloating) for kind in self._kinds]
        self._ends = np.cumsum([0, *(math.prod(k.shape) * (1 + c) for k, c in zip(self._kinds, self._complex, strict=True))])
        self.size = int(self._ends[-1])

    @classmethod
    def of(cls, manifold: Manifold) -> "Layout":
        """The layout of points, tangent vectors and covectors of a manifold."""
        return cls(manifold.ambient)

    def point(self, flat: Array) -> Ambient:
        """The point with these entries, in a function that is traced."""
        return self._tree(flat, (), jax.lax.complex)

    def flat(self, point: Ambient) -> Array:
        """The entries of a point, in a function that is traced."""
        leaves = zip(jax.tree.leaves(point), self._complex, strict=True)
        return jnp.concatenate([jnp.ravel(half) for leaf, c in leaves for half in ((leaf.real, leaf.imag) if c else (leaf,))])

    def flat_frame(self, frame: Frame) -> Array:
        """The entries of the vectors of a frame, shape ``(n, size)``, in a function that is traced."""
        return jax.vmap(self.flat)(frame)

    def rows(self, points: Ambient, axes: int) -> np.ndarray:
        """NumPy array with the entries along the last axis from points with some leading axes."""
        leading = next((np.shape(leaf)[:axes] for leaf in jax.tree.leaves(points)), ())
        halves = [np.zeros((*leading, 0))]
        for leaf, is_complex in zip(jax.tree.leaves(points), self._complex, strict=True):
            array = np.asarray(leaf)
            parts = (np.real(array), np.imag(array)) if is_complex else (array,)
            halves += [np.asarray(part, float).reshape(*array.shape[:axes], -1) for part in parts]
        return np.concatenate(halves, axis=-1)

    def points(self, rows: np.ndarray) -> Ambient:
        """Points with the leading axes of an array that has their entries along the last one."""
        return self._tree(rows, rows.shape[:-1], lambda a, b: a + 1j * b)

    def _tree(self, flat: Any, leading: tuple[int, ...], join: Any) -> Ambient:
        leaves = []
        for kind, is_complex, begin, end in zip(self._kinds, self._complex, self._ends, self._ends[1:], strict=False):
            part, shape = flat[..., begin:end], (*leading, *kind.shape)
            half = (end - begin) // 2
            leaves.append(
                join(part[..., :half].reshape(shape), part[..., half:].reshape(shape)) if is_complex else part.reshape(shape)
            )
        return jax.tree.unflatten(self._structure, leaves)


def parameter_layout(parameters: Any) -> Layout:
    """The layout of the parameters of a problem, any pytree of numbers and arrays."""
    return Layout(jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(np.shape(leaf), np.asarray(leaf).dtype), parameters))
