"""The record of a symbolic classification, and its report."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import sympy

from ....manifolds import Euclidean, InvalidInputError
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem_checks.costs import is_steep
from ...reporting.text import Line, table
from .. import wording
from ..integrability_result import IntegrabilityResult
from .algorithm import Equation, Expression, Phase, SymbolicStratum, generic_ranks, strata
from .field import normal_form
from .symbolic_trace import trace

LONGEST_EXPRESSION = 300  # characters of an expression that is printed


@dataclass(frozen=True, eq=False)
class SymbolicClassification(IntegrabilityResult[SymbolicStratum]):
    """The result of the integrability algorithm in exact algebra.

    ``strata``: the pieces of ``P_f`` in closed form, largest dimension first; ``excluded``: how many were left out
    because ``p = 0`` on them. ``ranks``: of ``D(dH/du)`` and of ``d2H/du2`` almost everywhere where ``dH/du = 0``.
    ``contradictions``: equations without a solution that ended a branch; ``unsolved``: those without one in closed
    form, and those that vanish on pieces of smaller dimension too long to follow; each with its level.
    """

    phase: Phase
    ranks: tuple[int, int] | None
    excluded: int
    zero_costate_excluded: bool
    contradictions: tuple[Equation, ...]
    unsolved: tuple[Equation, ...]

    @property
    def family(self) -> bool:
        """Whether ``H`` is a Morse family, almost everywhere."""
        return self.ranks is not None and self.ranks[0] == len(self.phase.u)

    @property
    def regular(self) -> bool:
        """Whether ``dH/du = 0`` determines every control, almost everywhere."""
        return self.ranks is not None and self.ranks[1] == len(self.phase.u)

    def __str__(self) -> str:
        lines = [*_problem(self), *_levels(self)]
        lines += _empty(self) if self.empty else _final(self)
        lines += [
            ("not followed", f"the branch {_short(e)} = 0 at level {k}: no short closed form") for e, k in self.unsolved
        ]
        return table(lines)


def _problem(c: SymbolicClassification) -> Iterator[Line]:
    yield "problem", wording.problem_words(c.problem)
    yield "H", str(c.phase.hamiltonian)
    if c.zero_costate_excluded:
        yield "costate", wording.EXCLUDED
    if c.ranks is not None:
        family, hessian = c.ranks
        size = len(c.phase.u)
        yield (
            "H",
            f"{wording.family_words(c.family)} "
            f"(D(dH/du) has rank {family} of {size} almost everywhere where dH/du = 0)",
        )
        yield "kind", f"{'regular' if c.regular else 'singular'}: d2H/du2 has rank {hessian} of {size} there"


def _levels(c: SymbolicClassification) -> Iterator[Line]:
    for level in range(max((piece.k_f for piece in c.strata), default=-1) + 1):
        found = dict.fromkeys(piece.up_to(level).signature for piece in c.strata)
        yield f"P^{level}", "; ".join(wording.level_words(*signature) for signature in found)


def _empty(c: SymbolicClassification) -> Iterator[Line]:
    yield "P_f", wording.EMPTY_WITHOUT_IT if c.excluded else "empty"
    for expression, level in c.contradictions:
        yield "contradiction", f"{_short(expression)} = 0 at level {level}"


def _final(c: SymbolicClassification) -> Iterator[Line]:
    if c.stratified:
        yield "strata", wording.strata_words(len(c.strata))
    for i, piece in enumerate(c.strata):
        prefix = f"[{i}] " if c.stratified else ""
        for name, text in _stratum(piece, [j for j, other in enumerate(c.strata) if piece.bounds(other)]):
            yield prefix + name, text


def _stratum(piece: SymbolicStratum, larger: list[int]) -> Iterator[Line]:
    total, kernel = 2 * len(piece.phase.q), piece.kernel
    yield (
        "P_f",
        wording.final_words(len(piece.coordinates), total, [wording.ordinal(level) for _, level in piece.equations]),
    )
    for j in larger:
        yield "inside", f"P_f of [{j}], where its ranks drop"
    for expression, level in piece.equations:
        yield "equation", f"{_short(expression)} = 0 (level {level})"
    if piece.irregular:
        yield "equation", "irregular: the differentials of the conditions vanish or depend on each other here"
    for expression in dict.fromkeys(map(piece.reduce, piece.nonzero)):
        yield "closed form", f"holds where {_short(expression)} != 0"
    yield "k_f", wording.stop_words(piece.k_f, piece.k_f_base)
    yield "omega_f", wording.form_words(piece.rank, len(kernel))
    symbols = (*piece.phase.q, *piece.phase.p)
    for vector in kernel:
        terms = sum(
            (c * sympy.Symbol(f"d/d{s}") for s, c in zip(symbols, vector.flat(), strict=True)), start=sympy.Integer(0)
        )
        yield "kernel", _short(terms)
    yield "constraints", wording.class_words(piece.codimension, len(kernel))
    for u in piece.controls:
        yield "control", f"{u} = {_short(piece.reduce(u))} (level {piece.levels[u]})"
    for u in piece.phase.u:
        if u not in piece.controls:
            yield "control", f"{u} is free (gauge)"


def _short(expression: Expression) -> str:
    """The expression, or what it is made of where it would fill a page."""
    text = str(expression)
    if len(text) <= LONGEST_EXPRESSION:
        return text
    symbols = ", ".join(sorted(map(str, expression.free_symbols)))
    return f"[a function of {symbols} that takes {len(text)} characters: see the record]"


def classify_symbolically(problem: OptimalControlProblem, exclude_zero_costate: bool | None) -> SymbolicClassification:
    """The integrability algorithm in exact algebra.

    Raises ``InvalidInputError`` if the problem is not on R^n with controls in R^m, or if no branch ends in closed form.
    """
    if not (isinstance(problem.manifold, Euclidean) and isinstance(problem.controls, Euclidean)):
        raise InvalidInputError(
            f"symbolic=True needs a problem on Euclidean spaces, got {problem.manifold} and {problem.controls}; "
            "classify it without symbolic=True"
        )
    q, p = (_symbols(letter, problem.manifold) for letter in "qp")
    u = _symbols("u", problem.controls)
    hamiltonian = normal_form(trace(problem.hamiltonian, q, p, u).item())
    phase = Phase(hamiltonian, *(tuple(symbols.ravel()) for symbols in (q, p, u)))
    cost = normal_form(hamiltonian - sum(a * sympy.diff(hamiltonian, a) for a in phase.p))
    exclude = exclude_zero_costate
    if exclude is None:
        exclude = problem.abnormal or (not cost.free_symbols and is_steep(problem))
    pieces, ended = strata(phase)
    if not pieces and ended.unsolved:
        raise InvalidInputError(
            f"no branch ends in closed form: {ended.unsolved[0][0]} = 0 is linear in no variable; classify without "
            "symbolic=True"
        )
    pieces = _distinct(pieces)
    kept = [piece for piece in pieces if not (exclude and all(piece.reduce(a) == 0 for a in phase.p))]
    ordered = sorted(kept, key=lambda piece: piece.codimension)
    return SymbolicClassification(
        problem=problem,
        strata=tuple(ordered),
        phase=phase,
        ranks=generic_ranks(phase),
        excluded=len(pieces) - len(kept),
        zero_costate_excluded=bool(exclude),
        contradictions=tuple(dict.fromkeys(ended.contradictions)),
        unsolved=tuple(dict.fromkeys(ended.unsolved)),
    )


def _symbols(letter: str, space: Euclidean) -> np.ndarray:
    names = [sympy.Symbol(f"{letter}{i + 1}", real=True) for i in range(space.dimension)]
    return np.array(names, dtype=object).reshape(space.shape)


def _distinct(pieces: list[SymbolicStratum]) -> list[SymbolicStratum]:
    """The pieces that are inside no other piece, without repetitions."""
    pieces = list({frozenset(piece.solution.items()): piece for piece in reversed(pieces)}.values())[::-1]
    return [
        a
        for i, a in enumerate(pieces)
        if not any(a.inside(b) and (j < i or not b.inside(a)) for j, b in enumerate(pieces) if j != i)
    ]
