"""Solutions with a free horizon, free parameters or an explicit time: by a solver of their formulation in more
states."""

from collections.abc import Callable
from dataclasses import astuple, replace
from typing import Any, final
from weakref import WeakKeyDictionary

import jax
import numpy as np

from ...manifolds import InvalidInputError
from ...manifolds.numerics import ambient as vec
from ..free import guessed, is_free, near, scaled
from ..results import sentence
from .arguments import Method
from .formulation import Formulation, Kind, checked_horizon
from .guess import Guess
from .members import Asked, MemberReader, Members
from .resampling import resampled
from .sensitivity import Sensitivity
from .solution import Solution, Statistics
from .solutions import Solutions

SINGULAR = (
    "the problem is singular, its controls are not determined by dH/du = 0, and it has a free horizon, free parameters "
    "or an explicit time; expected a running cost with curvature in every control, as u @ u / 2, or bounds that hold "
    "the controls; a running cost that is constant with a free horizon is minimum time, and needs control_bounds or "
    "constraints"
)
LOST = (
    "The horizon tends to {:.3g}, where the conditions vanish and say nothing; try another guess of it, a lower or an "
    "upper bound, or a guess of the trajectory."
)
UNDETERMINED = (
    "The horizon tends to {:.3g}, or is hidden by other costs: the Hamiltonian, zero at an extremal, is {:.1e} of its "
    "parts there; try another guess of it, a lower or an upper bound, or a guess of the trajectory."
)
HELD, UNMET = 1.01, 1e-3  # times a bound that holds the horizon; a share of the parts of a Hamiltonian that is not zero
FAR, AGAIN = 10.0, 3  # from the guess: a horizon that is found again; and how often
MAGNITUDES = 1e-2, 1e2, 1e-4, 1e4, 1e-6, 1e6, 1e-8, 1e8  # times the guess: horizons from which it is tried again


