"""The inputs of a solver: arguments checked and completed once, in flat arrays, for all computations."""

import time
import warnings
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Number
from typing import Any, cast, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.automatic import AutomaticEvaluator
from ....compute.base import Evaluator, PointwiseFunction
from ....manifolds import InvalidInputError, Manifold
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import is_finite_number
from ....manifolds.numerics.precision import default_tolerance, working_precision
from ....manifolds.numerics.tolerances import ROUNDING
from ....retractions import DiscretizationMap
from ...problem.argument_errors import HORIZON
from ...problem.free_quantities import guess_of, guesses_of, is_free
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.point_layout import PointLayout, parameter_layout
from ...problem_checks.requirements import require_retraction
from ...reporting.result_sentences import callers
from ...reporting.text import brief
from ...singular import Classification, SingularIntegrator
from ..guess import Guess, Mesh, MeshGuess
from .arguments import (
    BoundaryData,
    Method,
    check_classification,
    check_parameters,
    check_regular,
    check_singular,
    structure_of,
)
from .boundary_data import BoundaryDataReader, EndPoints, NodeCondition
from .guess_arrays import FlatGuess, GuessReader
from .members import are_several, count_members, member_of, repeat_for_all, row_of
from .options import Options
from .reformulation_kind import ReformulationKind

ROUNDED_POINT = 5e-6  # violation of its equations by a point whose entries have six digits
RESTORING = 2  # Newton steps, which converge quadratically, from there to the rounding of double precision


@final
class InputReader:
    """The reader of the inputs of a solver, with the checked problem, the method and the mesh."""

    def __init__(self, problem: OptimalControlProblem, method: Method, mesh: Mesh, evaluator: Evaluator) -> None:
        self.problem, self.method, self.mesh, self.ends = problem, method, mesh, BoundaryDataReader.of(problem)
        self.guesses = GuessReader(problem, len(mesh.fractions), len(mesh.stages))
        self._violations = evaluator.values(self._violations_of, self.ends.layout.size)
        self._parameters: dict[Any, PointLayout] = {}
        self.retracts = False  # whether the retraction was looked at

    @cached_property
    def _restoration(self) -> PointwiseFunction:
        """Points moved onto the manifold; seldom needed."""
        layout = self.ends.layout
        return AutomaticEvaluator().values(
            lambda q: (layout.flat(self.problem.manifold.restore(layout.point(q))),), layout.size
        )

    def on(self, mesh: Mesh) -> "InputReader":
        """A reader of the same inputs for another mesh."""
        other = copy(self)
        other.mesh, other.guesses = mesh, GuessReader(self.problem, len(mesh.fractions), len(mesh.stages))
        return other

    def flat_guess(self, guesses: Sequence[Any]) -> FlatGuess | None:
        """The guesses, solutions among them resampled, with the multipliers of inequalities that the problem has."""
        given = [
            self.guesses.keep_multipliers(guess._guess_on(self.mesh)) if isinstance(guess, MeshGuess) else guess
            for guess in guesses
        ]
        return self.guesses.flat(given) if any(guess is not None for guess in given) else None

    def parameters(self, given: Any, axes: int, count: int) -> tuple[Any, np.ndarray]:
        """The structure of the parameters of a member, and the parameters of all members in rows."""
        structure = structure_of(given, axes)
        if given is None:
            return structure, np.empty((count, 0))
        if structure not in self._parameters:
            self._parameters[structure] = parameter_layout(given, axes)
        layout = self._parameters[structure]
        rows = layout.rows(given, axes)
        return structure, repeat_for_all(rows if rows.ndim > 1 else rows[None], count)

    def violations(self, points: np.ndarray) -> np.ndarray:
        """By how much each of some flat points violates the equations of the manifold."""
        return self._violations.at(1, points)[0].max(axis=1)

    def restore(self, points: np.ndarray) -> np.ndarray:
        """Flat points on the manifold next to these; where it has none, these."""
        moved = self._restoration.at(1, points)[0]
        return np.where(np.all(np.isfinite(moved), axis=1, keepdims=True), moved, points)

    def require_retraction(self, point: np.ndarray) -> None:
        """Raise unless the retraction of the method is one at a flat point; looked at once."""
        require_retraction(self.method.retraction, self.ends.layout.points(point))
        self.retracts = True

    def _violations_of(self, q: Array) -> tuple[Array]:
        return (jnp.stack([jnp.zeros(()), *self.problem.manifold.violations(self.ends.layout.point(q)).values()]),)


