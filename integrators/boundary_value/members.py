"""The members of a batch: what each trajectory is asked for, checked, in flat arrays."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Number
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...manifolds import InvalidInputError
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import is_finite_number
from ...manifolds.numerics.precision import default_tolerance, working_precision
from ...manifolds.numerics.tolerances import ROUNDING
from ..evaluator import Automatic, Evaluated, Evaluator
from ..layout import Layout, parameter_layout
from ..options import HORIZON
from ..problem import OptimalControlProblem
from .arguments import check_parameters, copied, structure_of
from .end_points import EndPoints, EndReader, NodeCondition
from .given_guess import FlatGuess, GuessReader
from .guess import Guess
from .resampling import Mesh, resampled
from .solution import Solution


class Asked(NamedTuple):
    """Start, end, horizon, guess and parameters as they are given."""

    start: Any
    end: Any
    horizon: Any
    guess: Any
    parameters: Any


@final
@dataclass(frozen=True, eq=False)
class Members:
    """What the B trajectories of a batch are asked for; of ``solve`` there is one.

    ``ends``: where nothing is known of them, those of the guess, or anything. ``structure`` is that of the parameters
    of one member, which are ``rows`` of shape (B, P).
    """

    reader: "MemberReader"
    asked: Asked
    axes: int  # that what is asked for has for the members: none for a single one
    ends: EndPoints
    horizons: np.ndarray
    guess: FlatGuess | None
    structure: Any
    rows: np.ndarray

    def __len__(self) -> int:
        return len(self.horizons)

    def parameters_of(self, k: int) -> Any:
        """The parameters of a member."""
        given = self.asked.parameters
        return vec.taken(given, k) if self.axes else given

    def parameters(self) -> Any:
        """The parameters as arrays of their own, with the members along the leading axis."""
        given = copied(self.asked.parameters)
        return given if self.axes else vec.taken(given, None)

    def problem_of(self, k: int) -> OptimalControlProblem:
        """The problem with the parameters of a member."""
        return self.reader.problem.with_parameters(self.parameters_of(k))

    def guess_of(self, k: int) -> Guess | None:
        """The guess of a member."""
        return None if self.guess is None else self.reader.guesses.guess(self.guess, k)

    def conditions_of(self, k: int) -> tuple[NodeCondition, NodeCondition]:
        """The boundary conditions of a member."""
        ends, read = self.ends, self.reader.ends.condition
        first, last = ends.prescribed
        return read(_row(ends.start, k), first.parts), read(_row(ends.end, k), last.parts)

    def require_on_manifold(self, violations: np.ndarray) -> None:
        """Raise if a prescribed part of an end, or a state of a guess, is off its manifold.

        ``violations``: one for each of the starts, of the ends, and of the states of the guesses.
        """
        count = len(self.ends.start)
        first, last, rest = np.split(violations, [count, count + len(self.ends.end)])
        if self.guess is not None:
            self.reader.guesses.require_on_manifold(self.guess, rest)
        pair, read = (self.asked.start, self.asked.end), self.reader.ends
        for k in np.flatnonzero(~((first <= default_tolerance()) & (last <= default_tolerance()))):
            read.require_on_manifold(*(read.member(given, int(k)) if self.axes else given for given in pair))


@final
class MemberReader:
    """Reads what ``solve`` and ``solve_many`` are asked for on a mesh."""

    def __init__(self, problem: OptimalControlProblem, mesh: Mesh, evaluator: Evaluator) -> None:
        self.problem, self.mesh, self.ends = problem, mesh, EndReader(problem.manifold)
        self.guesses = GuessReader(problem, len(mesh.fractions), len(mesh.stages))
        self._violations = evaluator.values(self._violations_of, self.ends.layout.size)
        self._parameters: dict[Any, Layout] = {}

    @cached_property
    def _restored(self) -> Evaluated:
        """Points moved onto the manifold; seldom needed."""
        layout = self.ends.layout
        return Automatic().values(lambda q: (layout.flat(self.problem.manifold.restore(layout.point(q))),), layout.size)

    def on(self, mesh: Mesh) -> "MemberReader":
        """The same on another mesh."""
        other = copy(self)
        other.mesh, other.guesses = mesh, GuessReader(self.problem, len(mesh.fractions), len(mesh.stages))
        return other

    def one(self, asked: Asked) -> Members:
        """A single trajectory."""
        _require_horizon(asked.horizon)
        return self._read(asked, 0, np.array([float(asked.horizon)]), [asked.guess])

    def many(self, asked: Asked) -> Members:
        """A batch: what is not for all has one more leading axis."""
        guesses, horizons = asked.guess, asked.horizon
        several = isinstance(guesses, Sequence) and not isinstance(guesses, Guess)
        lengths = [*self.ends.lengths(asked.start), *self.ends.lengths(asked.end)]
        lengths += [np.shape(horizons)] if np.ndim(horizons) else []
        lengths += [np.shape(leaf)[:1] for leaf in jax.tree.leaves(asked.parameters)]
        lengths += [(len(guesses),)] if several else []
        if len(set(lengths)) != 1 or len(lengths[0]) != 1 or not lengths[0][0]:
            raise InvalidInputError(
                f"starts, ends, horizons, parameters and guesses have leading axes of lengths {sorted(set(lengths))}, "
                "expected one length B, wherever there is such an axis; for a single trajectory call solve"
            )
        (count,) = lengths[0]
        for horizon in np.asarray(horizons).tolist() if np.ndim(horizons) else [horizons]:
            _require_horizon(horizon)
        return self._read(
            asked, 1, np.broadcast_to(np.asarray(horizons, float), count), guesses if several else [guesses]
        )

    def _read(self, asked: Asked, axes: int, horizons: np.ndarray, guesses: Sequence[Any]) -> Members:
        check_parameters(self.problem, asked.parameters)
        given = [self._of_solution(guess) if isinstance(guess, Solution) else guess for guess in guesses]
        guess = self.guesses.flat(given) if any(guess is not None for guess in given) else None
        ends = self.ends.ends(asked.start, asked.end, bool(axes))
        if np.any(ends.unknown):
            ends = ends.completed(
                *((self.ends.at_rest,) * 2 if guess is None else (guess.states[:, 0], guess.states[:, -1]))
            )
        structure = structure_of(asked.parameters, axes)
        if structure not in self._parameters:
            self._parameters[structure] = parameter_layout(asked.parameters, axes)
        layout = self._parameters[structure]
        rows = np.broadcast_to(layout.rows(asked.parameters, axes), (len(horizons), layout.size))
        members = Members(self, asked, axes, ends, horizons, guess, structure, rows)
        states = [] if guess is None else [guess.states_to_check(self.ends.layout.size)]
        points = np.concatenate([ends.start, ends.end])
        violations = np.max(self._violations.at(1, np.concatenate([points, *states]))[0], axis=1)
        members.require_on_manifold(violations)
        beside, count = violations[: len(points)], len(ends.start)
        off = (beside > ROUNDING * np.finfo(working_precision()).eps) & (beside <= default_tolerance())
        if not np.any(off):
            return members
        # No trajectory ends beside its manifold.
        moved = self._restored.at(1, points[off])[0]
        points[off] = np.where(np.all(np.isfinite(moved), axis=1, keepdims=True), moved, points[off])
        return replace(members, ends=ends._replace(start=points[:count], end=points[count:]))

    def _of_solution(self, solution: Solution) -> Guess:
        """A solution on the mesh, with the multipliers of the inequalities that the problem has."""
        return self.guesses.known(resampled(solution, self.mesh))

    def _violations_of(self, q: Array) -> tuple[Array]:
        """By how much a flat point violates each equation of the manifold."""
        return (jnp.stack([jnp.zeros(()), *self.problem.manifold.violations(self.ends.layout.point(q)).values()]),)


def _require_horizon(horizon: Any) -> None:
    if not (is_finite_number(horizon) and horizon > 0):
        hint = "" if isinstance(horizon, Number) else f"; {HORIZON}"
        raise InvalidInputError(f"horizon must be a positive finite time, got {horizon!r}{hint}")


def _row(rows: np.ndarray, k: int) -> np.ndarray:
    """Row ``k`` of rows of which there may be one for all."""
    return rows[min(k, len(rows) - 1)]
