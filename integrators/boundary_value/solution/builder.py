"""The records of what an iteration found."""

from collections.abc import Callable
from typing import Any, final

import jax
import numpy as np

from ....manifolds.numerics import ambient as vec
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.path_constraints import LOWER, UPPER
from ...problem.point_layout import PointLayout
from ...reporting.results import sentence
from ..audit.legendre_condition import ConcaveDirection, concave_words, find_concave_directions
from ..audit.status import Status, concave_status, termination_statuses
from ..audit.unmoved_entries import unmoved_words
from ..inputs.arguments import Options, require_tangent_dynamics
from ..transcription.diagnosis import Diagnostics
from ..transcription.discrete_extremals import DiscreteExtremals
from ..transcription.functions.steps import AtStages
from ..transcription.transcribed_problem import TranscribedProblem
from .diagnostics import RegularChecks
from .interpolation import Interpolant
from .record import Solution, Statistics

# As where equations of the end depend on each other.
STUCK_RESULTS = [sentence(name) for name in ("singular", "too_many_iterations", "no_improvement", "infeasible")]
SMALL = 1e-3  # of the largest violation: smaller ones are not named
VIOLATED = 1e-6  # in units of the inequalities: a violation of less is not why there is no success


@final
class SolutionBuilder:
    """Makes the records of extremals of a problem, with the stages of a step at some places, fractions of it."""

    def __init__(self, problem: OptimalControlProblem, stages: np.ndarray, interpolant: Interpolant) -> None:
        self.problem, self.stages, self.interpolant = problem, stages, interpolant
        self.quantities, self._constrained = problem.quantities, problem._limits.of_points_along
        self.formulation: Any = None  # that the problem is of another one, whose names and times users know
        self.state, self.control = PointLayout.of(problem.manifold), PointLayout.of(problem.controls)

    def of(
        self,
        transcribed: TranscribedProblem,
        parameters: Any,
        found: DiscreteExtremals,
        options: Options,
        seconds: tuple[float, float],
    ) -> tuple[dict[str, Any], Callable[[int], Solution]]:
        """The fields of the records of a batch, and what makes the record of a member.

        ``parameters``: with the members along the leading axis; ``seconds`` to trace and to run.
        """
        nodes, data, traced = found.nodes, transcribed.conditions.data, transcribed.traced
        at_nodes = traced.diagnosis.at_nodes(nodes, found.costates)
        costates = at_nodes.costates
        stages = found.at_stages(costates)
        diagnostics = traced.diagnosis(at_nodes, stages, data.parameters)
        require_tangent_dynamics(self.problem, float(np.fmax.reduce(diagnostics.normal)))
        trajectories = self._trajectories(nodes, costates, stages, data.steps)
        held = None if found.inequalities is None else found.inequalities.active
        statuses = self._statuses(transcribed, found, stages, held, trajectories, options.tolerance)
        success, results = np.array([own.success for own in statuses]), [own.result for own in statuses]
        statistics = [Statistics(int(count), *seconds, found.stopped) for count in found.iterations]
        fields = {
            **trajectories,
            "hamiltonians": diagnostics.hamiltonians,
            "momenta": diagnostics.momenta,
            "body_costates": diagnostics.body,
            "spatial_costates": diagnostics.spatial,
            **_multipliers(transcribed, found),
        }
        active = _active(transcribed, held)
        if self._constrained:
            diagnostics = _without_symmetries(diagnostics, active)
        known = {**_known_checks(found, success), "active": active}

        def member(k: int) -> Solution:
            own, arrays = vec.taken((diagnostics, fields), k)
            return Solution(
                **arrays,
                **statuses[k]._asdict(),
                cost=found.cost[k].item(),
                checks=RegularChecks.of(own, **{name: values[k] for name, values in known.items()}),
                statistics=statistics[k],
                quantities=self.quantities,
                interpolant=self.interpolant,
                parameters=None if parameters is None else jax.tree.map(lambda leaf: np.array(leaf[k]), parameters),
            )

        numbers = {"cost": found.cost, "success": success, "result": results}
        return {**fields, **numbers, "parameters": parameters, "statistics": statistics}, member

    def _statuses(
        self,
        transcribed: TranscribedProblem,
        found: DiscreteExtremals,
        stages: AtStages,
        held: np.ndarray | None,
        trajectories: dict[str, Any],
        tolerance: float,
    ) -> list[Status]:
        """The status of each member, with reasons."""
        statuses = termination_statuses(found, tolerance)
        concave = find_concave_directions(transcribed, found, stages, held, np.array([own.success for own in statuses]))
        for k, own in enumerate(statuses):
            if k in concave:
                statuses[k] = concave_status(self._where(concave[k], k, trajectories, stages))
                continue
            more = self._unmoved(transcribed, found, k) if own.result in STUCK_RESULTS else ""
            more += _violation_words(transcribed, found, k, tolerance)
            statuses[k] = own.because(more, found.notes[k] if found.notes else "")
        return statuses

    def _unmoved(self, transcribed: TranscribedProblem, found: DiscreteExtremals, k: int) -> str:
        """Words on a part of the end that follows from the rest, by the names of the user."""
        own = self.quantities if self.formulation is None else self.formulation.own.quantities
        names = [name for quantity in own.states for name in quantity.columns]
        return unmoved_words(found.system(k), names)

    def _where(self, one: ConcaveDirection, k: int, fields: dict[str, Any], stages: AtStages) -> str:
        """Where the cost of a member is concave, by the names and in the time that its user knows."""
        own, times = self.quantities, fields["stage_times"][k]
        if self.formulation is not None:
            own = self.formulation.own.quantities
            times = times * float(self.formulation.rate(vec.taken(fields["states"], (k, 0))))
        names = [name for quantity in own.controls for name in quantity.columns]
        return concave_words(self.problem, one, names, stages[1][k], times)

    def _trajectories(
        self, nodes: np.ndarray, costates: np.ndarray, stages: AtStages, steps: np.ndarray
    ) -> dict[str, Any]:
        """Times, states, costates and controls of a batch, with a common array for the values at the stages."""
        times = np.zeros((len(nodes), nodes.shape[1]))
        steps.cumsum(axis=1, out=times[:, 1:])
        between = times[:, :-1, None] + steps[:, :, None] * self.stages
        return {
            "times": times,
            "states": self.state.points(nodes),
            "costates": self.state.points(costates),
            "stage_times": between.reshape(len(nodes), -1),
            "stage_states": self.state.points(stages[0]),
            "stage_costates": self.state.points(stages[2]),
            "controls": self.control.points(stages[1]),
        }


