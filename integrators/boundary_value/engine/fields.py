"""Arrays by their names in one vector, which a kernel takes in their place: each array that Python passes takes time to
compile."""

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, final

import numpy as np

from ....aligned import LINE

Shapes = dict[str, tuple[int, ...]]


class Place(NamedTuple):
    """A vector, and its arrays by their names."""

    numbers: np.ndarray
    v: Any


@final
class Fields:
    """Where arrays of some shapes stand, one after the other; those that are not of numbers have room for numbers.

    ``lined``: each begins where a cache line begins if the vector does.
    """

    def __init__(self, shapes: Shapes, kinds: Mapping[str, type] | None = None, lined: bool = False) -> None:
        self.shapes, self.begins, self.size = shapes, dict[str, int](), 0
        for name, shape in shapes.items():
            self.begins[name] = self.size
            self.size += -(-math.prod(shape) // LINE) * LINE if lined else math.prod(shape)
        formats = [((kinds or {}).get(name, float), shape) for name, shape in shapes.items()]
        offsets, itemsize = [8 * begin for begin in self.begins.values()], 8 * self.size
        self._type = np.dtype({"names": [*shapes], "formats": formats, "offsets": offsets, "itemsize": itemsize})

    def place(self) -> Place:
        """A vector of numbers that are not set, with its arrays."""
        numbers = np.empty(self.size)
        return Place(numbers, np.ndarray((), self._type, numbers))

    def in_rows(self, count: int) -> Place:
        """So many vectors of numbers that are not set, shape (count, size), and their arrays, each with a first axis
        for the vectors."""
        numbers = np.empty((count, self.size))
        return Place(numbers, np.ndarray((count,), self._type, numbers))

    def rows(self, arrays: Iterable[tuple[str, tuple[int, ...]]]) -> np.ndarray:
        """Where arrays begin, and their lengths, in a row for each, as kernels take them (``linked.laid``); they may
        have other shapes than their own."""
        from ....linked import LONGEST

        found = [(self.begins[name], *shape) for name, shape in arrays]
        return np.array([row + (0,) * (LONGEST - len(row)) for row in found], int).reshape(-1, LONGEST)

    @property
    def all_rows(self) -> np.ndarray:
        """The rows of all arrays in their own shapes."""
        return self.rows(self.shapes.items())


@final
class OfEach:
    """Arrays by their names of some vectors in rows, of which each is of one trajectory, as those of a batch."""

    def __init__(self, arrays: np.ndarray, members: np.ndarray) -> None:
        self._arrays, self._members = arrays, members

    def __getitem__(self, name: str) -> np.ndarray:
        """With the members in place of the axis for the one trajectory, which is the first one or the last."""
        own = self._arrays[name]
        own = own if len(self._members) == len(own) else own[self._members]
        if own.shape[1:2] == (1,):
            return own[:, 0]
        return np.ascontiguousarray(own[..., 0].T) if own.shape[-1:] == (1,) else own
