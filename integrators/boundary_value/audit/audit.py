"""Checks of a solution that its conditions do not show: jumps that it passes, controls that nothing determines."""

from collections.abc import Callable
from typing import Any, TypeVar, final

import numpy as np

from ....manifolds import Euclidean
from ....tracing import one_tracing
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.path_constraints import LOWER, UPPER
from ...problem_checks.smoothness.derivative_check import DerivativeCheck
from ...reporting.results import reasons
from ..inputs.arguments import structure_of
from ..inputs.boundary_data import PrescribedEnd
from ..solution.record import Solution
from .constraint_qualification import ConstraintQualification
from .control_curvature import ControlCurvature
from .legendre_condition import longest_arc
from .smoothness_along_solution import SmoothnessAlongSolution
from .status import explain, fail, refute, withdraw_minimum

T = TypeVar("T")

NO_PULL = 1e-7  # of the Hamiltonian: a switching function times the room of its control that is smaller is zero
SHORTEST = 2  # steps: longer ones in which it is zero throughout hold more than a switch


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
            if self._named or self.needed(solution.parameters, free_horizon):
                return self._examined(solution, free_horizon, ends)
        return solution

    def _examined(self, solution: Solution, free_horizon: bool, ends: tuple[PrescribedEnd, PrescribedEnd]) -> Solution:
        """The examined solution of a problem with something to examine."""
        wrong = self._wrong(solution, free_horizon, ends)
        if wrong:
            return refute(solution, wrong)
        outside = self._outside(solution, ends)
        if outside and solution.success:
            return fail(solution, outside)
        unqualified = self._unqualified(solution)
        solution = withdraw_minimum(solution) if unqualified else solution
        undetermined = self.undetermined(solution) if solution.success else ""
        said = " ".join(filter(None, [outside, reasons(solution.result, unqualified, undetermined)]))
        return explain(solution, said)

    def _wrong(self, solution: Solution, free_horizon: bool, ends: tuple[PrescribedEnd, PrescribedEnd]) -> str:
        """Words on a jump, or on a derivative, of which the conditions do not tell."""
        jumps, derivatives = self._examiners(free_horizon, solution.parameters)
        points = solution.stage_states, solution.controls, solution.stage_times
        jump = jumps(solution, _fixed(ends)) if jumps else ""
        return jump or (derivatives(*points, solution.parameters) if derivatives else "")

    def _once(self, kind: Callable[..., T], parameters: Any, *which: Any) -> T:
        """An examiner of this kind for parameters of their structure."""
        key = kind, structure_of(parameters), which
        if key not in self._traced:
            self._traced[key] = kind(self.problem, parameters, *which)
        return self._traced[key]

    def _unqualified(self, solution: Solution) -> str:
        """A sentence on constraints that do not determine their multipliers; bounds alone do."""
        return next(filter(None, (own(solution) for own in self._qualifications(solution))), "")

    def _outside(self, solution: Solution, ends: tuple[PrescribedEnd, PrescribedEnd]) -> str:
        """A sentence on a constraint of the states that an end violates."""
        fixed = _fixed(ends) if self._named else np.zeros(0)
        if not np.any(fixed):
            return ""
        for own in self._qualifications(solution):
            names, excess = own.at_ends(solution, fixed)
            for end, over in zip(("start", "end"), excess, strict=True):
                if np.max(over, initial=0.0) > 0:
                    worst = int(np.argmax(over))
                    why = "it is prescribed" if own.at_nodes else "the constraint holds at the stages alone"
                    expected = "a start" if end == "start" else "an end"
                    return (
                        f"The {end} violates {names[worst]} by {over[worst]:.3g}: {why}, and the trajectory cannot "
                        f"keep it; expected {expected} where it is not positive; try another one, or a wider "
                        "constraint."
                    )
        return ""

    def _qualifications(self, solution: Solution) -> list[ConstraintQualification]:
        """The qualifications of the constraints at the stages and at the nodes, if there are such constraints."""
        limits = self.problem._limits
        kinds = [at_nodes for at_nodes, names in ((False, limits.names), (True, limits.node_names)) if names]
        return [self._once(ConstraintQualification, solution.parameters, at_nodes) for at_nodes in kinds]

    def needed(self, parameters: Any, free_horizon: bool) -> bool:
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

    def undetermined(self, solution: Solution) -> str:
        """A sentence on the controls whose switching functions vanish along an interval; empty if there are none."""
        flat = self._flat(solution)
        if not np.any(flat):
            return ""
        names = [name for quantity in self.problem.quantities.controls for name in quantity.columns]
        stages, found = len(flat) // solution.steps, []
        for entry in np.flatnonzero(np.any(flat, axis=0)):
            begin, end = longest_arc(flat[:, entry])
            if end - begin > SHORTEST * stages:
                first, last = solution.times[[begin // stages, -(-end // stages)]]
                found.append(f"that of {names[entry]} from t = {first:.6g} to {last:.6g}")
        if not found:
            return ""
        meaning = (
            "this is a singular arc, and the discrete problem has a strict minimum here all the same."
            if solution.checks.strict_minimum
            else "the extremal is not shown to be a strict minimum, it may be one of many or only stationary, and "
            "another may "
            "cost less; try a guess in which this control moves, and compare the costs."
        )
        return (
            f"A switching function vanishes, {' and '.join(found)}, where the conditions of first order do not "
            f"determine the control: {meaning}"
        )

    def _flat(self, solution: Solution) -> np.ndarray:
        """At which stages the Hamiltonian, with the constraints, does not depend on an entry of the control, ``(N s,
        m)``."""
        limits, controls = self.problem._limits, self.problem.controls
        count = len(solution.stage_times)
        if not (limits.along and isinstance(controls, Euclidean)):
            return np.zeros((count, 0), bool)
        u, own = np.asarray(solution.controls).reshape(count, -1), solution.stage_multipliers
        room, pull = np.ptp(u, axis=0), np.zeros(u.shape)
        if limits.lower:
            wide = np.array(limits.upper) - np.array(limits.lower)
            room = np.where(np.isfinite(wide), wide, room)
        for name in (LOWER, UPPER):
            pull += own.get(name, 0.0)
        flat = pull * room <= NO_PULL * solution.checks.hamiltonian_size
        flat &= ~solution.held_by(limits.every_name)[:, None]  # one that holds the trajectory may determine controls
        if np.any(flat):
            curvature = self._once(ControlCurvature, solution.parameters)(solution, solution.parameters)
            flat &= curvature == 0  # exactly: no entry of the control is in the derivative
        return flat


def _fixed(ends: tuple[PrescribedEnd, PrescribedEnd]) -> np.ndarray:
    """Whether each coordinate of both ends is prescribed, shape ``(2, n)``."""
    return np.stack([end.coordinates for end in ends]) > 0