@final
class Formulated:
    """Solvers of the formulations of a problem, one for each kind of free quantities, made when they are asked for."""

    def __init__(self, reader: MemberReader, method: Method, make: Callable[[Formulation], Any]) -> None:
        self.reader, self.method, self._make = reader, method, make
        self._made: dict[Kind, tuple[Formulation, Any]] = {}
        self._found: WeakKeyDictionary[Solution, tuple[Formulation, Any, Solution]] = WeakKeyDictionary()

    def on(self, reader: MemberReader, make: Callable[[Formulation], Any], steps: Any) -> "Formulated":
        """The same on another mesh."""
        other = Formulated(reader, self.method, make)
        other._made = {
            kind: (formulation, solver.with_steps(steps)) for kind, (formulation, solver) in self._made.items()
        }
        other._found = self._found
        return other

    def of(self, horizon: Any, parameters: Any) -> tuple[Formulation, Any]:
        """The formulation for a horizon and parameters, and its solver."""
        kind = Kind.of(horizon, parameters)
        if kind not in self._made:
            example = self.reader.problem.with_parameters(_guessed(parameters)).at_time(0.0)
            example.require_values()
            formulation = Formulation(self.reader.problem, self.method, kind)
            self._made[kind] = formulation, self._make(formulation)
        return self._made[kind]

    def solve(self, asked: Asked, options: dict[str, Any], *choice: Any) -> Solution:
        """The extremal of a single trajectory; ``choice``: of the classification and the integrator of a singular
        one."""
        first = self._in_own_units(asked, self._solved(asked, options, *choice), options, *choice)
        return self._from_elsewhere(asked, first, options, *choice)

    def _from_elsewhere(self, asked: Asked, first: Solution, options: dict[str, Any], *choice: Any) -> Solution:
        """The solution; where it is none and the horizon is free, that of the nearest other magnitude from which there
        is one."""
        horizon = asked.horizon
        if first.success or not is_free(horizon) or first.result == sentence("stopped"):
            return first
        effort = first.statistics
        for factor in MAGNITUDES:
            guess = scaled(horizon, factor)
            if guess is not None:
                again = asked._replace(horizon=guess)
                found = self._in_own_units(again, self._solved(again, options, *choice), options, *choice)
                effort = _sum(effort, found.statistics)
                if found.success or found.result == sentence("stopped"):
                    return self._renewed(found, statistics=effort)
        return self._renewed(first, statistics=effort)

    def _in_own_units(self, asked: Asked, solution: Solution, options: dict[str, Any], *choice: Any) -> Solution:
        """The solution, found again from itself where its horizon is far from the guess, in whose units it was judged.

        A horizon that tends to zero takes all conditions with it.
        """
        for _ in range(AGAIN):
            horizon = asked.horizon
            ratio = solution.horizon / guessed(horizon)
            if not (solution.success and is_free(horizon)):
                return solution
            if 1 / FAR < ratio < FAR:
                return self._with_its_hamiltonian(asked, solution)
            if not 0 < solution.horizon < np.inf:
                break
            before = solution.statistics
            parameters = jax.tree.map(near, asked.parameters, solution.parameters, is_leaf=is_free)
            asked = asked._replace(horizon=near(horizon, solution.horizon), guess=solution, parameters=parameters)
            solution = self._solved(asked, options, *choice)
            solution = self._renewed(solution, statistics=_sum(before, solution.statistics))
        return self._renewed(solution, success=False, result=LOST.format(solution.horizon))

    def _with_its_hamiltonian(self, asked: Asked, solution: Solution) -> Solution:
        """The solution, without success where the Hamiltonian is nowhere zero, as its mean is between the bounds of a
        free horizon.

        Beside other costs, as those of the ends, it is not seen in the residuals where the horizon is next to nothing.
        """
        horizon, size = asked.horizon, solution.checks.hamiltonian_size
        held = not HELD * horizon.lower < solution.horizon < horizon.upper / HELD
        values = solution.hamiltonians / (size if size > 0 else 1.0)
        if held or self.reader.problem.time_dependent or (values.min() <= UNMET and values.max() >= -UNMET):
            return solution
        words = UNDETERMINED.format(solution.horizon, solution.hamiltonians[0] / size)
        return self._renewed(solution, success=False, result=words)

    def _solved(self, asked: Asked, options: dict[str, Any], *choice: Any) -> Solution:
        formulation, solver, own = self.formulated(asked)
        found = solver.found(own, options, *choice)
        return self._kept(formulation, solver, found, asked.parameters)

    def formulated(self, asked: Asked, begins: float | None = None) -> tuple[Formulation, Any, Asked]:
        """The formulation of a single trajectory, its solver, and what is asked of that.

        The time starts at zero, or is free at the start and guessed to begin there.
        """
        if is_free(asked.horizon):
            checked_horizon(asked.horizon)
        members = self.reader.one(_guesses(asked))
        formulation, solver = self.of(asked.horizon, asked.parameters)
        constants, times = formulation.guesses(asked.horizon, asked.parameters), members.horizons + (begins or 0.0)
        start, end = formulation.start(asked.start, constants, begins), formulation.end(asked.end, times)
        guess = self._guess(formulation, members, 0, constants, begins or 0.0)
        if isinstance(asked.guess, Solution) and guess is not None:
            guess = self._with_covectors(formulation, guess, asked.guess, float(members.horizons[0]))
        own = formulation.parameters(asked.horizon, asked.parameters)
        return formulation, solver, Asked(start, end, float(members.horizons[0]), guess, own)

    def solve_many(self, asked: Asked, options: dict[str, Any]) -> Solutions:
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
        stacked = vec.stacked(parameters) if formulation.takes else None
        guesses = [self._guess(formulation, members, k, c) for k, c in enumerate(constants)]
        ends = formulation.start(asked.start, constants), formulation.end(asked.end, members.horizons[:, None])
        own = Asked(*ends, members.horizons, None if members.guess is None else guesses, stacked)
        found = solver.all_found(own, options)
        solutions = []
        for k, (one, free) in enumerate(zip(found, each, strict=True)):
            solution = self._kept(formulation, solver, one, free[1])
            start, end = (self.reader.ends.member(given, k) for given in (asked.start, asked.end))
            own = Asked(start, end, free[0], None, free[1])
            solutions.append(self._from_elsewhere(own, self._in_own_units(own, solution, options), options))
        return Solutions.of(solutions)

    def sensitivity(self, solution: Solution) -> Sensitivity | None:
        """Derivatives of a solution that was found here; None for any other."""
        if not isinstance(solution, Solution) or solution not in self._found:
            return None
        formulation, solver, found = self._found[solution]
        return formulation.sensitivity(solver.sensitivity(found))

    def _guess(
        self, formulation: Formulation, members: Members, k: int, constants: np.ndarray, begins: float = 0.0
    ) -> Guess | None:
        guess, (nodes, stages) = members.guess_of(k), self.reader.mesh.times(float(members.horizons[k]))
        return None if guess is None else formulation.guess(guess, constants, (begins + nodes, begins + stages))

    def _with_covectors(self, formulation: Formulation, guess: Guess, solution: Solution, horizon: float) -> Guess:
        """A guess that is a solution of the same formulation, with its covectors of the constants and of the clock."""
        kept, _, found = self._found.get(solution, (None, None, None))
        if kept is not formulation or found is None:
            return guess
        mesh = self.reader.mesh._replace(interpolant=found.interpolant)
        own, rates = resampled(found, mesh), [1.0] * bool(formulation.constants)
        rates += [found.horizon / horizon] * self.reader.problem.time_dependent  # the clock runs to another time

        def completed(given: Any, known: Any) -> tuple:
            return given[0], *(rate * p for rate, p in zip(rates, known[1:], strict=True))

        pairs = {name: (getattr(guess, name), getattr(own, name)) for name in ("costates", "stage_costates")}
        return guess._replace(**{name: completed(*pair) for name, pair in pairs.items()})

    def _kept(self, formulation: Formulation, solver: Any, found: Solution, parameters: Any) -> Solution:
        solution = formulation.solution(found, parameters, self.reader.mesh.interpolant)
        self._found[solution] = formulation, solver, found
        return solution

    def _renewed(self, solution: Solution, **changes: Any) -> Solution:
        """The solution with changes, of which the derivatives can be asked for as before."""
        changed = replace(solution, **changes)
        self.keep(changed, solution)
        return changed

    def keep(self, changed: Solution, solution: Solution) -> None:
        """Keep what belongs to a solution for another record of it."""
        if solution in self._found:
            self._found[changed] = self._found[solution]


def _sum(one: Statistics, other: Statistics) -> Statistics:
    return Statistics(*(a + b for a, b in zip(astuple(one), astuple(other), strict=True)))


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
