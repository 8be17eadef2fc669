"""Vectors of ``LANES`` numbers in kernels that Python runs as they are: what ``llvm_vectors`` has, in NumPy."""

from collections.abc import Callable
from functools import partial, wraps
from typing import Any

import numpy as np

from .arrays import LANES

__all__ = [
    "add",
    "add_vector",
    "compiled",
    "entry",
    "filled",
    "higher",
    "highest",
    "inner",
    "inverse",
    "larger",
    "look_at_one",
    "look_at_three",
    "look_at_two",
    "magnitude",
    "minus",
    "one_by_one",
    "over",
    "part",
    "plus",
    "put",
    "put_entry",
    "put_part",
    "root",
    "scaled",
    "sought",
    "subtract",
    "three_by_one",
    "three_by_two",
    "times",
    "total",
    "vector",
    "view",
    "within",
    "without",
]

Line = np.ndarray
Function = Callable[..., Any]


def compiled(function: Function) -> Function:
    """A kernel, in which a division by zero is infinite or NaN."""

    @wraps(function)
    def call(*arguments: Any) -> Any:
        with np.errstate(all="ignore"):
            return function(*arguments)

    return call


def inner(function: Function) -> Function:
    """A part of kernels."""
    return function


def view(numbers: np.ndarray, first: int, shape: tuple[int, ...]) -> np.ndarray:
    """``numbers.ravel()[first : first + size].reshape(shape)``."""
    return numbers.reshape(-1)[first : first + int(np.prod(shape))].reshape(shape)


def filled(f: float) -> Line:
    return np.full(LANES, f)


def plus(x: Line, y: Line) -> Line:
    return x + y


def minus(x: Line, y: Line) -> Line:
    return x - y


def times(x: Line, y: Line) -> Line:
    return x * y


def scaled(f: float, x: Line) -> Line:
    return f * x


def over(x: Line, f: float) -> Line:
    return x / f


def add(y: Line, f: float, x: Line) -> Line:
    return y + f * x


def subtract(y: Line, f: float, x: Line) -> Line:
    return y - f * x


def larger(x: Line, y: Line) -> Line:
    return np.where(x > y, x, y)


def higher(x: Line, y: Line) -> Line:
    """What is not a number stays."""
    return np.where((y > x) | np.isnan(y), y, x)


def magnitude(x: Line) -> Line:
    return np.abs(x)


def root(x: Line) -> Line:
    return np.sqrt(x)


def inverse(x: Line) -> Line:
    """Ones where there is none."""
    return np.where(x > 0, 1 / x, 1.0)


def within(x: Line, j: int, first: int, last: int) -> Line:
    """Of the vector from j on, what is in a range."""
    places = np.arange(j, j + LANES)
    return np.where((places >= first) & (places < last), x, 0.0)


def without(x: Line, j: int, r: int) -> Line:
    """The vector from j on without the entry in a place."""
    return np.where(np.arange(j, j + LANES) == r, 0.0, x)


def sought(x: Line, f: float) -> int:
    """The first lane of that number, or ``LANES``."""
    found = np.flatnonzero(x == f)
    return int(found[0]) if found.size else LANES


def highest(x: Line) -> Any:
    """The largest number."""
    while x.size > 1:
        x = larger(*np.split(x, 2))
    return x[0]


def total(x: Line) -> Any:
    return np.sum(x)


def _at(x: np.ndarray, i: int, j: int, count: int = LANES) -> np.ndarray:
    """So many numbers from a place in a row on."""
    first = i * x.shape[1] + j
    return x.reshape(-1)[first : first + count]


def vector(x: np.ndarray, i: int, j: int) -> Line:
    """``x[i, j : j + LANES]``."""
    return _at(x, i, j).copy()


def part(x: np.ndarray, i: int, j: int) -> Line:
    """``x[i, j : j + LANES]`` of a row that is not padded: zero after its end."""
    own = x[i, j : j + LANES]
    return np.pad(own, (0, LANES - own.size))


def put(y: np.ndarray, i: int, j: int, x: Line) -> None:
    """``y[i, j : j + LANES] = x``."""
    _at(y, i, j)[:] = x


def put_part(y: np.ndarray, i: int, j: int, x: Line) -> None:
    """``y[i, j : j + LANES] = x`` in a row that is not padded, up to its end."""
    own = y[i, j : j + LANES]
    own[:] = x[: own.size]


def entry(x: np.ndarray, i: Any, j: Any) -> Any:
    """``x[i, j]``."""
    return x[i, j]


def put_entry(y: np.ndarray, i: int, j: int, f: float) -> None:
    """``y[i, j] = f``."""
    y[i, j] = f


def add_vector(y: np.ndarray, i: int, j: int, f: float, x: np.ndarray, k: int, l: int) -> None:  # noqa: E741
    """``y[i, j : j + LANES] += f * x[k, l : l + LANES]``."""
    own = _at(y, i, j)
    own += f * _at(x, k, l)


def _subtract(
    rows: int, vectors: int, y: np.ndarray, i: int, j: int, f: np.ndarray, t: int, x: np.ndarray, k: int, count: int
) -> None:
    """``y[i, j:] -= sum_s f[t + s, i] * x[k + s, j:]`` for so many rows from i on, vectors from j on, and terms."""
    columns = slice(j, j + vectors * LANES)
    y[i : i + rows, columns] -= f[t : t + count, i : i + rows].T @ x[k : k + count, columns]


three_by_two, three_by_one, one_by_one = (partial(_subtract, *size) for size in ((3, 2), (3, 1), (1, 1)))


def _look(
    vectors: int,
    y: np.ndarray,
    i: int,
    j: int,
    f: np.ndarray,
    t: int,
    x: np.ndarray,
    k: int,
    count: int,
    left: np.ndarray,
) -> Line:
    """Subtract from row i, and the largest size of what is left there but for the diagonal where the first row of
    ``left`` is 1, lane for lane; the sizes stand in its second row."""
    _subtract(1, vectors, y, i, j, f, t, x, k, count)
    columns = slice(j, j + vectors * LANES)
    there = (left[0, columns] > 0) & (np.arange(j, columns.stop) != i)
    left[1, columns] = np.where(there, np.abs(y[i, columns]), 0.0)
    most = filled(0.0)
    for line in np.split(left[1, columns], vectors):
        most = larger(line, most)
    return most


look_at_three, look_at_two, look_at_one = (partial(_look, vectors) for vectors in (3, 2, 1))