@final
@dataclass(frozen=True, eq=False)
class Inputs:
    """The arguments of ``solve`` or ``solve_many``, checked and completed, for B trajectories, one for ``solve``.

    ``given`` and ``guess`` are as they came, ``known`` has the guesses of the horizon and of parameters that are free.
    ``ends``: unknown ends are the ends of the guess, or arbitrary. ``structure``: structure of the parameters of one
    member, which are ``rows`` of shape (B, P). ``classification``: None for a regular problem, and before a
    classification.
    """

    reader: InputReader
    given: BoundaryData
    known: BoundaryData
    guess: Any
    options: Options
    integrator: SingularIntegrator | None
    axes: int  # that what is asked for has for the members: none for a single one
    began: float  # when it was asked for, on the clock of ``time.perf_counter``
    ends: EndPoints
    horizons: np.ndarray
    guesses: FlatGuess | None
    structure: Any
    rows: np.ndarray
    classification: Classification | None = None

    @classmethod
    def of(
        cls,
        reader: InputReader,
        given: BoundaryData,
        guess: Any,
        options: Options,
        axes: int = 0,
        classification: Classification | None = None,
        integrator: SingularIntegrator | None = None,
    ) -> "Inputs":
        """The inputs of a batch, whose varying data have one more leading axis, or of a single trajectory: a batch of
        one.

        Raises ``InvalidInputError`` or ``NotOnManifoldError`` for a horizon, parameters, a guess, ends or a
        classification that do not belong to the problem and the mesh. Whether the problem is regular is found out
        afterwards, where nobody has said it: see ``with_classification``.
        """
        known = _known_guess(reader.problem, given)
        count = count_members(reader.ends, known, guess) if axes else 1
        _require_horizon(given.horizon, count if axes and np.ndim(known.horizon) else 0)
        check_parameters(reader.problem, known.parameters)
        for begin in given.start_time if axes and np.ndim(given.start_time) == 1 else [given.start_time]:
            _require_start_time(reader.problem, begin)
        if reader.problem.sampling is not None:
            reader.problem.sampling.require_steps(given.horizon, reader.mesh.fractions)
        inputs = cls._read(reader, given, known, guess, options, integrator, classification, axes, count)
        if classification is not None:
            check_classification(inputs.problem, classification)
        if (
            inputs.needs_reformulation
            and len({ReformulationKind.of(data.horizon, data.parameters) for data in inputs.each}) > 1
        ):
            raise InvalidInputError("the members of a batch have other bounds; solve those with the same ones together")
        return inputs

    @classmethod
    def _read(
        cls,
        reader: InputReader,
        given: BoundaryData,
        known: BoundaryData,
        guess: Any,
        options: Options,
        integrator: SingularIntegrator | None,
        classification: Classification | None,
        axes: int,
        count: int,
    ) -> "Inputs":
        """The inputs in flat arrays; raises if ends or guesses are no points of the manifold."""
        began = time.perf_counter()
        guesses = None if guess is None else reader.flat_guess(guess if axes and are_several(guess) else [guess])
        ends = reader.ends.ends(given.start, given.end, bool(axes))
        if ends.unknown.any():
            at_rest = reader.ends.at_rest
            ends = ends.complete(
                *((at_rest, at_rest) if guesses is None else (guesses.states[:, 0], guesses.states[:, -1]))
            )
        asked = reader, given, known, guess, options, integrator, axes, began
        parameters = reader.parameters(known.parameters, axes, count)
        horizons = np.full(count, known.horizon, float)
        return cls(*asked, ends, horizons, guesses, *parameters, classification)._on_manifold()

    def _on_manifold(self) -> "Inputs":
        """The inputs with ends that are on the manifold to rounding.

        Ends that were rounded to six digits, or to single precision, are moved onto the manifold with a warning. Raises
        ``NotOnManifoldError`` for ends farther off, and for a guess off the manifold.
        """
        reader, (start, end, *_) = self.reader, self.ends
        points = np.concatenate([start, end])
        if self.guesses is None:
            beside = reader.violations(points)
        else:
            states = self.guesses.states_to_check(reader.ends.layout.size)
            violations = reader.violations(np.concatenate([points, states]))
            reader.guesses.require_on_manifold(self.guesses, violations[len(points) :])
            beside = violations[: len(points)]
        on = beside <= ROUNDING * np.finfo(working_precision()).eps
        exact = bool(on.all())
        if not exact:
            points[~on] = self._restore_ends(points[~on], beside, on)
        if not reader.retracts:
            reader.require_retraction(points[0])
        if exact:
            return self
        return replace(self, ends=self.ends._replace(start=points[: len(start)], end=points[len(start) :]))

    def _restore_ends(self, points: np.ndarray, beside: np.ndarray, on: np.ndarray) -> np.ndarray:
        """The ends that are not ``on`` the manifold, moved onto it.

        ``beside``: the violations of all ends, of the starts first.
        """
        tolerance = default_tolerance()
        near = beside <= max(ROUNDED_POINT, tolerance)
        for k in np.flatnonzero(~np.all(near.reshape(2, -1), axis=0)):
            data = self.each[int(k)]
            self.reader.ends.require_on_manifold(data.start, data.end, f", member {k}" if len(self) > 1 else "")
        if np.any(near & (beside > tolerance)):
            _warn_of_rounding(self.reader.problem.manifold, np.max(beside[near]))
        for _ in range(RESTORING):  # no trajectory ends beside its manifold
            points = np.where(near[~on, None], self.reader.restore(points), points)
        return points

    def again(self, reader: InputReader, given: BoundaryData, guess: Any) -> "Inputs":
        """The inputs with another problem, mesh or guess, of which only these are checked again."""
        known = _known_guess(reader.problem, given)
        return self._read(reader, given, known, guess, self.options, self.integrator, None, self.axes, len(self))

    def with_classification(self, c: Classification | None) -> "Inputs":
        """The inputs with the classification of a singular problem, without one for a regular problem.

        Raises where it is not to be solved like this.
        """
        if c is None or c.regular:
            check_regular(self.integrator)
            return self if self.classification is None else replace(self, classification=None)
        check_singular(self.problem, self.reader.method, self.reader.mesh.fractions, c, self.integrator)
        return replace(self, classification=c)

    def __len__(self) -> int:
        return len(self.horizons)

    @property
    def needs_reformulation(self) -> bool:
        """Whether there is something that needs more states."""
        return self.known is not self.given

    @cached_property
    def each(self) -> tuple[BoundaryData, ...]:
        """The data of each member."""
        return (
            tuple(member_of(self.reader.ends, self.given, k) for k in range(len(self))) if self.axes else (self.given,)
        )

    def member(self, k: int) -> "Inputs":
        """The inputs of one member, without its guess."""
        known, rows = _known_guess(self.reader.problem, self.each[k]), self.rows[k : k + 1]
        ends = self.ends._replace(start=row_of(self.ends.start, k)[None], end=row_of(self.ends.end, k)[None])
        own: Any = {"known": known, "ends": ends, "horizons": self.horizons[k : k + 1], "rows": rows}
        return replace(self, given=self.each[k], guess=None, guesses=None, axes=0, **own)

    @cached_property
    def problem(self) -> OptimalControlProblem:
        """The problem with the parameters of the first member."""
        return self.problem_of(0)

    @property
    def discretization(self) -> DiscretizationMap:
        """The method of a singular problem."""
        return cast(DiscretizationMap, self.reader.method)

    @property
    def steps(self) -> int:
        """Number of steps N."""
        return len(self.reader.mesh.fractions)

    @property
    def h(self) -> np.ndarray:
        """The size of equal steps of the first member."""
        return np.asarray(self.horizons[0] / self.steps, working_precision())

    def parameters_of(self, k: int) -> Any:
        """The parameters of a member."""
        return vec.taken(self.known.parameters, k) if self.axes else self.known.parameters

    def parameters(self) -> Any:
        """The parameters as arrays of their own, with the members along the leading axis."""
        lead = ... if self.axes else None
        return jax.tree.map(lambda leaf: np.array(leaf)[lead], self.known.parameters)

    def problem_of(self, k: int) -> OptimalControlProblem:
        """The problem with the parameters of a member."""
        return self.reader.problem.with_parameters(self.parameters_of(k))

    def guess_of(self, k: int) -> Guess | None:
        """The guess of a member."""
        return None if self.guesses is None else self.reader.guesses.guess(self.guesses, k)

    def conditions_of(self, k: int) -> tuple[NodeCondition, NodeCondition]:
        """The boundary conditions of a member."""
        ends, read = self.ends, self.reader.ends.condition
        first, last = ends.prescribed
        return read(row_of(ends.start, k), first.parts), read(row_of(ends.end, k), last.parts)


