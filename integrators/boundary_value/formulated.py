"""Solutions with a free horizon, free parameters or an explicit time: by a solver of their formulation in more states."""

from collections.abc import Callable
from dataclasses import astuple, replace
from typing import Any, final
from weakref import WeakKeyDictionary

import jax
import numpy as np

from ...manifolds import InvalidInputError
from ..free import Free, guessed, is_free
from ..problem import OptimalControlProblem
from .arguments import Method
from .formulation import Formulation, Kind, checked_horizon
from .guess import Guess
from .members import Member, members_of
from .resampling import Mesh
from .sensitivity import Sensitivity
from .solution import Solution, Solutions, Statistics

SINGULAR = (
    "the problem is singular, its controls are not determined by dH/du = 0, and it has a free horizon, free parameters or an "
    "explicit time; expected a running cost with curvature in every control, as u @ u / 2, or bounds that hold the controls; a "
    "running cost that is constant with a free horizon is minimum time, and needs control_bounds or constraints"
)
LOST = (
    "The horizon tends to {:.3g}, where the conditions vanish and say nothing; try another guess of it, a lower or an upper "
    "bound, or a guess of the trajectory."
)
FAR, TOO_FAR, AGAIN = 10.0, 1e6, 3  # from the guess: a horizon that is found again, or not believed; and how often
Given = tuple[Any, Any, Any, Any, Any]  # start, end, horizon, guess, parameters


@final
class Formulated:
    """Solvers of the formulations of a problem, one for each kind of free quantities, made when they are asked for."""

    def __init__(self, problem: OptimalControlProblem, method: Method, mesh: Mesh, make: Callable[[Formulation], Any]) -> None:
        self.problem, self.method, self.mesh, self._make = problem, method, mesh, make
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
        solution = self._in_own_units(given, self._solved(given, options), options)
        return solution.require_success() if throw else solution

    def _in_own_units(self, given: Given, solution: Solution, options: dict[str, Any]) -> Solution:
        """The solution, found again from itself where its horizon is far from the guess, in whose units it was judged.

        A horizon that tends to zero takes all conditions with it.
        """
        start, end, horizon, _, parameters = given
        for _ in range(AGAIN):
            ratio = solution.horizon / guessed(horizon)
            if not (solution.success and is_free(horizon) and not 1 / FAR < ratio < FAR):
                return solution
            if not 1 / TOO_FAR < ratio < TOO_FAR:
                break
            horizon = Free(np.clip(solution.horizon, horizon.lower, horizon.upper), horizon.lower, horizon.upper)
            before = solution.statistics
            solution = self._solved((start, end, horizon, solution, self._near(parameters, solution)), options)
            solution = self._renewed(solution, statistics=_sum(before, solution.statistics))
        return self._renewed(solution, success=False, result=LOST.format(solution.horizon))

    def _solved(self, given: Given, options: dict[str, Any]) -> Solution:
        start, end, horizon, guess, parameters = given
        if is_free(horizon):
            checked_horizon(horizon)
        member = Member.checked(self.problem, self.mesh, (start, end, guessed(horizon), guess, _guesses(parameters)))
        member.conditions(self.problem)
        formulation, solver = self.of(horizon, parameters)
        constants = formulation.guesses(horizon, parameters)
        ends = formulation.start(start, constants), formulation.end(end, np.array([member.horizon]))
        given_guess = self._guess(formulation, member, constants)
        own = formulation.parameters(horizon, parameters)
        found = solver.solve(*ends, member.horizon, given_guess, own, throw=False, **options)
        return self._kept(formulation, solver, found, parameters)

    def solve_many(self, given: Given, **options: Any) -> Solutions:
        """The extremals of a batch."""
        starts, ends, horizons, guesses, parameters = given
        plain = starts, ends, guessed(horizons), guesses, _guesses(parameters)
        members = list(members_of(self.problem, self.mesh, *plain))
        asked = [(_member(horizons, k), _member(parameters, k)) for k in range(len(members))]
        for horizon, _ in asked:
            if is_free(horizon):
                checked_horizon(horizon)
        if len({Kind.of(*each) for each in asked}) > 1:
            raise InvalidInputError("the members of a batch have other bounds; solve those with the same ones together")
        formulation, solver = self.of(*asked[0])
        constants = np.stack([formulation.guesses(*each) for each in asked])
        times = np.array([[member.horizon] for member in members])
        own = [formulation.parameters(*each) for each in asked]
        stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *own) if formulation.takes else None
        own_guesses = [self._guess(formulation, member, c) for member, c in zip(members, constants, strict=True)]
        between = formulation.start(starts, constants), formulation.end(ends, times)
        found = solver.solve_many(*between, times[:, 0], own_guesses if members[0].guess else None, stacked, **options)
        solutions = []
        for one, member, each in zip(found, members, asked, strict=True):
            solution = self._kept(formulation, solver, one, each[1])
            own_given = member.start, member.end, each[0], None, each[1]
            solutions.append(self._in_own_units(own_given, solution, options))
        return Solutions(solutions)

    def sensitivity(self, solution: Solution) -> Sensitivity | None:
        """Derivatives of a solution that was found here; None for any other."""
        if not isinstance(solution, Solution) or solution not in self._found:
            return None
        formulation, solver, found = self._found[solution]
        return formulation.sensitivity(solver.sensitivity(found))

    def _guess(self, formulation: Formulation, member: Member, constants: np.ndarray) -> Guess | None:
        if member.guess is None:
            return None
        return formulation.guess(member.guess, constants, self.mesh.times(member.horizon))

    def _kept(self, formulation: Formulation, solver: Any, found: Solution, parameters: Any) -> Solution:
        solution = formulation.solution(found, parameters, self.mesh.interpolant)
        self._found[solution] = formulation, solver, found
        return solution

    def _renewed(self, solution: Solution, **changes: Any) -> Solution:
        """The solution with changes, of which the derivatives can be asked for as before."""
        changed = replace(solution, **changes)
        self._found[changed] = self._found[solution]
        return changed

    @staticmethod
    def _near(parameters: Any, solution: Solution) -> Any:
        """Parameters of which those that are free are guessed as they were found."""

        def near(asked: Any, found: Any) -> Any:
            return Free(np.clip(found, asked.lower, asked.upper), asked.lower, asked.upper) if is_free(asked) else asked

        return jax.tree.map(near, parameters, solution.parameters, is_leaf=is_free)


def _sum(one: Statistics, other: Statistics) -> Statistics:
    return Statistics(*(a + b for a, b in zip(astuple(one), astuple(other), strict=True)))


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
