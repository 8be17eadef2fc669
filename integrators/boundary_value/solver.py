"""A solver that its user holds: a problem traced once, then solved between many pairs of ends in milliseconds each."""

import time
from collections.abc import Callable, Iterator, Sequence
from numbers import Number
from typing import Any, NamedTuple, cast, final
from weakref import WeakKeyDictionary

import jax
import numpy as np

from ...manifolds import InvalidInputError
from ...manifolds.manifold import default_tolerance, working_precision
from ...manifolds.numerics.ambient import is_finite_number
from ...manifolds.numerics.reading import one_reading
from ...retractions import DiscretizationMap, Gauss, Midpoint
from ..functions import require_concrete
from ..options import HORIZON, known_options
from ..problem import OptimalControlProblem, resting_control
from ..results import Result
from ..singular import Classification, SingularIntegrator, classify
from .arguments import (
    Method,
    Options,
    check_method,
    check_parameters,
    check_problem,
    checked_options,
    fractions_of,
    lengths_of,
    member_of,
    require_tangent_dynamics,
    structure_of,
)
from .boundary import NodeCondition, boundary_conditions, require_ends_on, require_known_ends
from .engine.collocation import Collocation
from .engine.conditions import Conditions, Ends, Iterate
from .engine.diagnosis import Diagnosis
from .engine.evaluator import chosen
from .engine.layout import Layout, parameter_layout
from .engine.newton import Found, Iteration, newton, taken
from .engine.sensitivity import Sensitivities
from .engine.start import Start
from .engine.transcription import Data, Nodes, OneStage
from .guess import Guess, checked_guess
from .outcome import explained, outcomes
from .sensitivity import Sensitivity, require_isolated
from .singular import EndConditions, Request, solve_on_final_manifold
from .solution import Checks, Solution, Solutions, Statistics


class _Member(NamedTuple):
    """What one trajectory is asked for, as it was given."""

    start: Any
    end: Any
    horizon: float
    guess: Guess | None
    parameters: Any


class _Traced(NamedTuple):
    """The functions of a problem with parameters of one structure."""

    steps: OneStage | Collocation
    nodes: Nodes
    diagnosis: Diagnosis


class _Kept(NamedTuple):
    """The KKT system of a solution, one place of those of a batch."""

    traced: _Traced
    conditions: Conditions
    found: Found
    place: int
    parameters: Any


