"""Solutions with a free horizon, free parameters or an explicit time: by a solver of their reformulation in more
states."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, final
from weakref import WeakKeyDictionary

import numpy as np

from ....compute.at_points import evaluate_at_each
from ...problem.free_quantities import Free, guess_of, guesses_of, is_free, with_scaled_guess
from ...problem_checks.requirements import require_values
from ..audit import status
from ..inputs.arguments import BoundaryData
from ..inputs.inputs import InputReader, Inputs
from ..inputs.reformulation_kind import ReformulationKind
from ..solution.batch import Solutions
from ..solution.diagnostics import Statistics
from ..solution.record import Solution
from .free_quantities import FreeQuantities
from .vanishing_horizons import VanishingHorizon

# Times a bound that holds the horizon; a share of the parts of a Hamiltonian that is not zero.
HORIZON_AT_BOUND, UNMET = 1.01, 1e-3
LOST_HORIZON = 1e3  # times the guess, or a share of it: a horizon that is found without success, and named
# Times the guess: horizons from which it is tried again: test_a_horizon_is_found_whatever_its_guess.
MAGNITUDES = 1e-2, 1e2, 1e-4, 1e4, 1e-6, 1e6, 1e-8, 1e8


@final
class FreeQuantitySolver:
    """Solvers of the reformulations of a problem, one for each kind of free quantities, made when they are asked for.

    ``at_guess``: the constant that stands for a free horizon, at its guess.
    """

    def __init__(self, reader: InputReader, make: Callable[[FreeQuantities], Any], at_guess: float = 1.0) -> None:
        self.reader, self._make, self.at_guess = reader, make, at_guess
        self._made: dict[ReformulationKind, tuple[FreeQuantities, Any]] = {}
        self._vanishing = dict[ReformulationKind, VanishingHorizon]()
        self._found: WeakKeyDictionary[Solution, tuple[FreeQuantities, Any]] = WeakKeyDictionary()

    def on(self, reader: InputReader, make: Callable[[FreeQuantities], Any], steps: Any) -> "FreeQuantitySolver":
        """A solver of the reformulations on another mesh."""
        other = FreeQuantitySolver(reader, make, self.at_guess)
        other._made = {
            kind: (formulation, solver.with_steps(steps)) for kind, (formulation, solver) in self._made.items()
        }
        other._found = self._found
        return other

    def of(self, horizon: Any, parameters: Any) -> tuple[FreeQuantities, Any]:
        """The reformulation for a horizon and parameters, and its solver."""
        kind = ReformulationKind.of(horizon, parameters)
        if kind not in self._made:
            example = self.reader.problem.with_parameters(guesses_of(parameters)).at_time(0.0)
            require_values(example)
            formulation = FreeQuantities(self.reader, kind, self.at_guess)
            self._made[kind] = formulation, self._make(formulation)
        return self._made[kind]

    def solve(self, inputs: Inputs) -> Solution:
        """The extremal of a single trajectory."""
        return self._from_elsewhere(inputs, self._reject_vanishing(inputs, self._solve(inputs)))

    def _from_elsewhere(self, inputs: Inputs, first: Solution) -> Solution:
        """The solution, or without success and with a free horizon, the solution from the nearest other magnitude that
        has one."""
        horizon = inputs.given.horizon
        if not is_free(horizon) or status.is_final(first) or not inputs.options.restarts():
            return first
        effort = first.statistics
        for factor in MAGNITUDES:
            guess = with_scaled_guess(horizon, factor)
            if guess is not None:
                again = inputs.again(self.reader, inputs.given._replace(horizon=guess), inputs.guess)
                other = self._reject_vanishing(again, self._solve(again))
                effort = _sum(effort, other.statistics)
                if status.is_final(other):
                    return self._with_effort(other, effort)
        return self._with_effort(self._explain(horizon, first), effort)

    def _explain(self, horizon: Free, solution: Solution) -> Solution:
        """The solution without success, with a sentence on a horizon far from its guess.

        The cost changes by ``-H`` with the horizon.
        """
        guess = guess_of(horizon)
        if HORIZON_AT_BOUND * horizon.lower < solution.horizon <= guess / LOST_HORIZON:
            return self._as_before(status.explain_short_horizon(solution, guess), solution)
        longer = solution.horizon >= LOST_HORIZON * guess and HORIZON_AT_BOUND * solution.horizon < horizon.upper
        pull = np.mean(solution.hamiltonians) if longer and not self.reader.problem.time_dependent else 0.0
        cheaper = pull > 0 and pull > UNMET * self._size_of_parts(solution)
        return self._as_before(status.explain_long_horizon(solution, guess), solution) if cheaper else solution

    def _size_of_parts(self, solution: Solution) -> float:
        """The largest of ``<p, X>`` and ``F`` at the stages, however small.

        The size in the checks is no less than rounding with controls of size 1, which says nothing of far smaller ones.
        """
        problem = self.reader.problem.with_parameters(solution.parameters)
        with np.errstate(all="ignore"):
            rates = evaluate_at_each(
                lambda point: problem.cost_rate(*point), (solution.stage_states, solution.controls)
            )
        return float(max(np.max(np.abs(rates)), np.max(np.abs(solution.hamiltonians + rates))))

    def _reject_vanishing(self, inputs: Inputs, solution: Solution) -> Solution:
        """The solution, without success where its horizon tends to zero or its Hamiltonian is nowhere zero."""
        horizon, parameters = inputs.given.horizon, inputs.given.parameters
        if not is_free(horizon):
            return solution
        if solution.success:
            solution = self._with_its_hamiltonian(horizon, solution)
        if solution.statistics.stopped or not self.vanishes(horizon, parameters, solution, inputs.options.tolerance):
            return solution
        return self._as_before(status.fail_at_zero(solution, "The horizon", solution.horizon), solution)

    def vanishes(self, horizon: Any, parameters: Any, solution: Solution, tolerance: float) -> bool:
        """Whether the free horizon of a solution tends to zero."""
        kind = ReformulationKind.of(horizon, parameters)
        if kind not in self._vanishing:
            self._vanishing[kind] = VanishingHorizon(self.reader.problem, guesses_of(parameters))
        return self._vanishing[kind](solution, tolerance)

    def _with_its_hamiltonian(self, horizon: Free, solution: Solution) -> Solution:
        """The solution, without success where the Hamiltonian is nowhere zero, as its mean is between the bounds of a
        free horizon.

        Beside other costs, as those of the ends, it is not seen in the residuals where the horizon is next to nothing.
        """
        size = solution.checks.hamiltonian_size
        held = not HORIZON_AT_BOUND * horizon.lower < solution.horizon < horizon.upper / HORIZON_AT_BOUND
        values = solution.hamiltonians / (size if size > 0 else 1.0)
        if held or self.reader.problem.time_dependent or (values.min() <= UNMET and values.max() >= -UNMET):
            return solution
        return self._as_before(status.fail_with_hamiltonian(solution, solution.hamiltonians[0] / size), solution)

    def _solve(self, inputs: Inputs) -> Solution:
        formulation, solver = self.of(inputs.given.horizon, inputs.given.parameters)

        def search(posed: BoundaryData, guess: Any) -> Solution:
            return solver._find(inputs.again(solver._reader, posed, guess))

        solution = formulation.solve(inputs, search)
        self._found[solution] = formulation, solver
        return solution

    def solve_many(self, inputs: Inputs) -> Solutions:
        """The extremals of a batch."""
        formulation, solver = self.of(inputs.each[0].horizon, inputs.each[0].parameters)
        posed, solutions, stopped = formulation.apply(inputs), list[Solution](), False
        extremals = solver._find_all(inputs.again(solver._reader, posed, formulation.guess(inputs, posed)))
        for k, one in enumerate(extremals):
            solution, member = formulation.recover(posed, one), inputs.member(k)
            self._found[solution] = formulation, solver
            if stopped:  # in a search of a member before
                solution = self._with_effort(solution, replace(solution.statistics, stopped=True))
            solution = self._from_elsewhere(member, self._reject_vanishing(member, solution))
            stopped = solution.statistics.stopped
            solutions.append(solution)
        return Solutions.of(solutions)

    def origin(self, solution: Any) -> tuple[FreeQuantities, Any, Solution] | None:
        """The reformulation of a solution that was found here, its solver, and its extremal; None for any other."""
        if not isinstance(solution, Solution) or solution not in self._found:
            return None
        formulation, solver = self._found[solution]
        return formulation, solver, formulation.recovered[solution]

    def _with_effort(self, solution: Solution, effort: Statistics) -> Solution:
        """The solution with this effort."""
        return self._as_before(replace(solution, statistics=effort), solution)

    def _as_before(self, changed: Solution, solution: Solution) -> Solution:
        """The changed solution, of which the derivatives can be asked for as before."""
        self.keep(changed, solution)
        return changed

    def keep(self, changed: Solution, solution: Solution) -> None:
        """Keep what belongs to a solution for another record of it."""
        if solution in self._found:
            formulation, _ = self._found[changed] = self._found[solution]
            formulation.recovered[changed] = formulation.recovered[solution]


def _sum(one: Statistics, other: Statistics) -> Statistics:
    return Statistics(
        one.iterations + other.iterations,
        one.compile_seconds + other.compile_seconds,
        one.run_seconds + other.run_seconds,
        one.stopped or other.stopped,
    )
