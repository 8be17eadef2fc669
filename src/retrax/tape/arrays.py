"""Arrays whose entries are scalars of a CasADi graph.

In a trace an array is a NumPy array where its entries are known, ``Scalars`` where they depend on the input, and a
``Complex`` pair of these two where it is complex and depends on the input.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ..errors import RetraxError


class NotTraceableError(RetraxError, TypeError):
    """The error of a function that cannot be traced to scalars.

    Parameters
    ----------
    primitive : str
        The operation of JAX without a scalar form.
    reason : str
        The reason.
    """

    def __init__(self, primitive: str, reason: str) -> None:
        super().__init__(
            f"the function cannot be traced to scalars: it calls {primitive}, {reason}; compute it with XLA instead, "
            "or write it with the operations that docs/tape.md lists"
        )
        self.primitive = primitive


class NotRealError(TypeError):
    """An array is complex where a rule has real numbers only: the tracer says which operation's rule it was."""


@dataclass(frozen=True, slots=True, eq=False)
class Scalars:
    """A real array: a dense column of scalars in C order, and its shape. Truth values are 0 and 1, whole numbers are
    floats."""

    values: ca.SX
    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        """Number of entries."""
        return math.prod(self.shape)


@dataclass(frozen=True, slots=True, eq=False)
class Complex:
    """A complex array as its real and imaginary parts, of one shape."""

    real: "Entries"
    imag: "Entries"

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array."""
        return self.real.shape


Entries = np.ndarray | Scalars | Complex


def is_known(*arrays: Any) -> bool:
    """Whether no entry of the arrays depends on the input."""
    return all(isinstance(a, np.ndarray) for a in arrays)


def column(a: Entries) -> ca.SX:
    """Entries of a real array as a dense column in C order; a complex one is refused, as it would lose its imaginary
    part."""
    if isinstance(a, Scalars):
        return a.values
    if is_complex(a):
        raise NotRealError("expected a real array, got a complex one")
    return ca.SX(ca.DM(np.asarray(a, float).reshape(-1, 1)))


def parts(a: Entries) -> tuple[Entries, Entries]:
    """Real and imaginary part of an array."""
    if isinstance(a, Complex):
        return a.real, a.imag
    if isinstance(a, np.ndarray):
        return np.real(a), np.imag(a)
    return a, np.zeros(a.shape)


def is_complex(a: Entries) -> bool:
    """Whether an array is complex."""
    return isinstance(a, Complex) or (isinstance(a, np.ndarray) and np.iscomplexobj(a))


def scalars(values: ca.SX, shape: tuple[int, ...]) -> Scalars:
    """A real array from a column; dense, with zeros stored where CasADi leaves them out."""
    return Scalars(values if values.is_dense() else ca.densify(values), tuple(shape))


def take(a: Entries, places: np.ndarray) -> Any:
    """The array of the shape of ``places`` with the entries of ``a`` at these places of its C order.

    A known array gives a known array, where NumPy would make one entry a number.
    """
    if isinstance(a, Complex):
        return Complex(take(a.real, places), take(a.imag, places))
    if isinstance(a, np.ndarray):
        return np.asarray(np.reshape(a, -1)[places])
    order = places.reshape(-1)
    if order.size == a.size and (order == np.arange(order.size)).all():  # only the shape is another one, in half of all
        return Scalars(a.values, places.shape)
    values = a.values[order.tolist()]
    return Scalars(values if a.size > 1 else ca.reshape(values, order.size, 1), places.shape)  # a row is taken from one


def move_entries(a: Entries, move: Callable[[np.ndarray], Any]) -> Any:
    """The array with its entries in the places to which a function of NumPy arrays moves them."""
    if isinstance(a, np.ndarray):
        return np.asarray(move(a))
    return take(a, np.asarray(move(np.arange(math.prod(a.shape)).reshape(a.shape))))


def broadcast(*arrays: Any) -> tuple[list[Any], tuple[int, ...]]:
    """Arrays in their common shape, and this shape; arrays with one entry stay, because one entry meets every
    scalar."""
    shape = np.broadcast_shapes(*(a.shape for a in arrays))
    alike = [
        a if a.shape == shape or math.prod(a.shape) == 1 else move_entries(a, lambda b: np.broadcast_to(b, shape))
        for a in arrays
    ]
    return alike, shape


def join(arrays: list[Any], shape: tuple[int, ...], order: np.ndarray | None = None) -> Any:
    """The entries of arrays one after the other as one array; ``order``, of this shape, takes places of them."""
    if is_known(*arrays):
        flat: Entries = np.concatenate([np.reshape(a, -1) for a in arrays])
    elif any(is_complex(a) for a in arrays):
        pairs = [parts(a) for a in arrays]
        flat = Complex(*(join(list(part), (-1,)) for part in zip(*pairs, strict=True)))
    else:
        values = ca.vertcat(*(column(a) for a in arrays))
        flat = Scalars(values, (values.shape[0],))
    places = np.arange(math.prod(flat.shape)).reshape(shape) if order is None else order
    return take(flat, places)
