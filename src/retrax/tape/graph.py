"""Scalar graphs whose derivatives follow the rules of JAX: ``stop_gradient`` and custom derivatives included."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import casadi as ca

from ..errors import InvalidInputError


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


@dataclass(frozen=True, eq=False)
class Loop:
    """Scalars that an iteration leaves: symbols that stand for its state after so many ``rounds`` of ``body``.

    ``body(state, given)``: the next state; and a scalar that is not zero where the state will not change any more, so
    that the rounds that are left need not be made. ``first``, the state before, and ``given`` contain earlier marks
    only. The symbols are constant to every derivative; but a derivative by what ``arguments`` contain, if there are
    any, is not known, and is refused.
    """

    symbols: ca.SX
    first: ca.SX
    given: ca.SX
    body: ca.Function
    rounds: int
    arguments: ca.SX = field(default_factory=lambda: ca.SX(0, 1))

    @cached_property
    def value(self) -> ca.SX:
        """The state with all rounds written out."""
        state = self.first
        for _ in range(self.rounds):
            state = self.body.call([state, self.given], True, False)[0]
        return state

    @property
    def slope(self) -> ca.SX:
        """The slope, which is unknown: raises ``InvalidInputError``."""
        raise InvalidInputError("an expansion has no derivatives through roots; try those of the function before it")


@dataclass(eq=False)
class Graph:
    """The inputs of a trace and the marks that it made, in order."""

    inputs: list[ca.SX]
    marks: list[Mark | Loop] = field(default_factory=list)

    def constant(self, value: ca.SX) -> ca.SX:
        """Symbols for scalars that are constant to every derivative."""
        symbols = self.symbols(value.shape[0])
        self.add(Mark(symbols, value))
        return symbols

    def symbols(self, count: int) -> ca.SX:
        """New symbols for a mark."""
        return ca.SX.sym(f"mark{len(self.marks)}_", count)

    def loop(self, first: ca.SX, given: ca.SX, body: ca.Function, rounds: int) -> ca.SX:
        """Symbols for the state that a loop leaves."""
        symbols = self.symbols(first.shape[0])
        self.add(Loop(symbols, first, given, body, rounds))
        return symbols

    def add(self, mark: Mark | Loop) -> None:
        """Let the symbols of a mark enter the graph."""
        self.marks.append(mark)

    def jacobian(self, values: ca.SX, by: ca.SX) -> ca.SX:
        """Derivatives of scalars by symbols among the inputs, shape ``(values, by)``."""
        slopes: list[tuple[Mark | Loop, ca.SX]] = []
        for mark in self._moving(values, by):
            slopes.append((mark, ca.mtimes(mark.slope, _total(mark.arguments, by, slopes))))
        return _total(values, by, slopes)

    def push(self, values: ca.SX, by: ca.SX, direction: ca.SX) -> ca.SX:
        """Derivative of scalars by symbols among the inputs along one direction, as a column, in forward mode."""
        slopes: list[tuple[Mark | Loop, ca.SX]] = []

        def along(values: ca.SX) -> ca.SX:
            moved = [ca.jtimes(values, mark.symbols, slope) for mark, slope in slopes]
            return sum(moved, start=ca.jtimes(values, by, direction))

        for mark in self._moving(values, by):
            slopes.append((mark, ca.densify(ca.mtimes(mark.slope, along(mark.arguments)))))
        return along(values)

    def gradient(self, value: ca.SX, by: ca.SX) -> ca.SX:
        """Derivative of one scalar by symbols among the inputs, as a column, in reverse mode."""
        marks = self._moving(value, by)
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
        return self.jacobian(self.gradient(value, by), by) if self._moving(value, by) else ca.hessian(value, by)[0]

    def resolve_marks(self, values: Sequence[ca.SX]) -> list[ca.SX]:
        """The values with what the marks stand for in their place, loops written out."""
        return _replace(values, self.marks)

    def schedule(self, values: Sequence[ca.SX]) -> tuple[list[ca.SX], list[Loop]]:
        """The values with every mark replaced except loops, and the loops that the values need, in order."""
        marks = [mark for mark in self.marks if isinstance(mark, Mark)]
        loops = [mark for mark in self.marks if isinstance(mark, Loop)]
        values, loops = apply_change(lambda parts: _replace(parts, marks), values, loops)
        needed, kept = symbols_in(values), list[Loop]()
        for loop in reversed(loops):
            if needed & symbols_in([loop.symbols]):
                needed |= symbols_in([], [loop])
                kept.append(loop)
        return values, kept[::-1]

    def at_zero(self, values: Sequence[ca.SX]) -> tuple[list[ca.SX], "Graph"]:
        """The values where the first input is zero, and their graph, which has the other inputs."""
        (values, loops), first = self.schedule(values), self.inputs[0]
        zero = ca.SX.zeros(first.shape)
        values, loops = apply_change(lambda parts: ca.substitute(parts, [first], [zero]), values, loops)
        marks = [replace(loop, arguments=ca.vertcat(loop.first, loop.given)) for loop in loops]
        return values, Graph(self.inputs[1:], [*marks])

    def _moving(self, values: ca.SX, by: ca.SX) -> list[Mark | Loop]:
        """Marks with a derivative by symbols among the inputs, in order, of which the values are made."""
        owners = {hash(s): k for k, mark in enumerate(self.marks) for s in mark.symbols.elements()}
        found, open_ends = set[int](), [values]
        while open_ends:
            met = {owners[hash(s)] for s in ca.symvar(open_ends.pop()) if hash(s) in owners}
            new = {k for k in met - found if self.marks[k].arguments.numel()}
            open_ends += [self.marks[k].arguments for k in new]
            found |= new
        moved, moving = symbols_in([by]), list[Mark | Loop]()
        for mark in (self.marks[k] for k in sorted(found)):
            if moved & symbols_in([mark.arguments]):
                moving.append(mark)
                moved |= symbols_in([mark.symbols])
        return moving


def apply_change(
    change: Callable[[list[ca.SX]], list[ca.SX]], values: Sequence[ca.SX], loops: Sequence[Loop]
) -> tuple[list[ca.SX], list[Loop]]:
    """The values, and the loops that they need, after a change of all expressions at once."""
    found = change([*values, *_parts(loops)])
    values, parts = found[: len(values)], found[len(values) :]
    return values, [replace(loop, first=a, given=b) for loop, a, b in zip(loops, parts[::2], parts[1::2], strict=True)]


def symbols_in(values: Sequence[ca.SX], loops: Sequence[Loop] = ()) -> set[int]:
    """The symbols in some expressions, and in what loops begin with and are given."""
    return {hash(s) for s in ca.symvar(ca.vertcat(ca.SX(0, 1), *map(ca.vec, (*values, *_parts(loops)))))}


def _parts(loops: Sequence[Loop]) -> list[ca.SX]:
    return [part for loop in loops for part in (loop.first, loop.given)]


def _total(values: ca.SX, by: ca.SX, slopes: Sequence[tuple[Mark | Loop, ca.SX]]) -> ca.SX:
    """Derivative of scalars by symbols, through the marks with these derivatives too."""
    total = ca.jacobian(values, by)
    for mark, slope in slopes:
        if slope.nnz():
            total += ca.mtimes(ca.jacobian(values, mark.symbols), slope)
    return total


def _replace(values: Sequence[ca.SX], marks: Sequence[Mark | Loop]) -> list[ca.SX]:
    """The values with what marks stand for in their place, one after the other."""
    if not marks:
        return list(values)
    return ca.substitute_inplace([mark.symbols for mark in marks], [mark.value for mark in marks], list(values))[1]