def _without_symmetries(diagnostics: Diagnostics, active: list[dict[str, int]]) -> Diagnostics:
    """The diagnostics, with momenta that may change where constraints hold a trajectory: they may break symmetries."""
    held = [any(count for name, count in own.items() if name not in (LOWER, UPPER)) for own in active]
    free = np.where(held, np.inf, 0.0)[:, None]
    return diagnostics._replace(brackets={name: rates + free for name, rates in diagnostics.brackets.items()})


def _known_checks(found: DiscreteExtremals, success: np.ndarray) -> dict[str, list[Any]]:
    """The checks of each member that the iteration computes."""
    residuals = found.residuals
    values = {
        "defect": residuals.defect,
        "stationarity": residuals.stationarity,
        "strict_minimum": found.strict_minimum & success,
        "violation": np.maximum(residuals.violation, residuals.excess),
        "complementarity": residuals.complementarity,
    }
    return {name: array.tolist() for name, array in values.items()}


def _active(transcribed: TranscribedProblem, held: np.ndarray | None) -> list[dict[str, int]]:
    """At how many stages, or nodes, inequalities of each name hold each trajectory."""
    rows = transcribed.traced.rows
    if held is None:
        return [{} for _ in transcribed.conditions.data.steps]
    named = {**rows.at_stages(held), **rows.at_nodes(held)}
    return [{name: int(np.sum(np.any(own[k], axis=1))) for name, own in named.items()} for k in range(len(held))]


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
    if limits is None or found.claimed[k]:
        return ""
    own = slice(k, k + 1)
    excess = np.where(limits.weights[own] > 0, np.maximum(limits.values[own], 0.0), 0.0)
    if not np.max(excess / limits.sizes[own], initial=0.0) > (tolerance if found.infeasible[k] else VIOLATED):
        return ""
    worst = {name: np.max(own) for name, own in {**rows.at_stages(excess), **rows.at_nodes(excess)}.items() if own.size}
    named = [f"{name} by up to {most:.3g}" for name, most in worst.items() if most > SMALL * np.max(excess)]
    return f" {'It' if found.infeasible[k] else 'Where this ended, it'} violates {', '.join(named)}." if named else ""
