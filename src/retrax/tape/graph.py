"""Scalar graphs whose derivatives follow the rules of JAX: ``stop_gradient`` and custom derivatives included."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca


def _none() -> ca.SX:
    return ca.SX(0, 0)


@dataclass(frozen=True, eq=False)
class Mark:
    """Scalars with a derivative of their own: symbols that stand for ``value``.

    ``d symbols = slope d arguments``; with no arguments they are constant to every derivative. ``value`` and
    ``arguments`` contain earlier marks only. The slope is made when a derivative first asks for it, and may bring new
    marks.
    """

    symbols: ca.SX
    value: ca.SX
    arguments: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    rule: Callable[[], ca.SX] = _none

    @cached_property
    def slope(self) -> ca.SX:
        """Derivative of the scalars by the arguments."""
        return self.rule()


@dataclass(eq=False)
class Graph:
    """The inputs of a trace and the marks that it made, in order."""

    inputs: list[ca.SX]
    marks: list[Mark] = field(default_factory=list)

    def constant(self, value: ca.SX) -> ca.SX:
        """Symbols for scalars that are constant to every derivative."""
        symbols = self.symbols(value.shape[0])
        self.add(Mark(symbols, value))
        return symbols

    def symbols(self, count: int) -> ca.SX:
        """New symbols for a mark."""
        return ca.SX.sym(f"mark{len(self.marks)}_", count)

    def add(self, mark: Mark) -> None:
        """Let the symbols of a mark enter the graph."""
        self.marks.append(mark)

    def jacobian(self, values: ca.SX, by: ca.SX) -> ca.SX:
        """Derivatives of scalars by symbols among the inputs, shape ``(values, by)``."""
        slopes: list[tuple[Mark, ca.SX]] = []
        for mark in self._moving(values):
            slopes.append((mark, ca.mtimes(mark.slope, _total(mark.arguments, by, slopes))))
        return _total(values, by, slopes)

    def push(self, values: ca.SX, by: ca.SX, direction: ca.SX) -> ca.SX:
        """Derivative of scalars by symbols among the inputs along one direction, as a column, in forward mode."""
        slopes: list[tuple[Mark, ca.SX]] = []

        def along(values: ca.SX) -> ca.SX:
            moved = [ca.jtimes(values, mark.symbols, slope) for mark, slope in slopes]
            return sum(moved, start=ca.jtimes(values, by, direction))

        for mark in self._moving(values):
            slopes.append((mark, ca.densify(ca.mtimes(mark.slope, along(mark.arguments)))))
        return along(values)

    def gradient(self, value: ca.SX, by: ca.SX) -> ca.SX:
        """Derivative of one scalar by symbols among the inputs, as a column, in reverse mode."""
        marks = self._moving(value)
        symbols = ca.vertcat(by, *(mark.symbols for mark in marks))
        adjoint = ca.densify(ca.gradient(value, symbols))
        end = symbols.shape[0]
        for mark in reversed(marks):
            begin = end - mark.symbols.shape[0]
            pulled = ca.mtimes(mark.slope.T, adjoint[begin:end])
            adjoint += ca.jtimes(mark.arguments, symbols, pulled, True)
            end = begin
        return adjoint[: by.shape[0]]

    def hessian(self, value: ca.SX, by: ca.SX) -> ca.SX:
        """Second derivatives of one scalar by symbols among the inputs."""
        return self.jacobian(self.gradient(value, by), by) if self._moving(value) else ca.hessian(value, by)[0]

    def unmarked(self, values: Sequence[ca.SX]) -> list[ca.SX]:
        """The values with what the marks stand for in their place."""
        found = list(values)
        for mark in reversed(self.marks):
            found = ca.substitute(found, [mark.symbols], [mark.value])
        return found

    def _moving(self, values: ca.SX) -> list[Mark]:
        """Marks with a derivative, in order, of which the values are made."""
        owners = {hash(s): k for k, mark in enumerate(self.marks) for s in mark.symbols.elements()}
        found, open_ends = set[int](), [values]
        while open_ends:
            met = {owners[hash(s)] for s in ca.symvar(open_ends.pop()) if hash(s) in owners}
            new = {k for k in met - found if self.marks[k].arguments.numel()}
            open_ends += [self.marks[k].arguments for k in new]
            found |= new
        return [self.marks[k] for k in sorted(found)]


def _total(values: ca.SX, by: ca.SX, slopes: Sequence[tuple[Mark, ca.SX]]) -> ca.SX:
    """Derivative of scalars by symbols, through the marks with these derivatives too."""
    total = ca.jacobian(values, by)
    for mark, slope in slopes:
        if slope.nnz():
            total += ca.mtimes(ca.jacobian(values, mark.symbols), slope)
    return total
