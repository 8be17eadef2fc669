"""Checks of a solution that its conditions do not show: jumps that it passes, controls that nothing determines."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any, TypeVar, final

import jax
import numpy as np

from ....manifolds import Euclidean
from ....tracing import one_tracing
from ...problem.free_quantities import is_free
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem_checks.smoothness.derivative_check import DerivativeCheck
from ...reporting.result_sentences import reasons, sentence
from ..inputs.arguments import structure_of
from ..inputs.boundary_data import PrescribedEnd
from ..inputs.inputs import Inputs
from ..solution.diagnostics import RegularChecks
from ..solution.record import Solution
from .constraint_qualification import ConstraintQualification
from .linear_controls import ControlCurvature
from .smoothness_along_solution import SmoothnessAlongSolution
from .status import NEARLY_CONVERGED, explain, fail, refute, withdraw_minimum
from .switching_structure import singular_structure, switching_sizes

T = TypeVar("T")

NO_PULL = 1e-7  # of the Hamiltonian: a switching function times the room of its control that is smaller is zero
UNSOLVED = 10.0  # times the residuals: a smaller switching function may be zero too
SHORTEST = 2  # steps: longer ones in which it is zero throughout hold more than a switch
CHATTER = 1e-2  # of the range of a control: a smaller move from stage to stage is no chattering
MOST_ARCS = 3  # of one control that a sentence names, the longest
SMALL_COST = "a small running cost of this control, such as 1e-3 * u @ u"
MEANINGS = {
    "minimum": "this is a singular arc, and the discrete problem has a strict minimum here all the same. If the "
    f"control chatters, try {SMALL_COST}; find_singular_arcs classifies the arc.",
    "stationary": "the extremal is not shown to be a strict minimum, it may be one of many or only stationary, and "
    f"another may cost less; try a guess in which this control moves, and compare the costs, or {SMALL_COST}; "
    "find_singular_arcs classifies a singular arc.",
    "failure": "on a fine mesh the iteration converges slowly along such a singular arc, and the control may chatter; "
    f"try {SMALL_COST}, tolerance=1e-8, or fewer steps.",
}


@final
class Audit:
    """Examines solutions of one problem; what it traces for that, it traces once for parameters of one structure."""

    def __init__(self, problem: OptimalControlProblem) -> None:
        self.problem = problem
        self._traced: dict[Any, Any] = {}
        self._needed: dict[Any, bool] = {}
        self._limited, self._named = problem._limits.along, bool(problem._limits.every_name)

    def __call__(self, solution: Solution, free_horizon: bool, ends: tuple[PrescribedEnd, PrescribedEnd]) -> Solution:
        """The examined solution, without success if it passes a jump, and the same object if there is nothing to add.

        The solution is no strict minimum where constraints that hold it do not determine their multipliers.

        With a free horizon a jump in an explicit time counts too, because the horizon shifts it. There is no success
        either where what is prescribed of the ends violates a constraint of the states, of which the conditions at the
        stages know nothing.
        """
        if solution.singular is not None or (solution.statistics.stopped and not solution.success):
            return solution
        with one_tracing(), np.errstate(all="ignore"):
            if self._named or self.applies(solution.parameters, free_horizon):
                return self._examine(solution, free_horizon, ends)
        return solution

    def _examine(self, solution: Solution, free_horizon: bool, ends: tuple[PrescribedEnd, PrescribedEnd]) -> Solution:
        """The examined solution of a problem with something to examine."""
        wrong = self._wrong(solution, free_horizon, ends)
        if wrong:
            return refute(solution, wrong)
        outside = self._outside(solution, ends)
        if outside and solution.success:
            return fail(solution, outside)
        unqualified = self._describe_dependent_constraints(solution)
        solution = withdraw_minimum(solution) if unqualified else solution
        checks = solution.checks
        violation = checks.violation if isinstance(checks, RegularChecks) else 0.0
        near = solution.success or max(checks.defect, checks.stationarity, violation) <= NEARLY_CONVERGED
        undetermined = self.describe_undetermined_controls(solution) if near and not outside else ""
        result = _with_end(solution.result, outside)
        return explain(solution, reasons(result, unqualified, undetermined))

    def _wrong(self, solution: Solution, free_horizon: bool, ends: tuple[PrescribedEnd, PrescribedEnd]) -> str:
        """Words on a jump, or on a derivative, of which the conditions do not tell."""
        jumps, derivatives = self._examiners(free_horizon, solution.parameters)
        points = solution.stage_states, solution.controls, solution.stage_times
        jump = jumps(solution, _prescription_mask(ends)) if jumps else ""
        return jump or (derivatives(*points, solution.parameters) if derivatives else "")

    def _once(self, kind: Callable[..., T], parameters: Any, *which: Any) -> T:
        """An examiner of this kind for parameters of their structure."""
        key = kind, structure_of(parameters), which
        if key not in self._traced:
            self._traced[key] = kind(self.problem, parameters, *which)
        return self._traced[key]

    def _describe_dependent_constraints(self, solution: Solution) -> str:
        """A sentence on constraints that do not determine their multipliers; bounds alone do."""
        found = (qualification(solution) for qualification in self._qualifications(solution.parameters))
        return next(filter(None, found), "")

    def _outside(self, solution: Solution, ends: tuple[PrescribedEnd, PrescribedEnd]) -> str:
        """A sentence on a constraint of the states that an end violates."""
        fixed = _prescription_mask(ends) if self._named else np.zeros(0)
        if not np.any(fixed):
            return ""
        for qualification in self._qualifications(solution.parameters):
            names, excess = qualification.at_ends(solution, fixed)
            for end, over in zip(("start", "end"), excess, strict=True):
                if np.max(over, initial=0.0) > 0:
                    worst = int(np.argmax(over))
                    return _outside_words(end, names[worst], float(over[worst]), qualification.at_nodes)
        return ""

    def without_vain_restarts(self, inputs: Inputs) -> Inputs:
        """The inputs, without restarts if a prescribed end violates a constraint; found out after a failed search."""
        if not self._named:
            return inputs
        restarts = cache(lambda: not self.ends_are_outside(inputs))
        return replace(inputs, options=inputs.options._replace(restarts=restarts))

    def ends_are_outside(self, inputs: Inputs) -> bool:
        """Whether a prescribed end violates a constraint of the states, which no search can change."""
        given, fixed = inputs.given, _prescription_mask(inputs.ends.prescribed)
        moving = (given.parameters, given.horizon) if self.problem.time_dependent else given.parameters
        if not np.any(fixed) or any(map(is_free, jax.tree.leaves(moving))):
            return False
        with one_tracing(), np.errstate(all="ignore"):
            return any(own.is_violated(inputs, fixed) for own in self._qualifications(inputs.known.parameters))

    def _qualifications(self, parameters: Any) -> list[ConstraintQualification]:
        """The qualifications of the constraints at the stages and at the nodes, if there are such constraints."""
        limits = self.problem._limits
        kinds = [at_nodes for at_nodes, names in ((False, limits.names), (True, limits.node_names)) if names]
        return [self._once(ConstraintQualification, parameters, at_nodes) for at_nodes in kinds]

    def applies(self, parameters: Any, free_horizon: bool) -> bool:
        """Whether there may be something to say of a solution with parameters of this structure."""
        key = structure_of(parameters), free_horizon
        if key not in self._needed:
            self._needed[key] = self._limited or any(self._examiners(free_horizon, parameters))
        return self._needed[key]

    def is_silent(self, structure: Any, free_horizon: bool) -> bool:
        """Whether an earlier audit showed that a solution with parameters of this structure needs none."""
        return not self._named and self._needed.get((structure, free_horizon)) is False

    def _examiners(self, free_horizon: bool, parameters: Any) -> tuple[SmoothnessAlongSolution, DerivativeCheck]:
        """The searches for jumps, and for derivatives that tell nothing of their functions; true where there may be
        some."""
        timed = free_horizon and self.problem.time_dependent
        return self._once(SmoothnessAlongSolution, parameters, timed), self._once(DerivativeCheck, parameters)

    def describe_undetermined_controls(self, solution: Solution) -> str:
        """Sentences on the controls whose switching functions vanish along an interval; empty if there are none."""
        flat, chattering = self._flat(solution)
        found, at_limits = self._intervals(solution, flat), self._intervals(solution, chattering)
        kind = "failure" if not solution.success else "minimum" if solution.checks.strict_minimum else "stationary"
        arcs, limited = " and that of ".join(found), " and ".join(at_limits)
        words = {
            f"A switching function vanishes, that of {arcs}, where the conditions of first order do not determine the "
            f"control: {MEANINGS[kind]}": found,
            f"A control chatters, {limited}, where a constraint holds the trajectory: the control costs nothing, and "
            f"only its mean is determined there; try {SMALL_COST}.": at_limits,
        }
        return " ".join(sentence for sentence, places in words.items() if places)

    def finds_chatter(self, solution: Solution) -> bool:
        """Whether a control chatters along an interval where a constraint holds the trajectory."""
        with one_tracing(), np.errstate(all="ignore"):
            return bool(self._intervals(solution, self._flat(solution)[1]))

    def _intervals(self, solution: Solution, marked: np.ndarray) -> list[str]:
        """The entries of the control that are marked along more than a switch, with the times.

        ``marked``: the stages of each entry, shape ``(N s, m)``.
        """
        names = [name for quantity in self.problem.quantities.controls for name in quantity.columns]
        stages, found = len(marked) // solution.steps, []
        for entry in np.flatnonzero(np.any(marked, axis=0)):
            for begin, end in _longest(marked[:, entry], MOST_ARCS):
                if end - begin > SHORTEST * stages:
                    first, last = solution.times[[begin // stages, -(-end // stages)]]
                    found.append(f"{names[entry]} from t = {first:.6g} to {last:.6g}")
        return found

    def _flat(self, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
        """The stages with a Hamiltonian that is independent of an entry of the control, and the stages with chattering.

        Both have the shape ``(N s, m)``. Chattering counts where a constraint holds the trajectory. Along a singular
        arc on which the control chatters, the first also has the stages at which the control is at a bound.
        """
        limits, controls = self.problem._limits, self.problem.controls
        if not (limits.along and isinstance(controls, Euclidean)):
            none = np.zeros((len(solution.stage_times), 0), bool)
            return none, none
        checks: Any = solution.checks
        least = max(NO_PULL, UNSOLVED * max(checks.stationarity, checks.complementarity))
        flat = switching_sizes(self.problem, solution) <= least * checks.hamiltonian_size
        if not np.any(flat):
            return flat, flat
        curvature = self._once(ControlCurvature, solution.parameters)(solution, solution.parameters)
        linear = curvature == 0  # exactly: no entry of the control is in the derivative
        held = solution.held_by(limits.every_name)[:, None]  # a constraint there may determine controls
        flat, chattering = flat & linear & ~held, flat & linear & held & _chatters(solution.controls)
        if not (np.any(flat) and any(limits.bounded.values())):
            return flat, chattering
        structure = singular_structure(self.problem, solution, linear)
        arcs = np.searchsorted(structure.times[1:-1], solution.stage_times)
        return flat | np.asarray(structure.singular)[arcs], chattering


def _chatters(controls: np.ndarray) -> np.ndarray:
    """At which stages an entry of the control goes back and forth, ``(N s, m)``."""
    rows = controls.reshape(len(controls), -1)
    moves = np.diff(rows, axis=0)
    large = np.abs(moves) > CHATTER * np.ptp(rows, axis=0)
    back = large[1:] & large[:-1] & (moves[1:] * moves[:-1] < 0)
    return np.concatenate([back[:1], back, back[-1:]]) if len(back) else np.zeros(rows.shape, bool)


def _outside_words(end: str, limit: str, over: float, at_nodes: bool) -> str:
    """A sentence on a prescribed end that violates a constraint by so much, and on a soft constraint instead."""
    weights = f"{{{limit.partition('[')[0]!r}: weight}}"
    soft = f", or a soft constraint: soften(problem, {weights}), RecedingHorizon(..., soft={weights}) in a closed loop"
    return (
        f"The {end} violates {limit} by {over:.3g}: it is prescribed, and no trajectory through it satisfies the "
        f"constraint. Expected {'a start' if end == 'start' else 'an end'} at which {limit} is not positive; try "
        f"another {end}, a wider constraint{'' if at_nodes else soft}."
    )


def _longest(flat: np.ndarray, count: int) -> list[tuple[int, int]]:
    """Begin and end of the longest runs of true entries, in their order."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flat.astype(int), [0]])))
    runs = list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
    return sorted(sorted(runs, key=lambda run: run[0] - run[1])[:count])


def _with_end(result: str, outside: str) -> str:
    """The result of a failed search with a sentence on an end outside a constraint.

    The end is why the search failed, but there may be more inequalities that contradict each other.
    """
    kept = result if not outside or result.startswith(sentence("infeasible")) else ""
    return f"{outside} {kept}".strip()


def _prescription_mask(ends: tuple[PrescribedEnd, PrescribedEnd]) -> np.ndarray:
    """Whether each coordinate of both ends is prescribed, shape ``(2, n)``."""
    return np.stack([end.coordinates for end in ends]) > 0
