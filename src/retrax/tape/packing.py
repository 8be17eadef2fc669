"""Arrays of the arguments and values of a tape as rows of numbers, one for each real scalar."""

import math
import operator
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, final

import jax
import numpy as np

from ..errors import InvalidInputError
from .arrays import parts

Argnums = int | Iterable[int] | None  # places of arguments, as jax.grad has them; None: all


@final
@dataclass(frozen=True, eq=False)
class Leaf:
    """Shape and kind of one array among the arguments or values of a function."""

    shape: tuple[int, ...]
    complex: bool
    argument: int = 0  # its place among the arguments

    @property
    def rows(self) -> int:
        """The number of real numbers in the array."""
        return math.prod(self.shape) * (2 if self.complex else 1)


def argument_places(argnums: Argnums, structure: Any) -> set[int]:
    """The places, from 0, of the arguments that ``argnums`` names, from the structure of all arguments."""
    count = len(structure.children())
    given = range(count) if argnums is None else argnums if isinstance(argnums, Iterable) else (argnums,)
    try:
        places = [operator.index(k) for k in given]
    except TypeError:
        places = [count]
    if any(not -count <= k < count for k in places):
        raise InvalidInputError(
            f"argnums must be the place of one of {count} arguments, from 0 or, back from the last, from -1, or a "
            f"sequence of them; got {argnums!r}"
        )
    return {k % count for k in places}


def argument_shapes(leaves: list[Leaf], structure: Any) -> tuple[Any, ...]:
    """The shapes of the arrays of all arguments, in the structure of the arguments."""
    return jax.tree.unflatten(structure, [leaf.shape for leaf in leaves])


def pack(arguments: Any, expected: list[Leaf], expected_structure: Any) -> np.ndarray:
    """All arguments as one array with a row for every scalar and a column for every point."""
    leaves, structure = jax.tree.flatten(arguments)
    arrays = [np.asarray(leaf) for leaf in leaves]
    for array in arrays:
        require_numbers(array)
    counts = {a.shape[-1] if a.ndim else None for a in arrays}
    alike = structure == expected_structure and [a.shape[:-1] for a in arrays] == [leaf.shape for leaf in expected]
    if not alike or len(counts) != 1 or any(a.ndim == 0 for a in arrays):
        raise InvalidInputError(
            f"the tape has arguments of shapes {argument_shapes(expected, expected_structure)}, expected the like with "
            "one more axis, the points, last and of one length; got arguments of shapes "
            f"{jax.tree.map(np.shape, arguments)}"
        )
    halves = [half for a, leaf in zip(arrays, expected, strict=True) for half in _real_parts(a, leaf.complex)]
    return np.concatenate([np.asarray(h, float).reshape(math.prod(h.shape[:-1]), h.shape[-1]) for h in halves])


def unpack(rows: np.ndarray, results: list[Leaf]) -> list[np.ndarray]:
    """The arrays of the values, from an array with a row for every scalar and a column for every point."""
    ends = np.cumsum([0, *(leaf.rows for leaf in results)])
    found = []
    for begin, leaf in zip(ends, results, strict=False):
        size, shape = math.prod(leaf.shape), (*leaf.shape, rows.shape[1])
        value = np.empty(shape, complex if leaf.complex else float)
        value.real = rows[begin : begin + size].reshape(shape)
        if leaf.complex:
            value.imag = rows[begin + size : begin + 2 * size].reshape(shape)
        found.append(value)
    return found


def require_numbers(array: np.ndarray) -> None:
    """Raise unless an array has numbers as entries."""
    if not (jax.numpy.issubdtype(array.dtype, np.number) or array.dtype == bool):
        raise InvalidInputError(f"a tape has arrays of numbers as arguments, got one of {array.dtype}: {array!r}")


def _real_parts(a: np.ndarray, pair: bool) -> tuple[Any, ...]:
    """The real and imaginary parts of an array for a ``pair``, else the array alone."""
    if np.iscomplexobj(a) and not pair:
        raise InvalidInputError("the tape is of a real array, got a complex one")
    return parts(a) if pair else (a,)