def _warn_of_rounding(manifold: Manifold, violation: float) -> None:
    """Warn of ends that have few digits."""
    warnings.warn(
        f"start or end satisfies the equations of {manifold} to {violation:.1g} only, as a point of six digits or of "
        "single precision does; it was projected onto the manifold. Pass a point in double precision to be exact.",
        stacklevel=callers(),
    )


def _known_guess(problem: OptimalControlProblem, given: BoundaryData) -> BoundaryData:
    """The data with the guesses of free quantities, and the same object if nothing needs more states."""
    if not (problem.time_dependent or any(map(is_free, jax.tree.leaves((given.horizon, given.parameters))))):
        return given
    return given._replace(horizon=guess_of(given.horizon), parameters=guesses_of(given.parameters))


def _require_start_time(problem: OptimalControlProblem, time: Any) -> None:
    """Raise for a start time that is no finite number, or that no function of the problem takes."""
    if not is_finite_number(time):
        raise InvalidInputError(f"start_time must be a finite number, got {brief(time)}; try start_time=0.0")
    if time and not problem.time_dependent:
        raise InvalidInputError(
            f"start_time is {time!r}, and the functions of the problem take no time; expected 0; try "
            "OptimalControlProblem(..., time_dependent=True) with functions of the time, or leave start_time out"
        )


def _require_horizon(horizon: Any, count: int) -> None:
    """Raise for a horizon that is no positive time, alone (``count`` 0) or among ``count`` horizons along an axis."""
    for k in range(count or 1):
        one = horizon if not count else horizon.member(k) if is_free(horizon) else np.asarray(horizon).item(k)
        name = f"horizon, member {k}," if count > 1 else "horizon"
        if is_free(one):
            if np.ndim(one.guess) or not one.guess > 0:
                raise InvalidInputError(
                    f"{name} must be free around a positive finite time, got {one!r}; try Free(10.0)"
                )
        elif not (is_finite_number(one) and one > 0):
            hint = "" if isinstance(one, Number) else f"; {HORIZON}"
            raise InvalidInputError(f"{name} must be a positive finite time, got {one!r}{hint}")
