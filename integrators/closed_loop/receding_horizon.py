"""Receding horizon control: a solve at each sample, from a warm start, within a budget."""

import time
from typing import Any, final

import numpy as np

from ...manifolds import DomainError, InvalidInputError
from ...manifolds.numerics.ambient import is_count, is_finite_number
from ..boundary_value.solution.feedback import Feedback
from ..boundary_value.solution.record import Solution
from ..boundary_value.solver import Solver
from ..problem.argument_errors import require_known_options
from ..problem.sampling import Sampling
from ..reporting.text import brief
from .controller_export import export_c
from .plan import Budget, Plan
from .plant import Plant, SentControls, Signal, clip_to_bounds, idle_control
from .soft_constraints import soften
from .statistics import ControllerStatistics, Source

DEFAULT_ITERATIONS = 100  # of a solve without a budget, as of Solver.solve


@final
class RecedingHorizon:
    r"""A receding horizon controller (MPC): it solves the problem from each measured state, from a warm start.

    Parameters
    ----------
    solver : Solver
        The solver of the problem with its method and steps.
    end : point, None or callable
        The end of each plan, as in ``Solver.solve``, or a function of the time at which the plan ends.
    horizon : float, optional
        The duration of the plans of a moving window.
    end_time : float, optional
        The time at which all plans end: the horizon shrinks. With ``horizon`` too, it shrinks to that, and then moves.
    parameters : pytree or callable, optional
        The parameters of the problem, or a function of the time at which the plan begins.
    max_iterations : int, optional
        The budget of each solve in iterations; by default 100.
    milliseconds : float, optional
        The budget of each solve in time: no iteration begins that would exceed it if it took as long as the longest
        one so far. The end of the iteration in progress and the record of the solution come in addition.
    soft : mapping of str to float, optional
        The weights of soft constraints by their names, as in ``soften``.
    hold : float, optional
        The time for which the plant holds each control (zero-order hold). The control is that of the plan in the middle
        of this time. By default the control is that at its beginning, and ``signal`` follows the plan.
    delay : float
        The time from a measurement until its control acts.
    idle : control, optional
        The control that acts before the first one, with a delay; by default the nearest to zero within the bounds.
    tolerance : float, optional
        The tolerance of the solves, as in ``Solver.solve``.
    acceptable : float
        The largest relative defect and violation of an iterate that the controller applies after a solve without
        success.

    Raises
    ------
    InvalidInputError
        For other arguments.

    Notes
    -----
    The guess of a solve is the solution before, shifted by the time that has passed: its interpolation on the manifold.
    After the end of that solution, the guess holds its last state, costate and control. A solve that the budget stops
    is continued at the next sample, from its shifted iterate.

    If the budget stops a solve, or if it has no success, its iterate is the plan where it is feasible up to
    ``acceptable``, without being optimal [Scokaert, Mayne, Rawlings 1999; Diehl, Bock, Schloeder 2005]. Otherwise the
    plan before stays. The control is then that of the feedback law along it,
    :math:`u^*(t) + K(t)\,R^{-1}_{q^*(t)}(q)`, and where there is no law, as along an iterate, that of the plan alone.
    ``statistics`` counts these controls, and names the reasons. All controls lie within their bounds.

    With a delay, the solve starts from the state that the problem predicts at the time at which the control will act,
    from the controls that were returned before. Use one controller for one loop.

    A plan of a problem with explicit time has the time of the loop: its ``start_time`` is the time at which it begins.

    Examples
    --------
    >>> line = Euclidean(1)
    >>> moved = OptimalControlProblem(line, lambda q, u: u, lambda q, u: (q @ q + u @ u) / 2, controls=1)
    >>> controller = RecedingHorizon(Solver(moved, Midpoint(Addition(line)), steps=20), None, horizon=4.0)
    >>> float(controller(np.ones(1), 0.0)[0].round(2))
    -0.91
    >>> controller.statistics.sources
    ('solve',)
    """

    @require_known_options
    def __init__(
        self,
        solver: Solver,
        end: Any,
        horizon: float | None = None,
        end_time: float | None = None,
        parameters: Any = None,
        max_iterations: int | None = None,
        milliseconds: float | None = None,
        soft: Any = None,
        hold: float | None = None,
        delay: float = 0.0,
        idle: Any = None,
        tolerance: float | None = 1e-6,
        acceptable: float = 1e-2,
    ) -> None:
        _require_solver(solver)
        _require_horizon(horizon, end_time)
        _require_samples(solver.problem.sampling, end_time, hold)
        _require_numbers(horizon, max_iterations, milliseconds, hold, delay, acceptable)
        self.problem, self.horizon, self.end_time = solver.problem, horizon, end_time
        self.solver = solver
        if soft:
            softened = soften(self.problem, soft)
            self.solver = Solver(softened, solver.method, solver.fractions, solver._evaluator)
        self._end, self._parameters, self._tolerance, self.acceptable = end, parameters, tolerance, acceptable
        self._budget, self.hold, self.delay = (max_iterations, milliseconds), hold, float(delay)
        self._plant, self._idle = Plant(self.problem), idle_control(self.problem, idle, delay)
        self._begin()

    def _begin(self) -> None:
        """Forget all samples."""
        self._sent = SentControls(self._idle)
        self._plan: Plan | None = None  # the last solution or acceptable iterate
        self._iterate: Plan | None = None  # from which the next solve starts
        self._feedback: Feedback | None = None  # along a solution that was the plan when a solve failed
        self._signal: Signal | None = None
        self._samples: list[tuple[float, int, float, Source]] = []
        self._failures: dict[float, str] = {}

    @property
    def plan(self) -> Solution:
        """The last solution or acceptable iterate; raises ``InvalidInputError`` before the first call."""
        return self._last_plan.solution

    @property
    def plan_begin(self) -> float:
        """The time at which the plan begins."""
        return self._last_plan.begin

    @property
    def signal(self) -> Signal:
        """The last control as a function of time, until the next sample: constant, or along the plan without
        ``hold``."""
        if self._signal is None:
            raise InvalidInputError("there is no control before the first call; try controller(q, t)")
        return self._signal

    @property
    def statistics(self) -> ControllerStatistics:
        """The iterations, times and sources of all controls so far."""
        times, iterations, milliseconds, sources = zip(*self._samples, strict=True) if self._samples else [()] * 4
        arrays = np.array(times, float), np.array(iterations, int), np.array(milliseconds, float)
        return ControllerStatistics(*arrays, sources, dict(self._failures))

    def __repr__(self) -> str:
        return f"RecedingHorizon({self.solver!r}, {self.statistics!r})"

    @require_known_options
    def __call__(self, q: Any, t: float, parameters: Any = None, reference: Any = None) -> Any:
        """The control for a state that is measured at a time.

        Parameters
        ----------
        q : point
            The measured state.
        t : float
            The time of the measurement, later than that of the call before.
        parameters : pytree, optional
            The parameters of this solve, instead of the parameters of the controller.
        reference : point, optional
            The end of this plan, instead of the end of the controller.

        Returns
        -------
        control
            The control from ``t + delay`` on, within its bounds.

        Raises
        ------
        InvalidInputError, NotOnManifoldError
            For another state, and for a time that is not later than before, or after ``end_time``.
        ConvergenceError
            If the first solve has no success. It has no budget, as there is nothing to return instead.
        """
        began = time.perf_counter()
        self._require_later(t)
        begin = float(t) + self.delay
        horizon = self._horizon_from(begin)
        own = self._at(self._parameters, begin) if parameters is None else parameters
        end = self._at(self._end, begin + horizon) if reference is None else reference
        for signal, first, last in self._sent.between(float(t), begin):
            q = self._plant.advance(q, signal, first, last, own)
        solution = self._solve(q, end, begin, horizon, own)
        source, self._signal = self._choose(Plan(solution, begin), q)
        if source != "solve":
            self._failures[float(t)] = solution.result
        control = self._signal(begin)
        self._sent.send(begin, self._signal)
        spent = 1000 * (time.perf_counter() - began)
        self._samples.append((float(t), solution.statistics.iterations, spent, source))
        return control

    export_c = require_known_options(export_c)

    def _solve(self, q: Any, end: Any, begin: float, horizon: float, parameters: Any) -> Solution:
        """The solution from a state, or the best iterate within the budget."""
        budget, first, guess = Budget(*self._budget), self._plan is None, None
        limited: Any = {} if first or not budget.is_limited else {"callback": budget}
        most = max(DEFAULT_ITERATIONS, self._budget[0] or 0)
        for last in filter(None, (self._iterate, self._plan)):
            guess = last.guess(begin, horizon) if guess is None else guess
        options: Any = {"guess": guess, "parameters": parameters, "tolerance": self._tolerance, "throw": first}
        options |= {"start_time": begin} if self.problem.time_dependent else {}
        return self.solver.solve(q, end, horizon, **options, **limited, max_iterations=most)

    def _choose(self, found: Plan, q: Any) -> tuple[Source, Signal]:
        """The controls from now on, and their source."""
        self._iterate = found if found.is_usable else None
        if found.solution.success:
            self._plan = found
            return "solve", self._along(found, found.begin)
        if found.infeasibility <= self.acceptable:
            self._plan = found
            return "iterate", self._along(found, found.begin)
        control = self._feedback_control(found.begin, q)
        if control is None:
            return "plan", self._along(self._last_plan, found.begin)
        return "feedback", Signal.constant(control)

    def _feedback_control(self, begin: float, q: Any) -> Any:
        """The control of the feedback law along the plan; None where there is no law."""
        plan = self._last_plan
        try:
            if self._feedback is None or self._feedback.solution is not plan.solution:
                self._feedback = self.solver.feedback(plan.solution)
            now = plan.time_of(begin)
            return self._clip(self._feedback(now, q)) if now <= self._feedback.until else None
        except (InvalidInputError, DomainError):
            return None

    def _along(self, plan: Plan, begin: float) -> Signal:
        """The controls of a plan from a time on, held or followed until the next sample."""
        if self.hold is not None:
            return Signal.constant(self._controls(plan, begin + self.hold / 2))
        breaks = plan.begin + plan.solution.times - plan.solution.times[0]
        return Signal(lambda time: self._controls(plan, time), breaks)

    def _controls(self, plan: Plan, time: Any) -> Any:
        """The controls of a plan at a time, or at an array of times."""
        return self._clip(plan.solution(plan.after(time)).controls)

    def _clip(self, u: Any) -> Any:
        """The controls of the problem, without slacks, inside their bounds."""
        own = u if self.solver.problem is self.problem else u[..., : self.problem.controls.dimension]
        return clip_to_bounds(self.problem, own)

    @property
    def _last_plan(self) -> Plan:
        if self._plan is None:
            raise InvalidInputError("there is no plan before the first call; try controller(q, t)")
        return self._plan

    def _horizon_from(self, begin: float) -> float:
        """The duration of the plan that begins at a time."""
        if self.end_time is None:
            return float(self.horizon)  # pyright: ignore[reportArgumentType]
        left = max(self.end_time - begin, self.horizon or 0.0)
        if not left > 0:
            raise InvalidInputError(
                f"the plan from {begin:.6g} on ends at the end time {self.end_time:.6g}, expected an earlier time; "
                "give horizon=... too, for a horizon that shrinks to it and then moves"
            )
        return left

    def _require_later(self, t: Any) -> None:
        if not is_finite_number(t):
            raise InvalidInputError(f"t must be a finite time, got {t!r}")
        if self._samples and not t > self._samples[-1][0]:
            raise InvalidInputError(
                f"t = {t:.6g} is not later than the sample before, {self._samples[-1][0]:.6g}; make another "
                "RecedingHorizon for another loop"
            )

    def _at(self, given: Any, time: float) -> Any:
        """A value, or the value of a function of time."""
        return given(time) if callable(given) else given


