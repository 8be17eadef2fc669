"""The constraint algorithm on R^n with exact algebra, branching where an equation factors or a coefficient may vanish."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import sympy

Expression = Any
Equation = tuple[Expression, int]  # to be made zero, and the level of the algorithm that asks for it


@dataclass(frozen=True)
class Phase:
    """The Hamiltonian and its symbols."""

    hamiltonian: Expression
    q: tuple[Expression, ...]
    p: tuple[Expression, ...]
    u: tuple[Expression, ...]

    def rate(self, f: Expression) -> Expression:
        """Time derivative ``{f, H}`` of a function of ``(q, p)``."""
        h = self.hamiltonian
        return sum(
            (
                sympy.diff(f, q) * sympy.diff(h, p) - sympy.diff(f, p) * sympy.diff(h, q)
                for q, p in zip(self.q, self.p, strict=True)
            ),
            start=sympy.Integer(0),
        )


@dataclass(frozen=True)
class SymbolicStratum:
    """A piece of ``P_f`` in closed form.

    ``equations``: pairs of an expression that vanishes on it and the level at which it appeared; ``solution``: coordinates
    that they determine; ``controls``: determined controls as expressions, and the levels that determine them; ``nonzero``:
    expressions assumed not to vanish.
    """

    phase: Phase
    equations: tuple[Equation, ...] = ()
    solution: dict[Expression, Expression] = field(default_factory=dict)
    controls: dict[Expression, Expression] = field(default_factory=dict)
    levels: dict[Expression, int] = field(default_factory=dict)
    nonzero: tuple[Expression, ...] = ()
    irregular: bool = False

    @property
    def coordinates(self) -> tuple[Expression, ...]:
        """Coordinates of ``T*Q`` that parametrise the piece."""
        return tuple(s for s in (*self.phase.q, *self.phase.p) if s not in self.solution)

    @property
    def codimension(self) -> int:
        """Number of equations."""
        return len(self.equations)

    @property
    def k_f_base(self) -> int:
        """Level of the last equation."""
        return max((level for _, level in self.equations), default=0)

    @property
    def k_f(self) -> int:
        """Level of the last equation or determined control."""
        return max(self.k_f_base, *self.levels.values(), 0) if self.levels else self.k_f_base

    @property
    def embedding(self) -> sympy.Matrix:
        """``(q, p)`` in terms of the coordinates."""
        return sympy.Matrix([self.reduce(s) for s in (*self.phase.q, *self.phase.p)])

    @property
    def form(self) -> sympy.Matrix:
        """Matrix of ``omega_f`` in the coordinates."""
        n, jacobian = len(self.phase.q), self.embedding.jacobian(sympy.Matrix(self.coordinates or [sympy.Dummy()]))
        if not self.coordinates:
            return sympy.zeros(0, 0)
        top, bottom = jacobian[:n, :], jacobian[n:, :]
        return (top.T * bottom - bottom.T * top).applyfunc(sympy.simplify)

    @property
    def kernel(self) -> list[sympy.Matrix]:
        """Basis of the kernel of ``omega_f``, as vectors ``(dq, dp)``."""
        if not self.coordinates:
            return []
        jacobian = self.embedding.jacobian(sympy.Matrix(self.coordinates))
        return [(jacobian * v).applyfunc(sympy.simplify) for v in self.form.nullspace(simplify=True)]

    def reduce(self, expression: Expression) -> Expression:
        """An expression on this piece, with the determined controls and coordinates inserted."""
        known = {**self.solution, **self.controls}
        previous = None
        while previous != expression:
            previous, expression = expression, sympy.simplify(sympy.sympify(expression).subs(known))
        return expression


@dataclass(frozen=True)
class Ended:
    """Equations at which branches ended: without a real solution, and without one in closed form. Filled by the search."""

    contradictions: list[Equation] = field(default_factory=list)
    unsolved: list[Equation] = field(default_factory=list)


def strata(phase: Phase) -> tuple[list[SymbolicStratum], Ended]:
    """The pieces of ``P_f``, and how the other branches ended."""
    ended = Ended()
    start = [(sympy.diff(phase.hamiltonian, u), 0) for u in phase.u]
    return list(_explore(SymbolicStratum(phase), start, ended)), ended


def _explore(piece: SymbolicStratum, pending: list[Equation], ended: Ended) -> Iterator[SymbolicStratum]:
    """All pieces on which the pending equations hold as well."""
    if not pending:
        yield piece
        return
    (expression, level), rest = pending[0], pending[1:]
    numerator = sympy.numer(sympy.together(piece.reduce(expression)))
    if numerator == 0:
        yield from _explore(piece, rest, ended)
        return
    factors = [(f, m) for f, m in sympy.factor_list(numerator)[1] if not _never_zero(f, piece)]
    if not factors:
        ended.contradictions.append((sympy.factor(numerator), level))
    for factor, multiplicity in factors:
        chosen = replace(piece, irregular=piece.irregular or multiplicity > 1)
        yield from _with(chosen, (factor, level), rest, ended)


def _never_zero(factor: Expression, piece: SymbolicStratum) -> bool:
    known = {sympy.factor(piece.reduce(e)) for e in piece.nonzero}
    return factor.is_zero is False or bool({factor, -factor} & known)


def _with(piece: SymbolicStratum, equation: Equation, rest: list[Equation], ended: Ended) -> Iterator[SymbolicStratum]:
    """The pieces on which one more irreducible equation holds: it determines a control, or else is an equation of ``P_f``."""
    expression, level = equation
    controls = [u for u in piece.phase.u if expression.has(u)]
    candidates = controls or [s for s in (*reversed(piece.phase.p), *piece.phase.q) if expression.has(s)]
    linear = _linear_symbol(expression, candidates)
    if linear is None:
        ended.unsolved.append(equation)
        return
    symbol, coefficient = linear
    constant = coefficient.is_zero is False
    value = sympy.simplify(symbol - expression / coefficient)
    nonzero = piece.nonzero if constant else (*piece.nonzero, coefficient)
    if controls:
        determined = {u: e.subs(symbol, value) for u, e in piece.controls.items()} | {symbol: value}
        levels = piece.levels | {symbol: level}
        yield from _explore(replace(piece, controls=determined, levels=levels, nonzero=nonzero), rest, ended)
    else:
        solution = {s: e.subs(symbol, value) for s, e in piece.solution.items()} | {symbol: value}
        smaller = replace(piece, equations=(*piece.equations, equation), solution=solution, nonzero=nonzero)
        yield from _explore(smaller, [*rest, (piece.phase.rate(expression), level + 1)], ended)
    if not constant:
        yield from _explore(piece, [(coefficient, level), (expression, level), *rest], ended)


def _linear_symbol(expression: Expression, candidates: list[Expression]) -> tuple[Expression, Expression] | None:
    """A symbol in which the expression is linear, and its coefficient: a number where one is, None where none is linear."""
    linear = [(s, sympy.factor(sympy.diff(expression, s))) for s in candidates if sympy.diff(expression, s, 2) == 0]
    return min(linear, key=lambda pair: not pair[1].is_number, default=None)
