"""Solutions with a free horizon, free parameters or an explicit time: by a solver of their formulation in more states."""

from collections.abc import Callable
from typing import Any, final
from weakref import WeakKeyDictionary

import jax
import numpy as np

from ...manifolds import InvalidInputError
from ..free import guessed, is_free
from ..problem import OptimalControlProblem
from .arguments import Method
from .formulation import Formulation, Kind, checked_horizon
from .guess import Guess
from .members import Asked, MemberReader, Members
from .resampling import Mesh
from .sensitivity import Sensitivity
from .solution import Solution, Solutions

SINGULAR = (
    "the problem is singular, its controls are not determined by dH/du = 0, and it has a free horizon, free parameters or an "
    "explicit time; expected a running cost with curvature in every control, as u @ u / 2, or bounds that hold the controls; a "
    "running cost that is constant with a free horizon is minimum time, and needs control_bounds or constraints"
)
Given = tuple[Any, Any, Any, Any, Any]  # start, end, horizon, guess, parameters


@final
class Formulated:
    """Solvers of the formulations of a problem, one for each kind of free quantities, made when they are asked for."""

    def __init__(self, problem: OptimalControlProblem, method: Method, mesh: Mesh, make: Callable[[Formulation], Any]) -> None:
        self.problem, self.method, self.mesh, self._make = problem, method, mesh, make
        self._reader = MemberReader(problem, mesh)
        self._made: dict[Kind, tuple[Formulation, Any]] = {}
        self._found: WeakKeyDictionary[Solution, tuple[Formulation, Any, Solution]] = WeakKeyDictionary()

    def of(self, horizon: Any, parameters: Any) -> tuple[Formulation, Any]:
        """The formulation for a horizon and parameters, and its solver."""
        kind = Kind.of(horizon, parameters)
        if kind not in self._made:
            example = self.problem.with_parameters(_guesses(parameters)).at_time(0.0)
            example.require_values()
            formulation = Formulation(self.problem, self.method, kind)
            self._made[kind] = formulation, self._make(formulation)
        return self._made[kind]

    def solve(self, given: Given, throw: bool, **options: Any) -> Solution:
        """The extremal of a single trajectory."""
        start, end, horizon, guess, parameters = given
        if is_free(horizon):
            checked_horizon(horizon)
        members = self._reader.one(Asked(start, end, guessed(horizon), guess, _guesses(parameters)))
        formulation, solver = self.of(horizon, parameters)
        constants = formulation.guesses(horizon, parameters)
        ends = formulation.start(start, constants), formulation.end(end, members.horizons)
        given_guess = self._guess(formulation, members, 0, constants)
        own = formulation.parameters(horizon, parameters)
        found = solver.solve(*ends, float(members.horizons[0]), given_guess, own, throw=False, **options)
        solution = self._kept(formulation, solver, found, parameters)
        return solution.require_success() if throw else solution

    def solve_many(self, given: Given, **options: Any) -> Solutions:
        """The extremals of a batch."""
        starts, ends, horizons, guesses, parameters = given
        members = self._reader.many(Asked(starts, ends, guessed(horizons), guesses, _guesses(parameters)))
        asked = [(_member(horizons, k), _member(parameters, k)) for k in range(len(members))]
        for horizon, _ in asked:
            if is_free(horizon):
                checked_horizon(horizon)
        if len({Kind.of(*each) for each in asked}) > 1:
            raise InvalidInputError("the members of a batch have other bounds; solve those with the same ones together")
        formulation, solver = self.of(*asked[0])
        constants = np.stack([formulation.guesses(*each) for each in asked])
        times = members.horizons[:, None]
        own = [formulation.parameters(*each) for each in asked]
        stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *own) if formulation.takes else None
        own_guesses = [self._guess(formulation, members, k, c) for k, c in enumerate(constants)]
        between = formulation.start(starts, constants), formulation.end(ends, times)
        found = solver.solve_many(*between, times[:, 0], None if members.guess is None else own_guesses, stacked, **options)
        return Solutions.of([self._kept(formulation, solver, one, each[1]) for one, each in zip(found, asked, strict=True)])

    def sensitivity(self, solution: Solution) -> Sensitivity | None:
        """Derivatives of a solution that was found here; None for any other."""
        if not isinstance(solution, Solution) or solution not in self._found:
            return None
        formulation, solver, found = self._found[solution]
        return formulation.sensitivity(solver.sensitivity(found))

    def _guess(self, formulation: Formulation, members: Members, k: int, constants: np.ndarray) -> Guess | None:
        guess = members.guess_of(k)
        return None if guess is None else formulation.guess(guess, constants, self.mesh.times(float(members.horizons[k])))

    def _kept(self, formulation: Formulation, solver: Any, found: Solution, parameters: Any) -> Solution:
        solution = formulation.solution(found, parameters, self.mesh.interpolant)
        self._found[solution] = formulation, solver, found
        return solution


def _guesses(parameters: Any) -> Any:
    """Parameters with the guesses of those that are free."""
    return jax.tree.map(guessed, parameters, is_leaf=is_free)


def _member(given: Any, k: int) -> Any:
    """Number ``k`` of a batch."""

    def one(leaf: Any) -> Any:
        if is_free(leaf):
            return leaf.member(k)
        return leaf if np.ndim(leaf) == 0 else np.asarray(leaf)[k]

    return jax.tree.map(one, given, is_leaf=is_free)