def _require_solver(solver: Any) -> None:
    if not isinstance(solver, Solver):
        raise InvalidInputError(
            f"RecedingHorizon takes a Solver, got {brief(solver)}; try Solver(problem, method, steps)"
        )


def _require_horizon(horizon: Any, end_time: Any) -> None:
    """Raise unless the plans have an end."""
    if horizon is None and end_time is None:
        raise InvalidInputError(
            "a receding horizon needs horizon=..., the duration of its plans, or end_time=..., the time at which they "
            "end; got neither"
        )
    if not (end_time is None or is_finite_number(end_time)):
        raise InvalidInputError(f"end_time must be a finite time, got {end_time!r}")


def _require_samples(sampling: Sampling | None, end_time: Any, hold: Any) -> None:
    """Raise if plans with held controls would have other steps than the samples."""
    if sampling is not None and not (end_time is None and hold in (None, sampling.time)):
        raise InvalidInputError(
            f"each control of the problem is held for {sampling.time:g}, got end_time = {end_time!r} and hold = "
            f"{hold!r}; expected plans of one duration; try horizon=... alone"
        )


def _require_numbers(
    horizon: Any, max_iterations: Any, milliseconds: Any, hold: Any, delay: Any, acceptable: Any
) -> None:
    """Raise unless times are positive or None, and the other numbers at least zero."""
    for name, value in {"horizon": horizon, "milliseconds": milliseconds, "hold": hold}.items():
        if value is not None and not (is_finite_number(value) and value > 0):
            raise InvalidInputError(f"{name} must be a positive finite number, got {value!r}")
    if not (max_iterations is None or is_count(max_iterations)):
        raise InvalidInputError(f"max_iterations must be a whole number of at least 1, got {max_iterations!r}")
    for name, value in {"delay": delay, "acceptable": acceptable}.items():
        if not (is_finite_number(value) and value >= 0):
            raise InvalidInputError(f"{name} must be a finite number of at least zero, got {value!r}")
