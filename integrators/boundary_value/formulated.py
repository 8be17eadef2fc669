"""Solutions with a free horizon, free parameters or an explicit time: by a solver of their formulation in more states."""

from collections.abc import Callable
from typing import Any, final
from weakref import WeakKeyDictionary

import jax
import numpy as np

from ...manifolds import InvalidInputError
from ..free import guessed, is_free
from .arguments import Method
from .formulation import Formulation, Kind, checked_horizon
from .guess import Guess
from .members import Asked, MemberReader, Members
from .sensitivity import Sensitivity
from .solution import Solution, Solutions

SINGULAR = (
    "the problem is singular, its controls are not determined by dH/du = 0, and it has a free horizon, free parameters or an "
    "explicit time; expected a running cost with curvature in every control, as u @ u / 2, or bounds that hold the controls; a "
    "running cost that is constant with a free horizon is minimum time, and needs control_bounds or constraints"
)


@final
class Formulated:
    """Solvers of the formulations of a problem, one for each kind of free quantities, made when they are asked for."""

    def __init__(self, reader: MemberReader, method: Method, make: Callable[[Formulation], Any]) -> None:
        self.reader, self.method, self._make = reader, method, make
        self._made: dict[Kind, tuple[Formulation, Any]] = {}
        self._found: WeakKeyDictionary[Solution, tuple[Formulation, Any, Solution]] = WeakKeyDictionary()

    def of(self, horizon: Any, parameters: Any) -> tuple[Formulation, Any]:
        """The formulation for a horizon and parameters, and its solver."""
        kind = Kind.of(horizon, parameters)
        if kind not in self._made:
            example = self.reader.problem.with_parameters(_guessed(parameters)).at_time(0.0)
            example.require_values()
            formulation = Formulation(self.reader.problem, self.method, kind)
            self._made[kind] = formulation, self._make(formulation)
        return self._made[kind]

    def solve(self, asked: Asked, throw: bool, **options: Any) -> Solution:
        """The extremal of a single trajectory."""
        if is_free(asked.horizon):
            checked_horizon(asked.horizon)
        members = self.reader.one(_guesses(asked))
        formulation, solver = self.of(asked.horizon, asked.parameters)
        constants = formulation.guesses(asked.horizon, asked.parameters)
        ends = formulation.start(asked.start, constants), formulation.end(asked.end, members.horizons)
        guess, own = self._guess(formulation, members, 0, constants), formulation.parameters(asked.horizon, asked.parameters)
        found = solver.solve(*ends, float(members.horizons[0]), guess, own, throw=False, **options)
        solution = self._kept(formulation, solver, found, asked.parameters)
        return solution.require_success() if throw else solution

    def solve_many(self, asked: Asked, **options: Any) -> Solutions:
        """The extremals of a batch."""
        members = self.reader.many(_guesses(asked))
        each = [(_member(asked.horizon, k), _member(asked.parameters, k)) for k in range(len(members))]
        for horizon, _ in each:
            if is_free(horizon):
                checked_horizon(horizon)
        if len({Kind.of(*own) for own in each}) > 1:
            raise InvalidInputError("the members of a batch have other bounds; solve those with the same ones together")
        formulation, solver = self.of(*each[0])
        constants = np.stack([formulation.guesses(*own) for own in each])
        parameters = [formulation.parameters(*own) for own in each]
        stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *parameters) if formulation.takes else None
        guesses = [self._guess(formulation, members, k, c) for k, c in enumerate(constants)]
        ends = formulation.start(asked.start, constants), formulation.end(asked.end, members.horizons[:, None])
        found = solver.solve_many(*ends, members.horizons, None if members.guess is None else guesses, stacked, **options)
        kept = [self._kept(formulation, solver, one, own[1]) for one, own in zip(found, each, strict=True)]
        return Solutions.of(kept)

    def sensitivity(self, solution: Solution) -> Sensitivity | None:
        """Derivatives of a solution that was found here; None for any other."""
        if not isinstance(solution, Solution) or solution not in self._found:
            return None
        formulation, solver, found = self._found[solution]
        return formulation.sensitivity(solver.sensitivity(found))

    def _guess(self, formulation: Formulation, members: Members, k: int, constants: np.ndarray) -> Guess | None:
        guess, times = members.guess_of(k), self.reader.mesh.times(float(members.horizons[k]))
        return None if guess is None else formulation.guess(guess, constants, times)

    def _kept(self, formulation: Formulation, solver: Any, found: Solution, parameters: Any) -> Solution:
        solution = formulation.solution(found, parameters, self.reader.mesh.interpolant)
        self._found[solution] = formulation, solver, found
        return solution


def _guesses(asked: Asked) -> Asked:
    """What is asked for with the guesses of the horizon and of parameters that are free."""
    return asked._replace(horizon=guessed(asked.horizon), parameters=_guessed(asked.parameters))


def _guessed(parameters: Any) -> Any:
    return jax.tree.map(guessed, parameters, is_leaf=is_free)


def _member(given: Any, k: int) -> Any:
    """Number ``k`` of a batch."""

    def one(leaf: Any) -> Any:
        if is_free(leaf):
            return leaf.member(k)
        return leaf if np.ndim(leaf) == 0 else np.asarray(leaf)[k]

    return jax.tree.map(one, given, is_leaf=is_free)
