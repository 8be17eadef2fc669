"""The records of what an iteration found."""

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, final

import jax
import numpy as np

from ...manifolds import NotOnManifoldError
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.precision import default_tolerance
from ..problem.optimal_control_problem import OptimalControlProblem
from ..problem.point_layout import PointLayout
from ..problem_checks.requirements import leaving_words
from ..reporting.result_sentences import sentence
from ..stages.explicit_runge_kutta import mesh_times
from .audit.concave_controls import ConcaveDirection, concave_words, find_concave_directions
from .audit.status import Status, concave_status, rounded_end_status, termination_statuses
from .audit.unmoved_entries import rounding_of_controls, unmoved_words
from .inputs.inputs import Inputs
from .solution.diagnostics import RegularChecks, Statistics, figures
from .solution.interpolation import Interpolant
from .solution.record import Solution
from .transcription.diagnosis import Diagnostics
from .transcription.discrete_extremals import DiscreteExtremals
from .transcription.transcribed_problem import TranscribedProblem

# Results that equations of the end which depend on each other may cause.
STUCK = "singular", "too_many_iterations", "nearly_converged", "no_improvement", "infeasible"  # names of results
STUCK_RESULTS = tuple(map(sentence, STUCK))
SMALL = 1e-3  # of the largest violation: smaller ones are not named
VIOLATED = 1e-6  # in units of the inequalities: a violation of less is not why there is no success


@final
class SolutionBuilder:
    """The common parts of the records of all extremals of a problem; ``stages`` are fractions of a step."""

    def __init__(self, problem: OptimalControlProblem, stages: np.ndarray, interpolant: Interpolant) -> None:
        self.problem, self.stages, self.interpolant = problem, stages, interpolant
        self.quantities = problem.quantities
        self.formulation: Any = None  # the reformulation that made the problem; users know the names before
        self.state, self.control = PointLayout.of(problem.manifold), PointLayout.of(problem.controls)

    @property
    def posed(self) -> OptimalControlProblem:
        """The problem as its user posed it."""
        return self.problem if self.formulation is None else self.formulation.own


