"""The constraint algorithm on R^n with exact algebra, branching where an equation factors or a coefficient may
vanish."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache

import sympy

from ..integrability_result import Signature
from .field import Expression, UntreatableError, field_of, normal_form

PRECISION = 40  # digits
LONG_EQUATION = 20  # terms of an equation at which a branch of smaller dimension is left

Equation = tuple[Expression, int]  # to be made zero, and the level of the algorithm that asks for it
History = tuple[tuple[Expression, Expression, int], ...]  # symbols, their values by those found later, and the levels


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

    ``equations``: pairs of an expression that vanishes on it and the level at which it appeared; ``history``: the
    coordinates and controls that are determined, in the order in which they were found, with their values then and the
    levels; ``nonzero``: expressions assumed not to vanish; ``conditions``: all that was made zero, as it came, with its
    level; ``factors``: the factors of it that were chosen; ``degenerate``: a coefficient that vanishes, where the piece
    branched off for it.
    """

    phase: Phase
    equations: tuple[Equation, ...] = ()
    history: History = ()
    nonzero: tuple[Expression, ...] = ()
    conditions: tuple[Equation, ...] = ()
    factors: tuple[Expression, ...] = ()
    degenerate: Expression | None = None

    @property
    def solution(self) -> dict[Expression, Expression]:
        """The determined coordinates and controls as functions of the free coordinates and controls."""
        return _insert(self.history)

    @property
    def treatable(self) -> bool:
        """Whether all that is determined is a function that exact algebra treats."""
        try:
            return bool(self.solution) or True
        except UntreatableError:
            return False

    @property
    def controls(self) -> dict[Expression, Expression]:
        """The determined controls."""
        return {s: e for s, e in self.solution.items() if s in self.phase.u}

    @property
    def levels(self) -> dict[Expression, int]:
        """The levels that determine the controls."""
        return {s: level for s, _, level in self.history if s in self.phase.u}

    @property
    def coordinates(self) -> tuple[Expression, ...]:
        """Coordinates of ``T*Q`` that parametrise the piece."""
        return tuple(s for s in (*self.phase.q, *self.phase.p) if s not in self.solution)

    @property
    def dimension(self) -> int:
        """Dimension of the piece."""
        return len(self.coordinates)

    @property
    def codimension(self) -> int:
        """Number of equations."""
        return len(self.equations)

    @property
    def signature(self) -> Signature:
        """Codimension, free controls, rank of the form."""
        return Signature(self.codimension, self.free_controls, self.rank)

    def up_to(self, level: int) -> "SymbolicStratum":
        """The stratum of ``P^level`` that holds this one: what was known at that level."""
        equations, conditions = (
            tuple(e for e in known if e[1] <= level) for known in (self.equations, self.conditions)
        )
        history = tuple(found for found in self.history if found[2] <= level)
        return SymbolicStratum(self.phase, equations, history, conditions=conditions)

    @property
    def irregular(self) -> bool:
        """Whether the differentials of the conditions up to some level vanish or depend on each other on that ``P^k``.

        So does that of ``x^2``, unless another condition of the level has a simple zero on the piece.
        """
        parts = map(self.up_to, sorted({level for _, level in self.conditions}))
        return any(
            part._ranks([e for e, _ in part.conditions])[1] < part.codimension + len(part.controls) for part in parts
        )

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
        return (top.T * bottom - bottom.T * top).applyfunc(normal_form)

    @property
    def rank(self) -> int:
        """Rank of ``omega_f``."""
        return len(self.coordinates) - len(self.kernel)

    @property
    def free_controls(self) -> int:
        """Number of controls that are left free."""
        return len(self.phase.u) - len(self.controls)

    @property
    def kernel(self) -> list[sympy.Matrix]:
        """Basis of the kernel of ``omega_f``, as vectors ``(dq, dp)``."""
        if not self.coordinates:
            return []
        jacobian, form = self.embedding.jacobian(sympy.Matrix(self.coordinates)), self.form
        if generic_rank(form) == len(self.coordinates):
            return []
        return [(jacobian * v).applyfunc(normal_form) for v in form.nullspace(iszerofunc=lambda e: normal_form(e) == 0)]

    def reduce(self, expression: Expression) -> Expression:
        """An expression on this piece, with the determined controls and coordinates inserted."""
        return normal_form(sympy.sympify(expression).xreplace(self.solution))

    def inside(self, other: "SymbolicStratum") -> bool:
        """Whether the points of this one, with their controls, are almost all regular points of the other one."""
        if self.codimension < other.codimension or self.free_controls > other.free_controls:
            return False
        conditions, determined = [*(e for e, _ in other.conditions), *other.factors], len(other.controls)
        if any(self.reduce(e) != 0 for e in conditions):
            return False
        return self._ranks(conditions) == (determined, determined + other.codimension)

    def _ranks(self, conditions: list[Expression]) -> tuple[int, int]:
        """Ranks at a point of this piece of the derivatives of conditions: by the controls, and by all."""
        states, controls = (*self.phase.q, *self.phase.p), self.phase.u
        column = sympy.Matrix(conditions or [0])
        slopes = (column.jacobian(sympy.Matrix(symbols)) for symbols in (controls, states))
        of_u, of_states = (slope.xreplace(self.solution) for slope in slopes)
        return generic_rank(of_u), generic_rank(of_u.row_join(of_states))

    def bounds(self, other: "SymbolicStratum") -> bool:
        """Whether the equations of the other one, of larger dimension, hold here."""
        return self.codimension > other.codimension and all(self.reduce(e) == 0 for e, _ in other.equations)


