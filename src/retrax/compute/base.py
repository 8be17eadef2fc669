"""Interfaces of evaluators, which evaluate functions of one point at many points, with their derivatives."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .compile_time import report_compile_time

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
        """The values for a number of points that differs from call to call."""
        return self.at(axes, *arguments)

    @property
    def precision(self) -> np.dtype[Any]:
        """The precision in which it computes."""
        return np.dtype(float)


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
            return self._make(function, sizes, first=None)

    def derivatives(self, function: Function, *sizes: int) -> PointwiseFunction:
        """Derivatives with respect to the first argument of a function, where this argument is zero.

        ``function(d, ...)`` returns ``(scalar, vectors, *others)``, where ``vectors`` is an array or a tuple of arrays.
        The derivatives are ``(hessian, gradient, *jacobians, *vectors, *others)``, as a function of the arguments
        without ``d``. ``sizes``: of all arguments.
        """
        with report_compile_time():
            return self._make(function, sizes[1:], first=sizes[0])

    @abstractmethod
    def _make(self, function: Function, sizes: Sequence[int], first: int | None) -> PointwiseFunction:
        """The function of many points; with derivatives by an argument of the size ``first``, if there is one."""
