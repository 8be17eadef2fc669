"""Interfaces of evaluators, which evaluate functions of one point at many points, with their derivatives."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .compile_time import report_compile_time

if TYPE_CHECKING:
    from ..tape import Tape
    from ..tape.program import Program

Arrays = tuple[np.ndarray, ...]
Function = Callable[..., Any]  # of flat vectors


class PointwiseFunction(ABC):
    """A function of flat vectors, evaluated at many points."""

    def __call__(self, *arguments: np.ndarray) -> Arrays:
        """The values for arrays of shape ``(points, size)``."""
        return self.at(1, *arguments)

    @abstractmethod
    def at(self, axes: int, *arguments: np.ndarray) -> Arrays:
        """The values for arrays with some leading axes in common, of length 1 where an array is shared."""

    def of_any(self, axes: int, *arguments: np.ndarray) -> Arrays:
        """The same for numbers of points that differ from call to call."""
        return self.at(axes, *arguments)

    @property
    def precision(self) -> np.dtype[Any]:
        """The precision in which it computes."""
        return np.dtype(float)

    def placed(self, axes: int, shapes: list[tuple[int, ...]]) -> "ProgramPlacement | None":
        """The data with which a kernel evaluates the function itself, for arrays of these shapes.

        None if the function is not a tape, or takes so long that threads had better share the evaluation.
        """
        del axes, shapes
        return None


@dataclass(frozen=True, eq=False)
class ProgramPlacement:
    """A tape for arrays of fixed shapes, one after the other in what it reads and in what it writes."""

    tape: "Tape"
    code: "Program"
    sources: np.ndarray  # the place of the number of the first point, and how far that of the next is
    targets: np.ndarray
    numbers: tuple[int, int]  # how many are read, and written
    registers: tuple[int, int]  # their shape


class Evaluator(ABC):
    """Makes of functions of one point, whose arguments are flat vectors of given sizes, functions of many points."""

    @property
    @abstractmethod
    def name(self) -> str:
        """``"tape"`` or ``"xla"``."""

    @property
    @abstractmethod
    def reason(self) -> str:
        """The reason for the choice, in words."""

    def values(self, function: Function, *sizes: int) -> PointwiseFunction:
        """The values of a function, a tuple of arrays."""
        with report_compile_time():
            return self._made(function, sizes, first=None)

    def derivatives(self, function: Function, *sizes: int) -> PointwiseFunction:
        """``(hessian, gradient, *jacobians, *vectors, *others)`` at ``d = 0`` of ``function(d, ...)``.

        It returns ``(scalar, vectors, *others)``, where ``vectors`` is an array or a tuple of them. ``sizes`` are those
        of all arguments; ``d`` is left out of the arguments of what is returned.
        """
        with report_compile_time():
            return self._made(function, sizes[1:], first=sizes[0])

    @abstractmethod
    def compile(self) -> None:
        """Make machine code of the tapes among the functions of this evaluator; XLA has compiled the rest."""

    @abstractmethod
    def _made(self, function: Function, sizes: Sequence[int], first: int | None) -> PointwiseFunction:
        """The function of many points; with derivatives by an argument of the size ``first``, if there is one."""