@final
class ExtremalRecords:
    """The records of the extremals of a batch; the arrays of a member, and its figures, are made when it is read.

    ``seconds``: to trace and to run.
    """

    def __init__(
        self, builder: SolutionBuilder, transcribed: TranscribedProblem, inputs: Inputs, found: DiscreteExtremals
    ) -> None:
        self._of, self.transcribed, self.found = builder, transcribed, found
        self._parameters, self.seconds = inputs.parameters(), (0.0, 0.0)
        data, diagnosis = transcribed.conditions.data, transcribed.traced.diagnosis
        self._at_nodes = diagnosis.at_nodes(found.nodes, found.costates)
        self._stages = found.at_stages(self._at_nodes.costates)
        self._along = diagnosis.along(self._stages, data.parameters)
        self._times, self._stage_times = mesh_times(data.steps, builder.stages)
        self._require_tangent_dynamics(inputs)
        self._held = None if found.inequalities is None else found.inequalities.active
        self._statuses = self._statuses_of(inputs.options.tolerance)
        self._active = _active(transcribed, self._held)
        self._multipliers = _multipliers(transcribed, found)
        # A record holds this until its figures are read, and nothing else of the search.
        held = None if self._held is None else np.any(self._held, axis=(1, 2, 3))
        find: Any = partial(diagnosis.of, self._at_nodes, self._along, self._stages, data.parameters, held)
        posed = builder.posed
        if posed.node_cost is not None or posed.sampling is not None:
            find = partial(_between_nodes, find)
        self._later = _LaterDiagnostics(find)

    def _require_tangent_dynamics(self, inputs: Inputs) -> None:
        """Raise if the dynamics leaves the tangent spaces along a trajectory; at the first point it was checked
        before."""
        normal = self._along.normal
        if not np.fmax.reduce(normal, axis=None) > default_tolerance():
            return
        worst: Any = np.unravel_index(np.nanargmax(normal), normal.shape)
        states, controls, _ = self._stages
        q, u = self._of.state.points(states[worst]), self._of.control.points(controls[worst])
        where = leaving_words(inputs.problem_of(int(worst[0])), q, u, self._of.posed)
        raise NotOnManifoldError(
            f"dynamics leaves the tangent space of {where} along the trajectory: its relative normal part reaches "
            f"{normal[worst]:.3g}, expected 0; return a tangent vector, for rotations R @ hat(w), not hat(w)"
        )

    def member(self, k: int) -> Solution:
        """The record of a member."""
        status, residuals = self._statuses[k], self.found.residuals
        checks = RegularChecks.later(
            partial(_figures, self._later, k),
            defect=residuals.defect[k].item(),
            stationarity=residuals.stationarity[k].item(),
            strict_minimum=bool(self.found.strict_minimum[k] and status.success),
            violation=np.maximum(residuals.violation[k], residuals.excess[k]).item(),
            complementarity=residuals.complementarity[k].item(),
            active=self._active[k],
            between={},
        )
        return Solution(
            **self._arrays(k),
            **status._asdict(),
            cost=self.found.cost[k].item(),
            checks=checks,
            statistics=self._statistics(k),
            parameters=jax.tree.map(lambda leaf: np.array(leaf[k]), self._parameters),
            interpolant=self._of.interpolant,
            quantities=self._of.quantities,
        )

    @cached_property
    def fields(self) -> dict[str, Any]:
        """The fields of all members together, as far as they are arrays or known before the records are made."""
        return {
            **self._arrays(...),
            "cost": self.found.cost,
            "success": np.array([status.success for status in self._statuses]),
            "result": [status.result for status in self._statuses],
            "statistics": [self._statistics(k) for k in range(len(self._statuses))],
            "parameters": self._parameters,
        }

    def _statuses_of(self, tolerance: float) -> list[Status]:
        """The status of each member, with reasons."""
        transcribed, found = self.transcribed, self.found
        statuses, notes = termination_statuses(found, tolerance), found.notes or [""] * len(found.cost)
        success = np.array([status.success for status in statuses])
        concave = find_concave_directions(transcribed, found, self._stages, self._held, success)
        for k, status in enumerate(statuses):
            if k in concave:
                statuses[k] = concave_status(self._where(concave[k], k))
            elif status.success and not found.strict_minimum[k] and self._is_rounding(k, tolerance):
                statuses[k] = rounded_end_status()
            elif notes[k] or not status.success:
                more = self._dependent_entries(k) if status.result.startswith(STUCK_RESULTS) else ""
                statuses[k] = status.because(more + _violation_words(transcribed, found, k, tolerance), notes[k])
        return statuses

    def _dependent_entries(self, k: int) -> str:
        """Words on a part of the end that follows from the rest, by the names of the user."""
        names = [name for quantity in self._of.posed.quantities.states for name in quantity.columns]
        return unmoved_words(self.found.system(k), names)

    def _is_rounding(self, k: int, tolerance: float) -> bool:
        """Whether rounding decides which controls of a member lead to its prescribed end."""
        error = rounding_of_controls(self.found.system(k), self._stages[1][k])
        return error > max(tolerance, default_tolerance())

    def _where(self, one: ConcaveDirection, k: int) -> str:
        """Where the cost of a member is concave, by the names and in the time that its user knows."""
        quantities, times, formulation = self._of.posed.quantities, self._stage_times[k], self._of.formulation
        if formulation is not None:
            times = times * float(formulation.rate(self._of.state.points(self.found.nodes[k, 0])))
        names = [name for quantity in quantities.controls for name in quantity.columns]
        return concave_words(self._of.problem, one, names, self._stages[1][k], times)

    def _statistics(self, k: int) -> Statistics:
        """The effort of a member: its share of the seconds to prepare the batch, and to run it by its iterations."""
        iterations, (preparing, running) = self.found.iterations, self.seconds
        share = (iterations[k] + 1) / (np.sum(iterations) + len(iterations))  # the guess is evaluated too
        return Statistics(int(iterations[k]), preparing / len(iterations), running * float(share), self.found.stopped)

    def _arrays(self, k: Any) -> dict[str, Any]:
        """The arrays of a member, or, for ``...``, of all."""
        state, nodes, (stages, controls, covectors) = self._of.state, self._at_nodes, self._stages
        named = {
            "momenta": nodes.momenta, "body_costates": nodes.body, "spatial_costates": nodes.spatial,
            **self._multipliers,
        }  # fmt: skip
        return {
            "times": self._times[k],
            "states": state.points(self.found.nodes[k]),
            "costates": state.points(nodes.costates[k]),
            "stage_times": self._stage_times[k],
            "stage_states": state.points(stages[k]),
            "stage_costates": state.points(covectors[k]),
            "controls": self._of.control.points(controls[k]),
            "hamiltonians": self._along.hamiltonians[k],
        } | {field: {name: rows[k] for name, rows in arrays_by_name.items()} for field, arrays_by_name in named.items()}


