"""Trajectories through waypoints at given times: phases between the waypoints, and one record of all phases."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, get_type_hints

import jax
import numpy as np

from ....manifolds import InvalidInputError
from ....manifolds.numerics.ambient import is_finite_number
from ....manifolds.numerics.tolerances import SAME_TIME
from ...problem.free_quantities import is_free
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem_checks.requirements import HELD, require_treated
from ...reporting.records import Along
from ...reporting.text import brief
from ...stages.explicit_runge_kutta import mesh_times
from ..guess import Guess
from ..inputs.arguments import LIMITS, BoundaryData, Method, step_fractions
from ..solution.diagnostics import RegularChecks
from ..solution.interpolation import Interpolant
from ..solution.multiphase_solution import PhasedSolution
from ..solution.record import Solution
from .phases import Phase

STAGES = "states", "controls", "stage_costates", "multipliers"  # the parts of a guess that stand at the stages


def phases_through(
    problem: OptimalControlProblem, method: Method, steps: Any, given: BoundaryData, through: Any, guess: Any
) -> list[Phase]:
    """The phases between the waypoints, with the parts of a guess; ``through`` has the points by their times."""
    require_treated(problem, "solve with through", *LIMITS, "an initial cost", "an explicit time", HELD)
    free = any(map(is_free, jax.tree.leaves((given.horizon, given.parameters))))
    if free or given.start_time or not is_finite_number(given.horizon):
        raise InvalidInputError(
            f"through fixes times, and horizon is {brief(given.horizon)}, start_time {given.start_time}, parameters "
            f"{brief(given.parameters)}; expected a given horizon, given parameters and start time 0; try solve_phases"
        )
    fractions = step_fractions(steps)
    nodes, _ = mesh_times(float(given.horizon) * fractions, method.nodes)
    places = _places(through, nodes)
    cuts = [0, *places.values(), len(fractions)]
    points, stages = [*(through[t] for t in places), given.end], len(method.nodes)
    own = guess.guess() if isinstance(guess, Solution) else guess
    pieces = {(first, last): _piece(problem, first, last) for first in (True, False) for last in (True, False)}
    return [
        Phase(
            pieces[k == 0, k == len(points) - 1],
            method,
            fractions[a:b],
            nodes[b] - nodes[a],
            given.start if k == 0 else None,
            point,
            None if own is None else _part(own, a, b, stages),
            given.parameters,
        )
        for k, (a, b, point) in enumerate(zip(cuts[:-1], cuts[1:], points, strict=True))
    ]


def _places(through: Any, nodes: np.ndarray) -> dict[Any, int]:
    """The nodes of the waypoints, by their times in order; raises for times at which there is no node."""
    if not isinstance(through, Mapping) or not all(map(is_finite_number, through)):
        raise InvalidInputError(f"through must be a dictionary of points by their times, got {brief(through)}")
    found = dict[Any, int]()
    for t in sorted(through):
        k = int(np.argmin(np.abs(nodes - t)))
        if abs(nodes[k] - t) > SAME_TIME * nodes[-1] or not 0 < k < len(nodes) - 1:
            inside = nodes[1:-1]
            near = inside[np.argsort(np.abs(inside - t))[:2]]
            raise InvalidInputError(
                f"through has a waypoint at {t:.6g}, and the inner nodes that are nearest to it are at "
                f"{', '.join(f'{time:.6g}' for time in sorted(near)) or 'no time'}; expected the time of a node; try "
                "steps=np.diff(times) with the times of all nodes"
            )
        found[t] = k
    if len(set(found.values())) < len(found):
        raise InvalidInputError(f"through has two waypoints at one node, got the times {sorted(through)}")
    return found


def _piece(problem: OptimalControlProblem, first: bool, last: bool) -> OptimalControlProblem:
    """The problem of a phase, which pays the costs of ends that it has."""
    paid = {"initial_cost": first, "terminal_cost": last}
    left = {name: None for name, pays in paid.items() if not pays and getattr(problem, name) is not None}
    return problem._with_arguments(**left) if left else problem


def _part(guess: Guess, a: int, b: int, stages: int) -> Guess:
    """The part of a guess between two nodes."""
    cuts = {name: slice(a * stages, b * stages) if name in STAGES else slice(a, b + 1) for name in guess._fields}
    return Guess(**{name: jax.tree.map(lambda x, n=name: x[cuts[n]], own) for name, own in guess._asdict().items()})


def join_phases(phased: PhasedSolution) -> Solution:
    """One solution of all phases; at a waypoint it has the costates of the next phase."""
    phases, one = phased.phases, phased.phases[0]
    arrays = dict[str, Any]()
    for name, hint in get_type_hints(Solution, include_extras=True).items():
        for along in (mark for mark in getattr(hint, "__metadata__", ()) if isinstance(mark, Along)):
            parts = [getattr(phase, name) for phase in phases]
            if along.axis == "nodes":
                parts = [*(jax.tree.map(lambda rows: rows[:-1], part) for part in parts[:-1]), parts[-1]]
            arrays[name] = jax.tree.map(lambda *rows: np.concatenate(rows), *parts)
    between = one.interpolant
    rest: Any = {
        "cost": phased.cost, "success": phased.success, "result": phased.result, "statistics": phased.statistics,
        "checks": _checks([phase.checks for phase in phases], phased.strict_minimum), "parameters": one.parameters,
        "interpolant": between and Interpolant(between.retraction, between.controls, True),
        "quantities": one.quantities,
    }  # fmt: skip
    return Solution(**arrays, **rest)


def _checks(each: list[Any], strict: bool) -> RegularChecks:
    """The worst figures of all phases; the Hamiltonian is constant in each phase alone."""
    found, of = dict[str, Any](), {"active": sum, "conserved": min}
    for field in fields(RegularChecks):
        values, worst = [getattr(checks, field.name) for checks in each], of.get(field.name, max)
        if isinstance(values[0], dict):
            found[field.name] = {name: worst([value[name] for value in values]) for name in values[0]}
        else:
            found[field.name] = None if values[0] is None else worst(values)
    return RegularChecks(**found | {"strict_minimum": strict, "hamiltonian": each[0].hamiltonian})