@final
class Solver:
    """An optimal control problem with a method and steps, traced once; ``solve`` is then a matter of milliseconds.

    ``method``: a ``Gauss`` method, or a discretization map. ``steps``: their number, or their lengths, positive numbers that
    count relative to their sum. ``evaluator``: ``"tape"`` of scalar instructions, ``"xla"``, or ``"automatic"``, the tape where
    the functions can be traced to one; ``solver.evaluator`` tells which it is, and ``solver.reason`` why.

    What the functions read when the solver is made stays as it was. What changes from call to call is an argument:
    ``parameters``, any pytree of numbers and arrays, reach functions that take one argument more. They are traced at the first
    call, and again for parameters of another structure.
    """

    @known_options
    def __init__(self, problem: OptimalControlProblem, method: Method, steps: Any, evaluator: str = "automatic") -> None:
        require_concrete("Solver", problem)
        check_problem(problem, method)
        self.problem, self.method, self.fractions = problem, method, fractions_of(steps)
        self.state, self.control = Layout.of(problem.manifold), Layout.of(problem.controls)
        self._evaluator = chosen(evaluator)
        self._start = Start(problem.manifold, method.retraction)
        self._found: dict[Any, _Traced] = {}
        self._classes: dict[Any, tuple[Any, Classification | None]] = {}  # with the parameters that it belongs to
        self._kept: WeakKeyDictionary[Solution, _Kept] = WeakKeyDictionary()
        self._derivatives: dict[Any, Sensitivities] = {}
        if not problem.takes_parameters:
            with one_reading():
                self._traced(None)

    @property
    def steps(self) -> int:
        """Number of steps N."""
        return len(self.fractions)

    @property
    def stages(self) -> np.ndarray:
        """Places of the stages in a step, fractions of it."""
        return np.array(self.method.nodes) if isinstance(self.method, Gauss) else np.array([self.method.theta])

    @property
    def evaluator(self) -> str:
        """``"tape"`` or ``"xla"``: what evaluates the problem's functions."""
        return self._evaluator.name

    @property
    def reason(self) -> str:
        """Why that evaluator was chosen."""
        return self._evaluator.reason

    def __repr__(self) -> str:
        return f"Solver({self.problem.manifold}, {type(self.method).__name__}, {self.steps} steps, on the {self.evaluator})"

    @known_options
    def solve(
        self,
        start: Any,
        end: Any,
        horizon: float,
        guess: Guess | Solution | None = None,
        parameters: Any = None,
        tolerance: float | None = None,
        max_iterations: int = 100,
        callback: Callable[[Iteration], Any] | None = None,
        verbose: bool = False,
        throw: bool = True,
        classification: Classification | None = None,
        integrator: SingularIntegrator | None = None,
    ) -> Solution:
        """The extremal between two boundary conditions over ``[0, horizon]``; see ``solve`` for the arguments they share.

        ``callback``: called with an ``Iteration`` after each evaluation; the iteration ends where it returns something true.
        ``verbose`` prints a line for each. An interrupt, Ctrl-C, ends it too. Either way the record has the best iterate.
        """
        require_concrete("solve", start, end, horizon, guess, parameters)
        options = checked_options(tolerance, max_iterations, callback, verbose)
        began = time.perf_counter()
        with one_reading():
            member = self._member(start, end, horizon, guess, parameters)
            problem, conditions = self._conditions(member)
            given = problem, conditions, member
            trusted = classification is None and self._is_trusted(conditions, member)
            c = classification if trusted or classification is not None else self._classification(*given)
            check_method(problem, self.method, c, integrator)
            solution = None
            if c is None or c.regular:
                solution = self._solved([member], [conditions], options, began)[0]
                if trusted and not self._shows_regular(solution, parameters):
                    c = self._classification(*given)
            if c is not None and not c.regular:
                solution = self._on_final_manifold(*given, options, (c, integrator))
            solution = explained(problem, cast(Solution, solution))
        return solution.require_success() if throw else solution

    @known_options
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
    ) -> Solutions:
        """The extremals between many pairs of ends at once.

        ``starts``, ``ends``, ``horizons``: as for ``solve``, or with one more leading axis, of the same length B wherever it is;
        ``parameters``: arrays with this axis. ``guesses``: a ``Guess`` or ``Solution`` for all, or a list of B. The same factors
        are free for all. Nothing is raised for a member that is not solved: read ``success``. Regular problems only.
        """
        require_concrete("solve_many", starts, ends, horizons, parameters)
        options = checked_options(tolerance, max_iterations, callback, verbose)
        began = time.perf_counter()
        with one_reading():
            members = list(self._members(starts, ends, horizons, guesses, parameters))
            problem, first = self._conditions(members[0])
            c = self._classification(problem, first, members[0])
            if c is not None and not c.regular:
                raise InvalidInputError("solve_many solves regular problems, and this one is singular; call solve for each")
            conditions = [first, *(self._conditions(member)[1] for member in members[1:])]
            kinds = {tuple(condition.parts for condition in pair) for pair in conditions}
            if len(kinds) > 1:
                raise InvalidInputError("the members of a batch have other free factors; solve those with the same ones together")
            return Solutions(self._solved(members, conditions, options, began))

    def sensitivity(self, solution: Solution) -> Sensitivity:
        """Derivatives of a solution that this solver found by its ends, horizon and parameters.

        One more elimination of its KKT system, with a right-hand side for each of them. Regular problems only. Raises
        ``InvalidInputError`` for any other solution, one without success, or if the functions have changed since the solver was
        made, and ``ConvergenceError`` if the system is singular to rounding: then the extremal is one of a family, or its ends
        are conjugate, and it has no derivatives.
        """
        if not isinstance(solution, Solution) or solution not in self._kept or not solution.success:
            raise InvalidInputError(
                f"sensitivity takes a solution with success of a regular problem that this solver found, got {solution!r:.80}; "
                "try solver.sensitivity(solver.solve(...)) with one and the same solver"
            )
        kept = self._kept[solution]
        key, place = structure_of(kept.parameters), np.array([kept.place])
        with one_reading(), np.errstate(all="ignore"):
            if key not in self._derivatives:
                self._derivatives[key] = Sensitivities(kept.traced.steps, kept.traced.nodes, self._evaluator)
            system = taken((kept.found.iterate, kept.found.assembled), place)
            columns = self._derivatives[key](kept.conditions.of(place), *system)
        require_isolated(columns, solution)
        return Sensitivity.of(columns, (self.state, self.control), self.problem.manifold.dimension, kept.parameters)

    def _member(self, start: Any, end: Any, horizon: Any, guess: Any, parameters: Any) -> _Member:
        """The arguments of one trajectory, checked."""
        if not (is_finite_number(horizon) and horizon > 0):
            hint = "" if isinstance(horizon, Number) else f"; {HORIZON}"
            raise InvalidInputError(f"horizon must be a positive finite time, got {horizon!r}{hint}")
        check_parameters(self.problem, parameters)
        if guess is not None:
            guess = guess.guess() if isinstance(guess, Solution) else guess
            guess = checked_guess(self.problem, guess, self.steps, len(self.stages))
        return _Member(start, end, float(horizon), guess, parameters)

    def _members(self, starts: Any, ends: Any, horizons: Any, guesses: Any, parameters: Any) -> Iterator[_Member]:
        """The members of a batch one by one."""
        manifold = self.problem.manifold
        lengths = [*lengths_of(manifold, starts), *lengths_of(manifold, ends), *(np.shape(h) for h in [horizons] if np.ndim(h))]
        lengths += [np.shape(leaf)[:1] for leaf in jax.tree.leaves(parameters)]
        several = isinstance(guesses, Sequence) and not isinstance(guesses, Guess)
        lengths += [(len(guesses),)] if several else []
        if len(set(lengths)) != 1 or not lengths[0]:
            raise InvalidInputError(
                f"starts, ends, horizons, parameters and guesses have leading axes of lengths {sorted(set(lengths))}, expected "
                "one length B, wherever there is such an axis; for a single trajectory call solve"
            )
        for k in range(lengths[0][0]):
            pair = member_of(manifold, starts, k), member_of(manifold, ends, k)
            given = jax.tree.map(lambda leaf, k=k: np.asarray(leaf)[k], parameters)
            horizon = np.asarray(horizons)[k].item() if np.ndim(horizons) else horizons
            yield self._member(*pair, horizon, guesses[k] if several else guesses, given)

    def _conditions(self, member: _Member) -> tuple[OptimalControlProblem, tuple[NodeCondition, NodeCondition]]:
        """The problem with the parameters of a member, and its boundary conditions."""
        problem = self.problem.with_parameters(member.parameters)
        return problem, boundary_conditions(problem.manifold, member.start, member.end, member.guess is not None)

    def _traced(self, parameters: Any) -> _Traced:
        """The functions with parameters of this structure."""
        key = structure_of(parameters)
        if key not in self._found:
            self.problem.with_parameters(parameters).require_values()
            given = self.problem, parameters, self._evaluator
            if isinstance(self.method, Gauss) and self.method.stages > 1:
                steps: Any = Collocation(self.problem, self.method, *given[1:])
            else:
                method = Midpoint(self.method.retraction) if isinstance(self.method, Gauss) else self.method
                steps = OneStage(self.problem, method, *given[1:])
            self._found[key] = _Traced(steps, Nodes(*given), Diagnosis(*given))
        return self._found[key]

    def _classification(
        self, problem: OptimalControlProblem, conditions: tuple[NodeCondition, NodeCondition], member: _Member
    ) -> Classification | None:
        """The classification of a singular problem, None of a regular one; raises for functions that cannot be solved with."""
        first, last = conditions
        values = tuple(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(member.parameters))
        key = structure_of(member.parameters), last.parts
        if key not in self._classes or self._classes[key][0] != values:
            known = first.point if member.guess is None else jax.tree.map(lambda leaf: np.asarray(leaf[0]), member.guess.states)
            regular = problem.check(known, resting_control(problem.controls))
            problem.require_cost(known, last.point, last.fixed_leaves)
            excluded = None if problem.abnormal or problem.is_steep_at(last.fixed_leaves) else False
            self._classes[key] = values, None if regular else classify(problem, exclude_zero_costate=excluded)
        return self._classes[key][1]

    def _is_trusted(self, conditions: tuple[NodeCondition, NodeCondition], member: _Member) -> bool:
        """Whether the problem was regular with the parameters before: then a solution can show that it is with these."""
        key = structure_of(member.parameters), conditions[1].parts
        return key in self._classes and self._classes[key][1] is None

    def _shows_regular(self, solution: Solution, parameters: Any) -> bool:
        """Whether it is a strict minimum, along which ``d2H/du2`` is invertible."""
        layouts = (self.state, solution.stage_states), (self.control, solution.controls), (self.state, solution.stage_costates)
        states, controls, costates = (layout.rows(points, 1)[None] for layout, points in layouts)
        rows = parameter_layout(parameters).rows(parameters, 0)[None]
        minimum = solution.success and solution.checks.strict_minimum
        return minimum and self._traced(parameters).diagnosis.is_curved((states, controls, costates), rows)

    def _solved(
        self,
        members: list[_Member],
        conditions: list[tuple[NodeCondition, NodeCondition]],
        options: Options,
        began: float,
    ) -> list[Solution]:
        """Solutions of regular problems."""
        traced, own, guess = self._posed(members, conditions)
        tracing = time.perf_counter() - began
        with np.errstate(all="ignore"):  # what is not finite is judged
            found = newton(own, guess, *options)
            seconds = tracing, time.perf_counter() - began - tracing
            solutions = list(self._records(traced, own.data, found, options, seconds))
        for k, (solution, member) in enumerate(zip(solutions, members, strict=True)):
            self._kept[solution] = _Kept(traced, own, found, k, member.parameters)
        return solutions

    def _posed(
        self, members: list[_Member], conditions: list[tuple[NodeCondition, NodeCondition]]
    ) -> tuple[_Traced, Conditions, Iterate]:
        """The traced functions, the conditions of the members, and the guesses."""
        parameters = np.stack([parameter_layout(m.parameters).rows(m.parameters, 0) for m in members])
        traced = self._traced(members[0].parameters)
        first, last = conditions[0]
        begin, end = (np.stack([self.state.rows(pair[k].point, 0) for pair in conditions]) for k in (0, 1))
        rows = begin, end
        self._require_on_manifold(traced, members, rows)
        data = Data(np.array([m.horizon for m in members])[:, None] * self.fractions, parameters)
        guess = self._guess(traced, members, rows, data)
        entries = self._entries(first), self._entries(last)
        coordinates = np.array(first.fixed_coordinates, float), np.array(last.fixed_coordinates, float)
        return traced, Conditions(traced.steps, traced.nodes, Ends(*rows, *entries, *coordinates), data), guess

    def _entries(self, condition: NodeCondition) -> np.ndarray:
        """Which entries of a flat point are prescribed."""
        leaves, structure = jax.tree.flatten(self.problem.manifold.ambient)
        ones = [1 + 1j if np.issubdtype(leaf.dtype, np.complexfloating) else 1.0 for leaf in leaves]
        marks = [np.full(a.shape, one * fixed) for a, one, fixed in zip(leaves, ones, condition.fixed_leaves, strict=True)]
        return self.state.rows(jax.tree.unflatten(structure, marks), 0) > 0

    def _require_on_manifold(self, traced: _Traced, members: list[_Member], rows: tuple[np.ndarray, np.ndarray]) -> None:
        """Raise if a prescribed part of an end is off its manifold."""
        for flat in rows:
            off = ~(np.max(traced.nodes.violations(flat), axis=1, initial=0.0) <= default_tolerance())
            for k in np.flatnonzero(off):
                require_ends_on(self.problem.manifold, members[k].start, members[k].end)

    def _guess(self, traced: _Traced, members: list[_Member], rows: tuple[np.ndarray, np.ndarray], data: Data) -> Iterate:
        """The guesses that are given, or curves from start to end with controls at rest and costates zero."""
        count, places, size = len(members), self.stages, self.state.size
        shape = count, self.steps, len(places)
        if members[0].guess is None:
            for member in members:
                require_known_ends(self.problem.manifold, member.start, member.end)
            starts = np.concatenate([[0.0], np.cumsum(self.fractions)[:-1]])
            fractions = (starts[:, None] + places * self.fractions[:, None]).ravel()
            states = self._start.states(*rows, fractions).reshape(*shape, size)
            rest = self.control.rows(jax.tree.map(np.asarray, resting_control(self.problem.controls)), 0)
            controls = np.broadcast_to(rest, (*shape, rest.size))
            costates = np.zeros((count, self.steps + 1, size))
        else:
            guesses: Any = [member.guess for member in members]
            states = np.stack([self.state.rows(guess.states, 1) for guess in guesses]).reshape(*shape, size)
            controls = np.stack([self.control.rows(guess.controls, 1) for guess in guesses]).reshape(*shape, -1)
            costates = np.stack([self.state.rows(guess.costates, 1) for guess in guesses])
        return Iterate(traced.steps.begin(states, controls, costates, data), costates)

    def _records(
        self, traced: _Traced, data: Data, found: Found, options: Options, seconds: tuple[float, float]
    ) -> Iterator[Solution]:
        """The records of all members."""
        nodes, costates = found.assembled.nodes, found.assembled.costates
        costates = traced.nodes.projected(nodes, costates)
        stages = traced.steps.at_stages(found.iterate.unknowns, costates, data)
        diagnostics = traced.diagnosis((nodes, costates), stages, data.parameters)
        results = outcomes(found, options.tolerance, options.max_iterations)
        for k, result in enumerate(results):
            own: Any = jax.tree.map(lambda leaf, k=k: leaf[k], diagnostics)
            require_tangent_dynamics(self.problem, float(own.normal))
            times = np.concatenate([[0.0], np.cumsum(data.steps[k])])
            gap, stationarity = float(found.residuals.gap[k]), float(found.residuals.stationarity[k])
            yield Solution(
                times=times,
                states=self.state.points(nodes[k]),
                costates=self.state.points(costates[k]),
                stage_times=(times[:-1, None] + data.steps[k][:, None] * self.stages).ravel(),
                stage_states=self.state.points(stages[0][k]),
                stage_costates=self.state.points(stages[2][k]),
                controls=self.control.points(stages[1][k]),
                hamiltonians=own.hamiltonians,
                momenta=own.momenta,
                body_costates=own.body,
                spatial_costates=own.spatial,
                cost=float(found.assembled.cost[k]),
                success=bool(result == Result.successful),
                result=Result[result],
                checks=Checks.of(own, gap, stationarity, bool(found.strict_minimum[k])),
                statistics=Statistics(int(found.iterations[k]), *seconds),
            )

    def _on_final_manifold(
        self,
        problem: OptimalControlProblem,
        conditions: tuple[NodeCondition, NodeCondition],
        member: _Member,
        options: Options,
        method: tuple[Classification, SingularIntegrator | None],
    ) -> Solution:
        """The extremal of a singular problem."""
        if not isinstance(self.method, DiscretizationMap):
            raise InvalidInputError(
                f"the problem is singular, and solve takes a discretization map for it, got {self.method!r}; try "
                "Midpoint(default_retraction(manifold))"
            )
        if np.ptp(self.fractions) > 1e-12:
            raise InvalidInputError("the problem is singular, and solve takes equal steps for it; give their number")
        require_ends_on(problem.manifold, member.start, member.end)
        h = np.asarray(member.horizon / self.steps, working_precision())
        limits = np.asarray(options.tolerance, working_precision()), options.max_iterations
        request = Request(problem, self.method, EndConditions(problem, *conditions), member.guess, h, self.steps, *limits)
        return solve_on_final_manifold(request, *method)
