"""Meshes that are refined until a solution has the accuracy that is asked for."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, final

import numpy as np

from ....manifolds import InvalidInputError, RetraxError
from ....manifolds.numerics.tolerances import EPS
from ....retractions import CollocationMethod
from ...problem.free_quantities import is_free
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.path_constraints import HORIZON_LOWER, HORIZON_UPPER
from ..audit import status
from ..audit.step_errors import StepErrorEstimator, StepErrors
from ..audit.switching_structure import SwitchingStructure, control_arcs
from ..guess import Guess, Mesh
from ..inputs.arguments import BoundaryData, Method
from ..inputs.inputs import Inputs
from ..iteration_reports import Iteration, stops
from ..reformulations.switching_arcs import ArcData, SwitchingArcs
from ..solution.diagnostics import RegularChecks, Statistics
from ..solution.record import Solution
from ..solver import Solver

REFINEMENT_ROUNDS = 25  # at most
# Limits of a refined mesh: its steps, and the stages of its Gauss method, which then has order 12.
MOST_REFINED_STEPS, MOST_REFINED_STAGES = 5000, 6
FEWEST_STEPS = 5  # steps of a mesh to begin with
MOST_PARTS_OF_STEP = 4  # of a step, at most
SHARE, LOOSEST = 1e-3, 1e-9  # of the accuracy, and at most: the tolerance of meshes that follow the first
SLOW_REFINEMENT, REFINEMENT_PATIENCE = 0.8, 4  # shrinking of the error that counts as none, and how often
BOUND_DISTANCE = 1e-6  # relative: a horizon so near its bound is there


class _MeshSolution(NamedTuple):
    """A solution with its errors; of one in arcs, the structure and the arc of each step."""

    solution: Solution
    errors: StepErrors
    structure: SwitchingStructure | None = None
    arcs: np.ndarray | None = None  # (N,)

    @property
    def switches(self) -> np.ndarray | None:
        """The nodes at which controls may jump."""
        return None if self.arcs is None else np.flatnonzero(np.diff(self.arcs)) + 1


class _StoppedError(Exception):
    """Another mesh is asked for after the iteration was stopped."""


@final
@dataclass(eq=False)
class MeshRefinement:
    """Solves a problem on meshes that are refined where steps err, each from the solution before.

    Where most steps err too much, a Gauss method gets one stage more; where few do, these are divided. Where controls
    jump from bound to bound, or to a singular arc, the switches become nodes, see ``SwitchingArcs``.
    """

    solver: Solver  # on the mesh to begin with
    inputs: Inputs
    accuracy: float
    loosely: bool = True  # whether meshes that follow the first are solved no more exactly than that

    def __post_init__(self) -> None:
        self.problem, self.given = self.solver.problem, self.inputs.given
        self.method: Method = self.solver.method
        self._solvers: dict[tuple[Any, Any], Solver] = {(id(self.problem), self.method): self.solver}
        self._arcs: dict[tuple[bytes, float | None], SwitchingArcs] = {}
        self._estimator: StepErrorEstimator | None = None
        self._effort: tuple[int, float, float] = 0, 0.0, 0.0
        self._most, self._stopped = MOST_REFINED_STAGES, False
        self.inputs = self.solver._audit.without_vain_restarts(self.inputs)
        options = self.inputs.options
        if options.callback is not None:
            self._callback = options.callback
            options = options._replace(callback=self._report)
            self.inputs = replace(self.inputs, options=options)
        looser = min(SHARE * self.accuracy, LOOSEST) if self.loosely else 0.0
        self._options = options._replace(tolerance=max(options.tolerance, looser))

    def _report(self, iteration: Iteration) -> bool:
        """Whether the callback stops the iteration, which then holds for all later meshes."""
        self._stopped |= stops(self._callback(iteration))
        return self._stopped

    def solve(self) -> Solution:
        """The solution on the last mesh, with what its conditions do not tell."""
        return self.solver._with_audit(self._refine_until_accurate(), self.inputs)

    def _refine_until_accurate(self) -> Solution:
        solution = self._first()
        if not solution.success:
            return solution
        if solution.singular is not None:
            raise InvalidInputError(
                "the problem is singular, and only the mesh of a regular problem is refined; give a method and steps, "
                "such as method=Midpoint(retraction), steps=50, and no accuracy"
            )
        try:
            best = self._estimate(solution)
        except KeyboardInterrupt:
            return status.stop_before_estimate(solution, Statistics(*self._effort, stopped=True))
        slow, why = 0, f"of the limit of {REFINEMENT_ROUNDS} refinements"
        try:
            best = self._detect_arcs(best)
            for _ in range(REFINEMENT_ROUNDS):
                if self.error(best) <= self.accuracy:
                    break
                found = self._describe_chatter(best) or self._refine(best)
                if isinstance(found, str):
                    why = found
                    break
                found = self._detect_arcs(found)
                slow = slow + 1 if self.error(found) > SLOW_REFINEMENT * self.error(best) else 0
                best = found
                if slow == REFINEMENT_PATIENCE:
                    why = "it no longer shrinks as the steps do"
                    break
        except (_StoppedError, KeyboardInterrupt):  # what was found until then is there
            self._stopped = True
            why = "the iteration was stopped"
        return self._record(best, "" if self.error(best) <= self.accuracy else why)

    def _first(self) -> Solution:
        """The first solution, on the given mesh or, without success, a strict minimum on a coarser or a finer mesh."""
        first, fractions = self._solve(self.solver, self.inputs), self.solver.fractions
        of_mesh = isinstance(self.inputs.guess, Guess)
        if first.success or self._stopped or of_mesh or not self.inputs.options.restarts():
            return first
        meshes, coarse = list[np.ndarray](), fractions
        while len(coarse) >= 2 * FEWEST_STEPS:
            coarse = np.add.reduceat(coarse, np.arange(0, len(coarse), 2))
            meshes.append(coarse)
        for mesh in [*meshes, *(np.repeat(fractions / parts, parts) for parts in (2, MOST_PARTS_OF_STEP))]:
            found = self._on(self.problem, mesh, self.given, self.inputs.guess)
            if self._stopped or (found.success and found.checks.strict_minimum):
                return found
        return first

    def error(self, found: _MeshSolution) -> float:
        """The sum of the errors of the steps, the largest violation, or what the solver has left, and no less than
        rounding."""
        errors, checks = found.errors, found.solution.checks
        left = checks.defect, checks.stationarity
        if isinstance(checks, RegularChecks):
            left = *left, checks.complementarity
        return float(max(np.sum(np.maximum(errors.states, errors.controls)), np.max(errors.inequalities), *left, EPS))

    def _on(self, problem: OptimalControlProblem, steps: Any, given: BoundaryData, guess: Any) -> Solution:
        """The solution on a mesh, by a solver that is traced once for each number of stages."""
        key = id(problem), self.method
        if key in self._solvers:
            solver = self._solvers[key].with_steps(steps)
        else:
            solver = self._solvers[key] = Solver(problem, self.method, steps, self.solver._evaluator)
        options = self._options
        if problem is not self.problem:  # the guess of arcs is near
            options = options._replace(restarts=lambda: False)
        inputs = replace(self.inputs, options=options)
        return self._solve(solver, inputs.again(solver._reader, given, guess))

    def _solve(self, solver: Solver, inputs: Inputs) -> Solution:
        """The solution, with its effort added to the total; raises after a stop of an earlier solution."""
        if self._stopped:
            raise _StoppedError
        solution = solver._find(inputs)
        iterations, compiling, running = self._effort
        spent = solution.statistics
        self._stopped |= spent.stopped
        self._effort = iterations + spent.iterations, compiling + spent.compile_seconds, running + spent.run_seconds
        return solution

    def _estimate(
        self, solution: Solution, structure: SwitchingStructure | None = None, arcs: np.ndarray | None = None
    ) -> _MeshSolution:
        if self._estimator is None:
            self._estimator = StepErrorEstimator(self.problem, self.method.retraction, solution.parameters)
        found = _MeshSolution(solution, None, structure, arcs)  # pyright: ignore[reportArgumentType]
        return found._replace(errors=self._estimator(solution, solution.parameters, found.switches))

    def _describe_chatter(self, found: _MeshSolution) -> str:
        """Why no finer mesh is worth its time: with a control that chatters the error falls in proportion to the step.

        Empty where no control chatters, or where the steps that are needed are few.
        """
        needed = found.solution.steps * self.error(found) / self.accuracy
        if needed <= MOST_REFINED_STEPS or not self.solver._audit.finds_chatter(found.solution):
            return ""
        return (
            "a control chatters along a constraint, so the error falls only in proportion to the step: it would take "
            f"about {needed:.0e} steps, and {MOST_REFINED_STEPS} are the most"
        )

    def _refine(self, found: _MeshSolution) -> "_MeshSolution | str":
        """The solution on a finer mesh, or why there is none."""
        parts, method = self._parts(found), self.method
        self.method = self._higher_order(parts)
        if isinstance(method, CollocationMethod) and self.method is not method:
            finer = self._finer(found, np.ones_like(parts))
            if not isinstance(finer, str) and self.error(finer) < self.error(found):
                return finer
            self.method, self._most = method, method.stages
        return self._finer(found, parts)

    def _finer(self, found: _MeshSolution, parts: np.ndarray) -> "_MeshSolution | str":
        """The solution with each step in some parts, or why there is none."""
        solution = found.solution
        lengths = np.repeat(np.diff(solution.times) / parts, parts)
        if len(lengths) > MOST_REFINED_STEPS:
            return f"it would take more than {MOST_REFINED_STEPS} steps"
        try:
            finer, structure, arcs = self._divide(found, lengths, parts)
        except RetraxError as error:
            return f"a finer mesh is not to be had: {error}"
        if not finer.success:
            return f"it was not solved on a finer mesh of {len(lengths)} steps: {finer.result.removesuffix('.')}"
        return self._estimate(finer, structure, arcs)

    def _divide(
        self, found: _MeshSolution, lengths: np.ndarray, parts: np.ndarray
    ) -> tuple[Solution, SwitchingStructure | None, np.ndarray | None]:
        """The solution in steps of these lengths, in the same arcs if these last and lead to a solution; otherwise
        without arcs.

        Arcs are then detected anew.
        """
        solution = found.solution
        if found.structure is not None and found.arcs is not None:
            arcs = np.repeat(found.arcs, parts)
            finer, lasting = self._in_arcs(solution, found.structure, lengths, arcs)
            if finer.success and lasting.arcs == found.structure.arcs:
                return finer, lasting, arcs
        return self._on(self.problem, lengths, self.given.near(solution), solution), None, None

    def _parts(self, found: _MeshSolution) -> np.ndarray:
        """Into how many parts each step is divided."""
        errors, method = found.errors, self.method
        shares = len(errors.each) / self.accuracy
        with np.errstate(all="ignore"):
            needed = (errors.states * shares) ** (1 / method.order)
            # Squares of distances between polynomials through the stages.
            needed = np.maximum(needed, (errors.controls * shares) ** (1 / (2 * method.stages)))
            needed = np.maximum(needed, np.sqrt(errors.inequalities / self.accuracy))
        return np.clip(
            np.ceil(np.nan_to_num(needed, nan=MOST_PARTS_OF_STEP, posinf=MOST_PARTS_OF_STEP)), 1, MOST_PARTS_OF_STEP
        ).astype(int)

    def _higher_order(self, parts: np.ndarray) -> Method:
        """The method with one stage more, where most steps are too long."""
        method = self.method
        several = 2 * np.sum(parts > 1) > len(parts)
        if isinstance(method, CollocationMethod) and method.stages < self._most and several:
            return method.with_stages(method.stages + 1)
        return method

    def _detect_arcs(self, found: _MeshSolution) -> _MeshSolution:
        """The solution in arcs, if its controls jump and arcs lead to a solution; else the one that there is.

        Arcs count the time from zero, so with a start time only the mesh is refined.
        """
        if self.given.start_time or not any(self.problem._limits.bounded.values()):
            return found
        structure, known = control_arcs(self.problem, found.solution), found.structure
        if known is not None and np.array_equal(known.sides, structure.sides):
            return found
        try:
            while structure.jumps:
                arcs, lengths = _arc_mesh(structure, found.solution)
                solution, lasting = self._in_arcs(found.solution, structure, lengths, arcs)
                if not solution.success:
                    return found
                if lasting.arcs == structure.arcs:
                    better = self._estimate(solution, lasting, arcs)
                    return better if self.error(better) < self.error(found) else found
                structure = lasting
        except RetraxError:  # the guess does not fit: the structure was not seen well enough on this mesh
            return found
        return found

    def _in_arcs(
        self, guess: Solution, structure: SwitchingStructure, lengths: np.ndarray, arcs: np.ndarray
    ) -> tuple[Solution, SwitchingStructure]:
        """The solution in arcs, with steps of these lengths, and its structure; no success if a switch is at a wrong
        place.

        A free horizon that leaves its bounds is held at the one that it passed, and one that was held leaves a bound to
        which nothing pulls it.
        """
        asked, horizon = self.given.horizon, self._horizon(guess)
        found = self._solve_in_arcs(guess, structure, lengths, arcs, horizon)
        if not (is_free(asked) and found[0].success):
            return found
        if is_free(horizon):
            held = float(np.clip(found[0].horizon, asked.lower, asked.upper))
            return found if held == found[0].horizon else self._solve_in_arcs(guess, structure, lengths, arcs, held)
        if self._is_pulled(found[0], horizon):
            return found
        freed = self._solve_in_arcs(guess, structure, lengths, arcs, asked)
        return freed if freed[0].success and asked.lower <= freed[0].horizon <= asked.upper else found

    def _solve_in_arcs(
        self, guess: Solution, structure: SwitchingStructure, lengths: np.ndarray, arcs: np.ndarray, horizon: Any
    ) -> tuple[Solution, SwitchingStructure]:
        """The solution in arcs with a horizon, which is free without bounds or given, and its structure."""
        key = structure.sides.tobytes(), None if is_free(horizon) else float(horizon)
        if key not in self._arcs:
            self._arcs[key] = SwitchingArcs(self.problem, structure.sides, horizon, _unit(guess))
        reformulation = self._arcs[key]
        fractions = lengths / np.bincount(arcs, lengths)[arcs]
        mesh = Mesh(fractions, self.method.nodes, guess.interpolant)  # pyright: ignore[reportArgumentType]
        solution = reformulation.solve(
            ArcData(self.given, guess, structure.times, mesh),
            lambda posed, own: self._on(reformulation.problem, fractions, posed, own),
        )
        if not solution.success:
            return solution, structure
        times = solution.times[np.searchsorted(arcs, np.arange(structure.arcs + 1))]
        lasting = structure._replace(times=times).without_vanished()
        right = lasting.arcs < structure.arcs or reformulation.lack(solution, arcs) <= self.accuracy
        return solution if right else status.fail_between_switches(solution), lasting

    def _horizon(self, solution: Solution) -> Any:
        """The horizon: free, or given, or the bound that holds it, whose multiplier says more than the distance from
        it."""
        horizon = self.given.horizon
        if is_free(horizon):
            step = (solution.times[1] - solution.times[0]) * solution.steps / len(solution.stage_times)
            for bound, name in ((horizon.lower, HORIZON_LOWER), (horizon.upper, HORIZON_UPPER)):
                away = abs(solution.horizon - bound) / solution.horizon
                pull = np.sum(solution.multipliers.get(name, np.zeros(1))) * step / _unit(solution)
                if away <= BOUND_DISTANCE and pull >= away:
                    return bound
        return horizon

    def _is_pulled(self, solution: Solution, bound: float) -> bool:
        """Whether the cost falls beyond the bound that a horizon is held at: it changes by ``-H`` with the horizon."""
        if self.problem.time_dependent:
            return True
        outward = 1.0 if bound == self.given.horizon.upper else -1.0
        return bool(outward * solution.checks.hamiltonian >= -self.accuracy * _unit(solution))

    def _record(self, found: _MeshSolution, why: str) -> Solution:
        """The record, with what was spent on all meshes and what is wrong between the points."""
        solution, errors = found.solution, found.errors
        checks: Any = solution.checks
        between = {name: float(np.max(rows)) for name, rows in errors.violations.items()}
        checks = replace(checks, error=self.error(found), between=between)
        solution = replace(solution, checks=checks, statistics=Statistics(*self._effort, self._stopped))
        worst = int(np.argmax(errors.each))
        return status.fail_in_accuracy(solution, self.accuracy, worst, why) if why else solution


def _unit(solution: Solution) -> float:
    """The unit of the cost over time."""
    return abs(solution.cost) / solution.horizon or 1.0


def _arc_mesh(structure: SwitchingStructure, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Equal steps in each arc, about as many as the solution has there, at least two: their arcs, and lengths."""
    inside = np.histogram(solution.times, structure.times)[0]
    counts = np.maximum(inside, 2)
    return np.repeat(np.arange(structure.arcs), counts), np.repeat(np.diff(structure.times) / counts, counts)