@lru_cache(maxsize=1024)  # pieces share the beginnings of their histories
def _insert(history: History) -> dict[Expression, Expression]:
    """The solved expressions, each with all later solutions inserted."""
    if not history:
        return {}
    *_, (symbol, value, _) = history
    known = _insert(history[:-1])
    return {s: normal_form(e.xreplace({symbol: value})) if e.has(symbol) else e for s, e in known.items()} | {
        symbol: value
    }


@dataclass(frozen=True)
class SearchResult:
    """Equations at which branches ended: without a real solution, and without one in closed form. Filled by the search.

    ``last``: the level at which the search itself ends.
    """

    last: float = math.inf
    contradictions: list[Equation] = field(default_factory=list)
    unsolved: list[Equation] = field(default_factory=list)


def strata(phase: Phase, last: float = math.inf) -> tuple[list[SymbolicStratum], SearchResult]:
    """The pieces of ``P_f``, or of ``P^last``, and how the other branches ended."""
    ended = SearchResult(last)
    start = [(sympy.diff(phase.hamiltonian, u), 0) for u in phase.u]
    return list(_explore(SymbolicStratum(phase), start, ended)), ended


def generic_ranks(phase: Phase) -> tuple[int, int] | None:
    """Ranks of ``D(dH/du)`` and ``d2H/du2`` almost everywhere where ``dH/du = 0``; None if no such point is known."""
    # A part of dH/du = 0 is no smaller than T*Q: smaller pieces lie in others.
    pieces = [piece for piece in strata(phase, last=0)[0] if piece.free_controls >= piece.codimension]
    slope = sympy.Matrix([phase.hamiltonian]).jacobian(sympy.Matrix(phase.u))
    state, control = (slope.jacobian(sympy.Matrix(symbols)) for symbols in ((*phase.q, *phase.p), phase.u))
    found = [
        [generic_rank(matrix.xreplace(piece.solution)) for matrix in (state.row_join(control), control)]
        for piece in pieces
    ]
    return (min(family for family, _ in found), min(hessian for _, hessian in found)) if found else None