@final
class _LaterDiagnostics:
    """The diagnostics of all members, found when they are first read."""

    def __init__(self, find: Callable[[], Diagnostics]) -> None:
        self._find = find

    @cached_property
    def found(self) -> Diagnostics:
        with np.errstate(all="ignore"):
            return self._find()


def _figures(later: _LaterDiagnostics, k: int) -> dict[str, Any]:
    """The figures of a member that are computed when one is read."""
    return figures(vec.taken(later.found, k))


def _between_nodes(find: Callable[[], Diagnostics]) -> Diagnostics:
    """The diagnostics of a problem whose costates jump at node costs, or whose time is discrete.

    The Hamiltonian is constant in each step alone, and no momentum is conserved.
    """
    diagnostics = find()
    size, nodes = diagnostics.hamiltonians.shape, next(iter(diagnostics.momenta.values())).shape[1]
    steps = diagnostics.hamiltonians.reshape(size[0], nodes - 1, -1)
    return diagnostics._replace(
        hamiltonians=(steps - steps[:, :, :1] + steps[:, :1, :1]).reshape(size),
        brackets={name: rates + np.inf for name, rates in diagnostics.brackets.items()},
    )


def _active(transcribed: TranscribedProblem, held: np.ndarray | None) -> list[dict[str, int]]:
    """At how many stages, or nodes, inequalities of each name hold each trajectory."""
    rows = transcribed.traced.rows
    if held is None:
        return [{} for _ in transcribed.conditions.data.steps]
    named = {**rows.at_stages(held), **rows.at_nodes(held)}
    return [{name: int(np.sum(np.any(sides[k], axis=1))) for name, sides in named.items()} for k in range(len(held))]


def _multipliers(transcribed: TranscribedProblem, found: DiscreteExtremals) -> dict[str, dict[str, np.ndarray]]:
    """Multipliers by their names: of the inequalities at the stages and of what ends are bound by, and of the
    inequalities at the nodes."""
    limits, rows, ends = found.inequalities, transcribed.traced.rows, found.boundary or {}
    if limits is None:
        return {"multipliers": ends, "node_multipliers": {}}
    jumps = transcribed.conditions.data.steps[:, :, None, None] * limits.multipliers
    return {
        "multipliers": {**rows.at_stages(limits.multipliers), **ends},
        "node_multipliers": rows.at_nodes(jumps),
    }


def _violation_words(transcribed: TranscribedProblem, found: DiscreteExtremals, k: int, tolerance: float) -> str:
    """By how much a member without success violates which inequalities, if it does."""
    limits, rows = found.inequalities, transcribed.traced.rows
    if limits is None or found.converged[k]:
        return ""
    member = slice(k, k + 1)
    excess = np.where(limits.weights[member] > 0, np.maximum(limits.values[member], 0.0), 0.0)
    if not np.max(excess / limits.sizes[member], initial=0.0) > (tolerance if found.infeasible[k] else VIOLATED):
        return ""
    named = {**rows.at_stages(excess), **rows.at_nodes(excess)}
    worst = {name: np.max(excesses) for name, excesses in named.items() if excesses.size}
    named = [f"{name} by up to {most:.3g}" for name, most in worst.items() if most > SMALL * np.max(excess)]
    return f" {'It' if found.infeasible[k] else 'Where this ended, it'} violates {', '.join(named)}." if named else ""
