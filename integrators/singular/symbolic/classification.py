"""The record of a symbolic classification, and its report."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy

from ....manifolds import Euclidean, InvalidInputError
from ...problem import OptimalControlProblem
from ..result import IntegrabilityResult
from .algorithm import Equation, Phase, SymbolicStratum, normal_form, strata
from .trace import trace


@dataclass(frozen=True, eq=False)
class SymbolicClassification(IntegrabilityResult[SymbolicStratum]):
    """What the integrability algorithm finds in exact algebra.

    ``strata``: the pieces of ``P_f`` in closed form, largest dimension first. ``contradictions``: equations without a
    solution that ended a branch; ``unsolved``: those without one in closed form, and those that vanish on pieces of smaller
    dimension too long to follow; each with its level.
    """

    phase: Phase
    contradictions: tuple[Equation, ...]
    unsolved: tuple[Equation, ...]

    def __str__(self) -> str:
        lines = [("H", str(self.phase.hamiltonian))]
        if self.empty:
            lines += [("P_f", "empty")]
            lines += [("contradiction", f"{e} = 0 at level {level}") for e, level in self.contradictions]
        for i, piece in enumerate(self.strata):
            mark = f"({i + 1}) " if len(self.strata) > 1 else ""
            lines += [(mark + name, text) for name, text in _lines(piece)]
        lines += [("not followed", f"the branch {e} = 0 at level {level}: no short closed form") for e, level in self.unsolved]
        width = max(len(name) for name, _ in lines)
        return "\n".join(f"{name:<{width}}  {text}" for name, text in lines)


def _lines(piece: SymbolicStratum) -> list[tuple[str, str]]:
    total, kernel = 2 * len(piece.phase.q), piece.kernel
    lines = [("P_f", f"dimension {len(piece.coordinates)} in T*Q of dimension {total}")]
    lines += [("equation", f"{e} = 0 (level {level})") for e, level in piece.equations]
    if piece.irregular:
        lines.append(("equation", "irregular: a power of it appears in the conditions"))
    lines += [("assuming", f"{piece.reduce(e)} != 0") for e in piece.nonzero]
    lines.append(("k_f", f"{piece.k_f} (S stops changing; P at {piece.k_f_base})"))
    lines.append(("omega_f", f"rank {piece.rank}, kernel of dimension {len(kernel)}"))
    symbols = (*piece.phase.q, *piece.phase.p)
    for vector in kernel:
        terms = sum((c * sympy.Symbol(f"d/d{s}") for s, c in zip(symbols, vector.flat(), strict=True)), start=sympy.Integer(0))
        lines.append(("kernel", str(terms)))
    lines += [("control", f"{u} = {piece.reduce(u)} (level {piece.levels[u]})") for u in piece.controls]
    lines += [("control", f"{u} is free (gauge)") for u in piece.phase.u if u not in piece.controls]
    return lines


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
    hamiltonian = sympy.simplify(trace(problem.hamiltonian, q, p, u).item())
    phase = Phase(hamiltonian, *(tuple(symbols.ravel()) for symbols in (q, p, u)))
    homogeneous = normal_form(hamiltonian - sum(a * sympy.diff(hamiltonian, a) for a in phase.p)) == 0
    exclude = exclude_zero_costate
    if exclude is None:
        exclude = problem.abnormal or (homogeneous and problem.terminal_cost is not None)
    pieces, ended = strata(phase)
    if not pieces and ended.unsolved:
        raise InvalidInputError(
            f"no branch ends in closed form: {ended.unsolved[0][0]} = 0 is linear in no variable; classify without symbolic=True"
        )
    kept = [piece for piece in pieces if not (exclude and all(piece.reduce(a) == 0 for a in phase.p))]
    ordered = sorted(_distinct(kept), key=lambda piece: piece.codimension)
    return SymbolicClassification(problem, tuple(ordered), phase, tuple(ended.contradictions), tuple(ended.unsolved))


def _symbols(letter: str, space: Euclidean) -> np.ndarray:
    names = [sympy.Symbol(f"{letter}{i + 1}", real=True) for i in range(space.dimension)]
    return np.array(names, dtype=object).reshape(space.shape)


def _distinct(pieces: list[SymbolicStratum]) -> list[SymbolicStratum]:
    """Pieces with different solutions, the first of each."""
    seen: dict[Any, SymbolicStratum] = {}
    for piece in pieces:
        seen.setdefault(frozenset({**piece.solution, **piece.controls}.items()), piece)
    return list(seen.values())