def generic_rank(matrix: sympy.Matrix) -> int:
    """Rank of a matrix of functions at a point with small fractions as coordinates: no larger than the rank almost
    everywhere."""
    field = field_of(*matrix)
    point = field.point(
        {s: sympy.Rational(2 * i + 3, 3 * i + 7) for i, s in enumerate(sorted(matrix.free_symbols, key=str))}
    )
    values = matrix.xreplace(field.inside).xreplace(point)
    return values.rank(iszerofunc=lambda a: abs(a.evalf(PRECISION)) < 10 ** -(PRECISION // 2))


def _explore(piece: SymbolicStratum, pending: list[Equation], ended: SearchResult) -> Iterator[SymbolicStratum]:
    """All pieces on which the pending equations hold as well."""
    if not pending:
        yield piece
        return
    (expression, level), rest = pending[0], pending[1:]
    piece = replace(piece, conditions=(*piece.conditions, (expression, level)))
    try:
        terms, contradiction, factors = _factor(expression, piece)
    except UntreatableError:  # by what was inserted
        ended.unsolved.append((expression, level))
        return
    if terms == 0:
        yield from _explore(piece, rest, ended)
        return
    if piece.degenerate is not None and terms > LONG_EQUATION:
        ended.unsolved.append((piece.degenerate, level))
        return
    if not factors:
        ended.contradictions.append((contradiction, level))
    for factor in factors:
        yield from _with(piece, (factor, level), rest, ended)


def _factor(expression: Expression, piece: SymbolicStratum) -> tuple[int, Expression, list[Expression]]:
    """The number of terms of an expression on a piece, its numerator, and the irreducible factors that may vanish."""
    reduced = piece.reduce(expression)
    field = field_of(reduced)
    numerator = field.fraction(reduced)[0]
    if numerator == 0:
        return 0, numerator, []
    terms = len(sympy.Add.make_args(sympy.expand(numerator)))
    factors = [f for f in _irreducible(reduced) if not _never_zero(f, piece)]
    return terms, sympy.factor(numerator).xreplace(field.outside), factors


def _never_zero(function: Expression, piece: SymbolicStratum) -> bool:
    """Whether a function is known to vanish nowhere on a piece."""
    factors = _irreducible(function)
    known = {f for e in piece.nonzero for f in _irreducible(piece.reduce(e))}
    return all(f in known or -f in known for f in factors)


def _irreducible(function: Expression) -> list[Expression]:
    """The factors of the numerator that may vanish; ``a - log c`` for ``exp(a) - c``."""
    field, found = field_of(function), list[Expression]()
    for factor, _ in sympy.factor_list(field.fraction(function)[0])[1]:
        if field.never_zero(factor):
            continue
        exponent = field.exponent_where_zero(factor)
        found += [factor.xreplace(field.outside)] if exponent is None else _irreducible(exponent)
    return found


def _contradict(equations: list[Expression], piece: SymbolicStratum) -> bool:
    """Whether equations have no solution for the relations between their functions, as ``sin x = cos x = 0``."""
    reduced = [piece.reduce(e) for e in equations]
    field = field_of(*reduced)
    if not field.relations:
        return False
    polynomials = [field.fraction(e)[0] for e in reduced] + [
        sympy.fraction(sympy.together(r))[0] for _, r in field.relations
    ]
    symbols = sorted(set().union(*(e.free_symbols for e in polynomials)), key=sympy.default_sort_key)
    return sympy.groebner(polynomials, *symbols, order="grevlex").exprs == [1]


def _with(
    piece: SymbolicStratum, equation: Equation, rest: list[Equation], ended: SearchResult
) -> Iterator[SymbolicStratum]:
    """The pieces on which one more irreducible equation holds: it determines a control, or else is an equation of
    ``P_f``."""
    expression, level = equation
    controls = [u for u in piece.phase.u if expression.has(u)]
    pivots = _pivots(
        expression, controls or [s for s in (*reversed(piece.phase.p), *piece.phase.q) if expression.has(s)], piece
    )
    if not pivots:
        ended.unsolved.append(equation)
        return
    coefficient = pivots[0][1]
    never = _never_zero(coefficient, piece)
    if controls and not never and len(pivots) < len(controls):
        ended.unsolved.append((coefficient, level))  # there a control is determined that is not linear
    further = [] if controls or level >= ended.last else [(piece.phase.rate(expression), level + 1)]
    piece = replace(piece, factors=(*piece.factors, expression))
    for i, (symbol, slope, value) in enumerate(pivots if controls and not never else pivots[:1]):
        solved = replace(piece, history=(*piece.history, (symbol, value, level)))
        if not controls:
            solved = replace(solved, equations=(*piece.equations, equation))
        if not never:
            solved = replace(solved, nonzero=(*piece.nonzero, slope))
        if not solved.treatable:
            ended.unsolved.append(equation)
            continue
        for found in _explore(solved, [*rest, *further], ended):
            if all(found.reduce(earlier) == 0 for _, earlier, _ in pivots[:i]):  # otherwise the pivot before has it
                yield found
    if never:
        return
    # Where the coefficient vanishes another symbol serves, but later equations may vanish there alone.
    special = sorted(_gradient(expression, controls), key=sympy.count_ops) if controls else [coefficient]
    if _contradict([expression, *special], piece):
        return
    here = replace(piece, degenerate=coefficient if piece.degenerate is None else piece.degenerate)
    yield from _explore(here, [*((e, level) for e in special), (expression, level), *rest], ended)


def _gradient(expression: Expression, symbols: Iterable[Expression]) -> list[Expression]:
    return [e for s in symbols if (e := sympy.diff(expression, s)) != 0]


def _pivots(
    expression: Expression, candidates: list[Expression], piece: SymbolicStratum
) -> list[tuple[Expression, Expression, Expression]]:
    """The symbols in which the expression is linear, their coefficients and their values.

    Those with coefficients that never vanish first, then those in no function of the Hamiltonian, then the simplest.
    """
    slopes = [(s, normal_form(sympy.diff(expression, s))) for s in candidates]
    linear = [(s, slope, normal_form(s - expression / slope)) for s, slope in slopes if not slope.has(s)]
    inserted = set().union(*(f.free_symbols for f in piece.phase.hamiltonian.atoms(sympy.Function, sympy.exp)))

    def key(pivot: tuple[Expression, Expression, Expression]) -> tuple[bool, bool, int]:
        symbol, slope, _ = pivot
        return not _never_zero(slope, piece), symbol in inserted, sympy.count_ops(sympy.factor(slope))

    return sorted((pivot for pivot in linear if not pivot[2].has(pivot[0])), key=key)
