"""Success and result of solutions: the only place that writes them.

All other places return facts: an iteration has converged, a horizon vanishes, a control passes a jump.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar, final

import numpy as np

from ...problem.optimal_control_problem import OptimalControlProblem
from ...reporting.result_sentences import Result, reasons, sentence
from ..solution.diagnostics import RegularChecks, Statistics
from ..solution.multiphase_solution import PhasedSolution
from ..solution.record import Solution
from ..transcription.discrete_extremals import DiscreteExtremals
from .failure_reasons import find_long_turn, find_reason, find_undefined

Record = TypeVar("Record", Solution, PhasedSolution)

# Relative: the cost of a trajectory that violates its conditions by more says nothing of a minimum.
NEARLY_SOLVED = 0.1
# Residual, relative: an iteration whose limit came at less was near an extremal.
NEARLY_CONVERGED = 1e-4
TENDS_TO_ZERO = "tends to zero, where all conditions vanish with it"


@final
class Status(NamedTuple):
    """Success and result of a solution.

    Attributes
    ----------
    success : bool
        Whether the first-order conditions hold.
    result : str
        A sentence on the end of the computation.
    """

    success: bool
    result: str

    def because(self, more: str, reason: str) -> "Status":
        """The status with more words, and with a reason for the lack of a minimum."""
        return self._replace(result=reasons(self.result + more, reason))


# ---------------------------------------------------------------------------------------------- of an iteration


def termination_statuses(found: DiscreteExtremals, tolerance: float) -> list[Status]:
    """The status of each finished iteration."""
    largest = found.residuals.largest
    finite = np.isfinite(largest) & np.isfinite(found.cost)
    success = found.converged & finite
    if (success & found.strict_minimum).all():
        return [Status(True, sentence("successful"))] * len(success)
    meets = np.max(np.abs(found.missing), axis=1) <= tolerance
    apart = (found.residuals.stationarity <= tolerance) & meets & (found.residuals.defect > np.sqrt(tolerance))
    residuals = found.residuals
    trespass = np.maximum(residuals.defect, np.maximum(residuals.violation, residuals.excess))
    undetermined = (largest <= tolerance) & (not found.stopped)
    left = np.maximum(largest, residuals.complementarity)
    near = found.limited & (left <= NEARLY_CONVERGED)
    ways = {
        "not_finite": ~finite,
        "stationary": found.converged & ~found.strict_minimum,
        "successful": found.converged,
        "infeasible": found.infeasible,
        "wrong_point": apart,
        "falling": found.falling & (trespass <= NEARLY_SOLVED) & (not found.stopped),
        "singular": (~found.solvable & ~meets) | undetermined,
        "stopped": np.full(len(largest), found.stopped),
        "nearly_converged": near,
        "too_many_iterations": found.limited,
    }
    first = np.select(list(ways.values()), range(len(ways)), len(ways))
    names = [*ways, "no_improvement"]
    reached = [f" Its largest residual is {residual:.1e}, and the tolerance {tolerance:.1e}." for residual in left]
    more = [words if names[k] == "nearly_converged" else "" for k, words in zip(first, reached, strict=True)]
    each = zip(success, first, more, strict=True)
    return [Status(bool(holds), sentence(names[k]) + words) for holds, k, words in each]


def concave_status(where: str) -> Status:
    """The status of an extremal whose cost is concave in a control, with words on the place."""
    return Status(False, f"{sentence('concave')} {where}")


def rounded_end_status() -> Status:
    """The status of an extremal whose controls are rounding, because they hardly move its prescribed end."""
    return Status(False, sentence("rounded_end"))


def shooting_status(result: Result, broken: str, jump: str) -> Status:
    """The status of a singular extremal: of its shooting, of a condition that is broken, and of a jump."""
    if result != Result.successful:
        return Status(False, Result[result])
    if jump:
        return Status(False, f"The conditions hold at the points, but {jump}.")
    return Status(False, f"{Result[Result.claim_broken]} {broken}.") if broken else Status(True, Result[result])


def phases_status(phases: Sequence[Solution]) -> Status:
    """The status of all phases together: the words on all phases alike, then the words on each phase.

    Without success, only the phases that fail are named.
    """
    success = all(phase.success for phase in phases)
    said = {k: phase.result for k, phase in enumerate(phases) if success or not phase.success}
    first, more = zip(*(f"{words} ".partition(". ")[::2] for words in said.values()), strict=True)
    if len(set(first)) > 1 or len(said) < len(phases):
        return Status(success, " ".join(f"Phase {k}: {words}" for k, words in said.items()))
    alike = success and len(set(more)) == 1
    named = more[:1] if alike else [f"Phase {k}: {words}" for k, words in enumerate(more) if words]
    return Status(success, " ".join(f"{first[0]}. {''.join(named)}".split()))


# ------------------------------------------------------------------------------------------- changed by an audit


def fail(record: Record, words: str) -> Record:
    """The record without success, and without the claim of a strict minimum."""
    if isinstance(record, Solution):
        record = withdraw_minimum(record)
    return replace(record, success=False, result=words)


def withdraw_minimum(solution: Solution) -> Solution:
    """The solution without the claim of a strict minimum.

    The inertia of its KKT matrix shows a minimum only where its multipliers exist and are unique.
    """
    checks = solution.checks
    checks = replace(checks, strict_minimum=False) if isinstance(checks, RegularChecks) else checks
    return replace(solution, checks=checks)


def explain(solution: Solution, words: str) -> Solution:
    """The solution with other words on its end; the same object if they are its own."""
    return solution if words == solution.result else replace(solution, result=words)


def explain_failure(problem: OptimalControlProblem, solution: Solution) -> Solution:
    """The solution, with a possible reason in a function if there is no success."""
    if solution.success or solution.statistics.stopped or solution.result.startswith(sentence("concave")):
        return solution
    if solution.result.startswith(sentence("not_finite")):
        return explain(solution, f"{solution.result} {find_undefined(problem, solution)}".strip())
    reason = find_reason(problem, solution)
    if reason:
        return explain(solution, f"The conditions are not met, and this may be why: {reason}.")
    falls = solution.result.startswith(sentence("falling"))  # a trajectory that runs away turns by anything
    turn = "" if falls else find_long_turn(problem, solution)
    return explain(solution, f"{solution.result} At the last iterate {turn}.") if turn else solution


def refute(solution: Solution, reason: str) -> Solution:
    """The solution without success, for a reason that its conditions do not show."""
    how = "hold at the points, but" if solution.success else "are not met, and this may be why:"
    return fail(solution, f"The conditions {how} {reason}.")


# ----------------------------------------------------------------------------------- free horizons and durations


def fail_at_zero(record: Record, name: str, horizon: float) -> Record:
    """The record without success: a horizon of this name tends to zero."""
    return fail(
        record,
        f"{name} {TENDS_TO_ZERO}: at {horizon:.3g} the trajectory costs the same at twice the speed, to the tolerance, "
        "so that no horizon is best, and the infimum of the cost is its limit at zero. Expected a running cost that "
        "grows faster than the velocity, as 1 + u @ u; try such a cost, a lower bound of the horizon, or "
        "control_bounds.",
    )


def fail_with_hamiltonian(solution: Solution, share: float) -> Solution:
    """The solution without success: its Hamiltonian, a share of its largest term, is not zero at a free horizon."""
    return fail(
        solution,
        f"The horizon tends to {solution.horizon:.3g}, or is hidden by other costs: the Hamiltonian, zero at an "
        f"extremal, is {share:.1e} of its largest term there; try another guess of it, a lower or an upper bound, or a "
        "guess of the trajectory.",
    )


def fail_of_durations(solution: PhasedSolution, names: str) -> PhasedSolution:
    """The solution without success: durations of phases of these names vanish or grow without bound."""
    return fail(
        solution,
        f"The duration of {names} tends to zero or grows without bound, where its conditions vanish and say nothing; "
        "try to leave the phase out, another guess of its duration, or a lower or an upper bound.",
    )


def explain_short_horizon(solution: Solution, guess: float) -> Solution:
    """The failed solution with a sentence on its horizon, far shorter than guessed."""
    return explain(
        solution,
        f"{solution.result} The horizon shrank from {guess:.3g} to {solution.horizon:.3g}: the cost may have an "
        f"infimum, near {solution.cost:.6g}, where the horizon tends to zero and all conditions vanish with it; try a "
        "lower bound of the horizon, or a guess near to the best one.",
    )


def explain_long_horizon(solution: Solution, guess: float) -> Solution:
    """The failed solution with a sentence on its horizon, far longer than guessed, in the place of an advice to make it
    longer."""
    happened, _, rest = solution.result.partition("; try ")
    advice, _, more = rest.partition(". ")
    kept = f"{happened}. {more}".strip() if "a longer horizon" in advice else solution.result
    return explain(
        solution,
        f"{kept} The horizon grew from {guess:.3g} to {solution.horizon:.3g}, where a longer one still costs less: "
        "there may be no best one; try an upper bound of it, or a cost of the time.",
    )


def is_final(record: Solution | PhasedSolution) -> bool:
    """Whether no other guess of the horizon is tried: with success, where it was stopped, and where its failure says
    why there is no minimum."""
    final = sentence("concave"), sentence("rounded_end")
    says_why = TENDS_TO_ZERO in record.result or record.result.startswith(final)
    return record.success or record.statistics.stopped or says_why


# ------------------------------------------------------------------------------------------------ refined meshes


def fail_between_switches(solution: Solution) -> Solution:
    """The solution without success: the prescribed arcs are not the arcs of its controls."""
    return fail(solution, "A control leaves a bound elsewhere than its switches are, so its arcs are others.")


def stop_before_estimate(solution: Solution, statistics: Statistics) -> Solution:
    """The solution without success: the error of its steps was not estimated yet."""
    words = "The equations are solved, but the iteration was stopped before the error was estimated."
    return fail(replace(solution, statistics=statistics), words)


def fail_in_accuracy(solution: Solution, accuracy: float, worst: int, why: str) -> Solution:
    """The solution without success: its error exceeds the accuracy, most of it in the worst step."""
    begin, end = solution.times[worst : worst + 2]
    checks: Any = solution.checks
    return fail(
        solution,
        f"The equations are solved, but not to the accuracy of {accuracy:.1e} that was asked for: the error is "
        f"{checks.error:.1e}, most of it in the step from {begin:.6g} to {end:.6g}, because {why}; try a larger "
        "accuracy, or, where a control chatters, a small cost of it.",
    )
