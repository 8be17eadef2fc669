"""A solver that its user holds: a problem traced once, then solved between many pairs of ends in milliseconds each."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from copy import copy
from functools import partial
from typing import Any, NamedTuple, final
from weakref import WeakKeyDictionary

import numpy as np

from ...compute.automatic import choose_evaluator
from ...compute.closure_guard import ClosureGuard
from ...compute.compile_time import Stopwatch
from ...manifolds import InvalidInputError
from ...tracing import is_tracing, one_tracing, reads_once
from ..problem.argument_errors import require_known_options
from ..problem.free_quantities import Free, is_free
from ..problem.optimal_control_problem import OptimalControlProblem
from ..problem.user_functions import require_concrete
from ..problem_checks.requirements import HELD, require_treated
from ..reporting.text import brief
from ..singular import Classification, SingularIntegrator
from .audit.audit import Audit
from .audit.status import explain_failure
from .export.c_export import export_c
from .guess import Guess, Mesh
from .inputs.arguments import ALONG, BoundaryData, Method, check_problem, step_fractions, structure_of
from .inputs.inputs import InputReader, Inputs
from .inputs.options import Options
from .iteration_reports import Iteration
from .reformulations.free_quantities import FreeQuantities
from .reformulations.free_quantity_solver import FreeQuantitySolver
from .regular_extremals import find_extremals
from .regularity import Regularity
from .shooting import solve_on_final_manifold
from .solution.batch import Solutions
from .solution.covariance import Covariance, covariance_of, require_estimate
from .solution.diagnostics import add_compile_time
from .solution.differentiable_solution import INSTEAD, DifferentiableSolution, differentiable_extremal
from .solution.feedback import feedback
from .solution.interpolation import Interpolant
from .solution.record import Solution
from .solution.sensitivity import ParametricSensitivity, Sensitivity, require_isolated
from .solution_builder import ExtremalRecords, SolutionBuilder
from .transcription.discrete_extremals import DiscreteExtremals
from .transcription.transcribed_problem import TranscribedProblem, Transcription

HELD_WORDS = ", or give what changes as parameters"


class _LastSolution(NamedTuple):
    """The KKT system of a solution, which is one place of a batch."""

    transcribed: TranscribedProblem
    found: DiscreteExtremals
    place: int
    parameters: Any


@final
class Solver:
    """An optimal control problem with a method and steps, traced once, so that each ``solve`` takes milliseconds.

    Parameters
    ----------
    problem, method : OptimalControlProblem, Gauss or DiscretizationMap
        The problem and its discretization.
    steps : int or array_like of shape (N,)
        The number of steps, or their positive lengths relative to their sum.
    evaluator : {"automatic", "tape", "xla"}
        The evaluator of the functions; automatically a tape of scalar instructions if the functions can be traced.

    Notes
    -----
    A ``Solver`` freezes the values that your functions use when you build it: after a change, a new trace raises
    ``InvalidInputError``. Pass values that change between solves as ``parameters``.

    Examples
    --------
    >>> line = Euclidean(1)
    >>> moved = OptimalControlProblem(line, lambda q, u, mass: u / mass, lambda q, u, mass: u @ u / 2, controls=1)
    >>> solver = Solver(moved, Midpoint(Addition(line)), steps=4)
    >>> [round(solver.solve(0.0, 1.0, 2.0, parameters=mass).cost, 6) for mass in (1.0, 2.0)]
    [0.25, 1.0]
    """

    @require_known_options
    def __init__(
        self, problem: OptimalControlProblem, method: Method, steps: Any, evaluator: Any = "automatic"
    ) -> None:
        require_concrete("Solver", problem)
        check_problem(problem, method)
        self.problem, self.method, self.fractions = problem, method, step_fractions(steps)
        self._evaluator = choose_evaluator(evaluator)
        self._transcription = Transcription(problem, method, self.fractions, self._evaluator)
        interpolant = Interpolant(method.retraction, problem.controls, problem.node_cost is not None)
        mesh = Mesh(self.fractions, self._transcription.stages, interpolant)
        self._reader = InputReader(problem, method, mesh, self._evaluator)
        self._builder = SolutionBuilder(problem, self._transcription.stages, interpolant)
        self._reformulation = FreeQuantitySolver(self._reader, self._inner)
        self._regularity, self._audit = Regularity(self._transcription), Audit(problem)
        self._kept: WeakKeyDictionary[Solution, _LastSolution] = WeakKeyDictionary()
        self._derivatives: dict[Any, Any] = {}  # the traced functions
        # Of a solver that is made where functions are read, whoever made it looks after that.
        self._unchanged = None if is_tracing() else ClosureGuard("Solver", problem._digest, HELD_WORDS)
        if self._unchanged is not None and not problem.takes_parameters:
            with self._unchanged.guard(None):
                self._read()

    def _read(self) -> None:
        """Trace the functions as they are now."""
        if self.problem.time_dependent:
            data = BoundaryData(None, None, 1.0, None)
            formulation, solver = self._reformulation.of(data.horizon, data.parameters)
            solver._transcription.trace(formulation.parameters(data))
        else:
            self._transcription.trace(None)

    def _inner(self, formulation: FreeQuantities) -> "Solver":
        """A solver of a reformulation of the problem."""
        solver = Solver(formulation.problem, formulation.method, self.fractions, self._evaluator)
        solver._regularity.posed, solver._builder.formulation = formulation.own, formulation
        return solver

    def with_steps(self, steps: Any) -> "Solver":
        """A solver with other steps that shares the traced functions with this one.

        Parameters
        ----------
        steps : int or array_like of shape (N,)
            The number of steps, or their relative lengths.
        """
        other = copy(self)
        other.fractions = step_fractions(steps)
        other._transcription = self._transcription.on(other.fractions)
        other._reader = self._reader.on(self._reader.mesh._replace(fractions=other.fractions))
        other._reformulation = self._reformulation.on(other._reader, other._inner, steps)
        other._regularity = self._regularity.on(other._transcription)
        return other

    def __copy__(self) -> "Solver":
        other = object.__new__(Solver)
        vars(other).update(vars(self))
        return other

    def __reduce_ex__(self, protocol: Any) -> Any:
        raise TypeError(
            "a Solver can be neither pickled nor copied by copy.deepcopy: it holds traced functions and compiled code; "
            "pickle or copy the problem and the method, and make another one, Solver(problem, method, steps)"
        )

    @property
    def steps(self) -> int:
        """Number of steps N."""
        return len(self.fractions)

    @property
    def stages(self) -> np.ndarray:
        """Places of the stages in a step, fractions of it."""
        return np.array(self._transcription.stages)

    @property
    def evaluator(self) -> str:
        """The evaluator of the functions, ``"tape"`` or ``"xla"``."""
        return self._evaluator.name

    @property
    def reason(self) -> str:
        """The reason for the choice of the evaluator."""
        return self._evaluator.reason

    def __repr__(self) -> str:
        name = type(self.method).__name__
        return f"Solver({self.problem.manifold}, {name}, {self.steps} steps, on the {self.evaluator})"

    @require_known_options
    @reads_once
    def solve(
        self,
        start: Any,
        end: Any,
        horizon: float | Free,
        guess: Guess | Solution | None = None,
        parameters: Any = None,
        tolerance: float | None = None,
        max_iterations: int = 100,
        callback: Callable[[Iteration], Any] | None = None,
        verbose: bool = False,
        throw: bool = True,
        classification: Classification | None = None,
        integrator: SingularIntegrator | None = None,
        start_time: float = 0.0,
    ) -> Solution:
        """The extremal between two boundary conditions over ``[0, horizon]``, or the best iterate after an interrupt.

        Parameters
        ----------
        start, end, horizon, guess, parameters, tolerance, max_iterations, callback, verbose
            As in ``retrax.solve``, with the same errors.
        throw, classification, integrator, start_time
            As in ``retrax.solve``.
        """
        require_concrete("solve", start, end, horizon, guess, parameters, instead=INSTEAD)
        options = Options.of(tolerance, max_iterations, callback, verbose)
        given = BoundaryData(start, end, horizon, parameters, start_time)
        inputs = Inputs.of(self._reader, given, guess, options, 0, classification, integrator)
        with self._guard(inputs.parameters_of(0)):
            solution = self._solve(inputs)
        return solution.require_success() if throw else solution

    def _guard(self, parameters: Any) -> AbstractContextManager[Any]:
        """A time in which what is traced is what the solver has traced before."""
        return one_tracing() if self._unchanged is None else self._unchanged.guard(parameters)

    def _solve(self, inputs: Inputs) -> Solution:
        """The extremal of the inputs, audited."""
        return self._with_audit(self._find(self._audit.without_vain_restarts(inputs)), inputs)

    def _find(self, inputs: Inputs) -> Solution:
        """The extremal of the inputs, with only the first-order conditions evaluated."""
        if inputs.needs_reformulation:
            return self._reformulation.solve(inputs)
        regularity = self._regularity
        solution = self._member(self._search(inputs)) if regularity.needs_proof(inputs) else None
        if solution is None or not regularity.proves(inputs, solution):
            inputs = inputs.with_classification(inputs.classification or regularity.classification(inputs))
            if inputs.classification is not None:
                solution = solve_on_final_manifold(inputs, inputs.classification)
            elif solution is None:
                solution = self._member(self._search(inputs))
        return solution if solution.success else explain_failure(inputs.problem, solution)

    def _with_audit(self, solution: Solution, inputs: Inputs) -> Solution:
        """The solution with the results of all checks."""
        free_horizon = is_free(inputs.given.horizon)
        if self._audit.is_silent(inputs.structure, free_horizon):
            return solution
        with Stopwatch() as watch:
            examined = self._audit(solution, free_horizon, inputs.ends.prescribed)
            examined = add_compile_time(examined, sum(watch.seconds()))
        if examined is not solution:
            if solution in self._kept:
                self._kept[examined] = self._kept[solution]
            self._reformulation.keep(examined, solution)
        return examined

    @require_known_options
    @reads_once
    def solve_many(
        self,
        starts: Any,
        ends: Any,
        horizons: Any,
        guesses: Any = None,
        parameters: Any = None,
        tolerance: float | None = None,
        max_iterations: int = 100,
        callback: Callable[[Iteration], Any] | None = None,
        verbose: bool = False,
        start_time: Any = 0.0,
    ) -> Solutions:
        """The extremals between many pairs of ends at once, for regular problems; read ``success`` of the members.

        Parameters
        ----------
        starts, ends, horizons, guesses, parameters
            As for ``solve``, or arrays with one more leading axis of length ``B``, and a list of ``B`` guesses. The
            same factors are free for all members.
        tolerance, max_iterations, callback, verbose
            As in ``retrax.solve``. Members are solved side by side in threads; with a callback, or ``verbose``, one
            after the other, and ``iteration.members`` holds the place of the member.
        start_time : float or array of shape (B,)
            As for ``solve``, or one for each member.
        """
        require_concrete("solve_many", starts, ends, horizons, parameters, instead=INSTEAD)
        options = Options.of(tolerance, max_iterations, callback, verbose)
        given = BoundaryData(starts, ends, horizons, parameters, start_time)
        inputs = Inputs.of(self._reader, given, guesses, options, 1)
        with self._guard(inputs.parameters_of(0)):
            return self._audit_all(self._find_all(inputs), inputs)

    def _find_all(self, inputs: Inputs) -> Solutions:
        """The extremals of a batch, with only the first-order conditions evaluated."""
        if inputs.needs_reformulation:
            return self._reformulation.solve_many(inputs)
        self._regularity.require_regular(inputs)
        records = self._search(inputs)
        return Solutions(records.fields, partial(self._member, records), range(len(inputs)))

    def _audit_all(self, solutions: Solutions, inputs: Inputs) -> Solutions:
        """The solutions of a batch with what their conditions do not tell."""
        if not self._audit.applies(solutions[0].parameters, is_free(inputs.given.horizon)):
            return solutions
        examined = [self._with_audit(solution, inputs) for solution in solutions]
        same = all(one is other for one, other in zip(examined, solutions, strict=True))
        return solutions if same else Solutions.of(examined)

    def sensitivity(self, solution: Solution) -> Sensitivity:
        """The derivatives of a solution with respect to its ends, horizon and parameters, by one more elimination.

        Parameters
        ----------
        solution : Solution
            A successful solution of a regular problem that this solver found; ``InvalidInputError`` for others.
            ``ConvergenceError`` if its KKT system is singular: the extremal is one of a family, or its ends are
            conjugate.
        """
        require_treated(self.problem, "sensitivity", *ALONG)
        origin = self._reformulation.origin(solution)
        if origin is not None:
            formulation, solver, found = origin
            return formulation.recover_sensitivity(solver.sensitivity(found))
        if not isinstance(solution, Solution) or solution not in self._kept or not solution.success:
            raise InvalidInputError(
                "sensitivity takes a solution with success of a regular problem that this solver found, got "
                f"{brief(solution)}; try solver.sensitivity(solver.solve(...)) with one and the same solver"
            )
        kept = self._kept[solution]
        key = structure_of(kept.parameters)
        with self._guard(kept.parameters), np.errstate(all="ignore"):
            if key not in self._derivatives:
                traced = kept.transcribed.traced
                self._derivatives[key] = ParametricSensitivity(traced.steps, traced.nodes, self._evaluator)
            columns = self._derivatives[key](kept.found.system(kept.place))
        require_isolated(columns, solution)
        layouts = self._transcription.state, self._transcription.control
        return Sensitivity.of(columns, layouts, self.problem.manifold.dimension, kept.parameters)

    def covariance(self, solution: Solution) -> Covariance:
        """The covariance of estimated states and free parameters, from the factors of the KKT system.

        Parameters
        ----------
        solution : Solution
            A minimum of a regular problem that this solver found; ``InvalidInputError`` for others, and
            ``ConvergenceError`` if the costs do not determine the states and parameters.
        """
        require_treated(self.problem, "covariance", *ALONG, HELD)
        origin = self._reformulation.origin(solution)
        if origin is not None:
            formulation, solver, found = origin
            return formulation.recover_covariance(solver.covariance(found))
        kept = require_estimate(self._kept.get(solution) if isinstance(solution, Solution) else None, solution)
        with self._guard(solution.parameters), np.errstate(all="ignore"):
            return covariance_of(kept.found.system(kept.place), solution)

    @require_known_options
    def extremal(
        self,
        start: Any,
        end: Any,
        horizon: Any,
        guess: Guess | Solution | None = None,
        parameters: Any = None,
        tolerance: float | None = None,
        max_iterations: int = 100,
    ) -> DifferentiableSolution:
        """The cost, states, costates and controls of the extremal as JAX arrays with derivatives.

        Parameters
        ----------
        start, end, horizon, guess, parameters, tolerance, max_iterations
            As in ``retrax.solve``; errors as in ``solve`` and ``sensitivity``.

        Notes
        -----
        JAX takes first derivatives in all arguments except ``guess``, outside ``jit`` and ``vmap``. Tangents of ends
        are projected to the tangent spaces. The derivative of the cost is :math:`-p_0` in the start and :math:`p_N` in
        the end.
        """

        def solve(given: BoundaryData) -> Solution:
            options = {"tolerance": tolerance, "max_iterations": max_iterations}
            return self.solve(given.start, given.end, float(given.horizon), guess, given.parameters, **options)

        posed = BoundaryData(start, end, horizon, parameters)
        return differentiable_extremal(self.problem.manifold, posed, solve, self.sensitivity)

    export_c = require_known_options(export_c)
    feedback = require_known_options(feedback)

    def _search(self, inputs: Inputs) -> ExtremalRecords:
        """The records of what searches find, of regular problems."""
        transcribed = self._transcription.transcribe(inputs)
        tracing = time.perf_counter() - inputs.began
        with np.errstate(all="ignore"), Stopwatch() as watch:  # what is not finite is judged
            found = find_extremals(transcribed, inputs.options)
            records = ExtremalRecords(self._builder, transcribed, inputs, found)
            compiling, running = watch.seconds()
        records.seconds = tracing + compiling, running
        return records

    def _member(self, records: ExtremalRecords, k: int = 0) -> Solution:
        """The solution of a member, of which the derivatives can be asked for."""
        solution = records.member(k)
        self._kept[solution] = _LastSolution(records.transcribed, records.found, k, solution.parameters)
        return solution
