"""Singular arcs of controls with bounds: what the classification of the problem along them says."""

from dataclasses import dataclass
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np

from ....manifolds import Euclidean, InvalidInputError
from ....manifolds.numerics import ambient as vec
from ...problem.optimal_control_problem import OptimalControlProblem
from ...reporting.text import brief
from ...singular import Classification, classify
from ..shooting.legendre_clebsch import generalised_legendre_clebsch
from ..solution.record import Solution
from .switching_structure import stage_sides, switching_structure

MOST_ARC_STAGES = 200  # stages of an arc that are looked at


@final
@dataclass(frozen=True, eq=False)
class ClassifiedArc:
    """A singular arc: between their bounds, some controls are not determined by ``dH/du = 0``.

    Attributes
    ----------
    begin, end : float
        The times of its ends.
    controls : tuple of int
        The entries of the control that are singular; all others stay at a bound or are regular.
    order : int or None
        ``k`` if the 2k-th time derivative of ``dH/du`` is the first with a singular control; None if some controls are
        gauge.
    classification : Classification
        The classification of the problem in the controls that are not at a bound; its ``control(q, p)`` is the
        feedback.
    feedback_error : float
        Largest distance between the controls of the solution and the feedback, as a fraction of the range between their
        bounds; NaN if undefined.
    second_order : str
        The result of the generalised Legendre-Clebsch condition (Kelley's condition for one control).
    """

    begin: float
    end: float
    controls: tuple[int, ...]
    order: int | None
    classification: Classification
    feedback_error: float
    second_order: str

    def __str__(self) -> str:
        """A few lines."""
        named = ", ".join(f"u[{i}]" for i in self.controls)
        order = "with gauge controls" if self.order is None else f"of order {self.order}"
        away = (
            "not defined there"
            if np.isnan(self.feedback_error)
            else f"met to {self.feedback_error:.1e} of the room between the bounds"
        )
        return (
            f"{self.begin:.10g} to {self.end:.10g}: {named} singular, {order}; P_f of dimension "
            f"{self.classification.dimension}\n  feedback {away}\n  {self.second_order}"
        )


def find_singular_arcs(problem: OptimalControlProblem, solution: Solution) -> list[ClassifiedArc]:
    """The singular arcs of a solution with control bounds, each with its classification.

    Parameters
    ----------
    problem : OptimalControlProblem
        The problem, with control bounds and without an explicit time.
    solution : Solution
        A solution; with ``accuracy`` its controls are closest to the feedback.

    Returns
    -------
    list of ClassifiedArc
        The arcs in order of time.

    Raises
    ------
    InvalidInputError
        For another problem or solution.

    Notes
    -----
    Along an arc of ``switching_structure`` the controls at bounds are constant. ``classify`` treats the problem in the
    other controls, near the middle of the arc. Arcs with an active constraint are left out. If the control chatters,
    the classification uses the stages between the bounds, and ``feedback_error`` has the size of the chatter.
    """
    if not isinstance(solution, Solution):
        raise InvalidInputError(f"find_singular_arcs takes a Solution, got {brief(solution)}; try what solve returns")
    problem = problem.with_parameters(solution.parameters) if problem.takes_parameters else problem
    if problem.time_dependent:
        raise InvalidInputError(
            "singular arcs are classified for functions of (q, u), got a problem with time_dependent=True; try the "
            "time as a state, t' = 1"
        )
    structure = switching_structure(problem, solution)
    arcs = list[ClassifiedArc]()
    for k, sides in enumerate(structure.sides):
        begin, end = structure.times[k : k + 2]
        stages = np.flatnonzero((solution.stage_times > begin) & (solution.stage_times < end))
        singular = np.flatnonzero(np.asarray(structure.singular)[k])
        inside = _interior(problem, solution, stages, singular) if len(singular) else stages[:0]
        if len(inside):
            arcs.append(_classify_arc(problem, solution, sides, inside, (float(begin), float(end), singular)))
    return arcs


def _interior(
    problem: OptimalControlProblem, solution: Solution, stages: np.ndarray, singular: np.ndarray
) -> np.ndarray:
    """The stages at which controls lie between their bounds, unless a constraint holds the trajectory at any."""
    inside = np.all(stage_sides(problem, solution)[0][stages][:, singular] == 0, axis=1)
    return stages[inside & ~np.any(solution.held_by(problem._limits.every_name)[stages])]


def _controls(solution: Solution, stages: np.ndarray, entries: np.ndarray) -> np.ndarray:
    """Entries of the control at stages."""
    return np.asarray(solution.controls).reshape(len(solution.stage_times), -1)[stages][:, entries]


def _room(problem: OptimalControlProblem, u: np.ndarray, entries: np.ndarray) -> np.ndarray:
    """Between the bounds of entries of the control; where it is infinite their size."""
    room = np.array(problem._limits.upper)[entries] - np.array(problem._limits.lower)[entries]
    size = np.max(np.abs(u), axis=0, initial=np.finfo(float).tiny)
    return np.where(np.isfinite(room), room, size)


def _without_bounds(problem: OptimalControlProblem, sides: np.ndarray) -> OptimalControlProblem:
    """The problem in the controls that are not at a bound; its ends and their costs play no part along an arc."""
    lower, upper = (np.array(side) for side in (problem._limits.lower, problem._limits.upper))
    held, free = np.where(sides < 0, lower, np.where(sides > 0, upper, 0.0)), np.flatnonzero(sides == 0)
    shape = problem.controls.shape if isinstance(problem.controls, Euclidean) else held.shape

    def control(v: Any) -> Any:
        return jnp.asarray(held, jnp.result_type(v)).at[free].set(v).reshape(shape)

    return OptimalControlProblem(
        problem.manifold,
        lambda q, v: problem.dynamics(q, control(v)),
        lambda q, v: problem.running_cost(q, control(v)),
        len(free),
        abnormal=problem.abnormal,
    )


def _classify_arc(
    problem: OptimalControlProblem,
    solution: Solution,
    sides: np.ndarray,
    stages: np.ndarray,
    arc: tuple[float, float, np.ndarray],
) -> ClassifiedArc:
    """An arc with what its classification says of some of its stages."""
    begin, end, singular = arc
    some = stages[np.unique(np.linspace(0, len(stages) - 1, MOST_ARC_STAGES).round().astype(int))]
    z = vec.taken((solution.stage_states, solution.stage_costates), some)
    without_bounds, free = _without_bounds(problem, sides), np.flatnonzero(sides == 0)
    u = _controls(solution, some, free)
    middle = vec.taken(z, len(some) // 2)
    classification = _nearest(classify(without_bounds, near=middle, exclude_zero_costate=False), middle)
    places = np.searchsorted(free, singular)
    levels = [None if classification.empty else classification.stratum.determined_at[i] for i in places]
    order = None if None in levels else max(int(level or 0) for level in levels) // 2
    error = np.nan
    if not (classification.empty or classification.gauge_controls):
        feedback = np.asarray(jax.jit(jax.vmap(classification.control))(*z))
        error = float(np.max(np.abs(feedback - u)[:, places] / _room(problem, u[:, places], singular)))
    words = generalised_legendre_clebsch(without_bounds, z, jnp.asarray(u), order or 1)
    return ClassifiedArc(begin, end, tuple(map(int, singular)), order, classification, error, words)


def _nearest(found: Classification, z: Any) -> Classification:
    """The classification with the piece of ``P_f`` alone whose equations a state violates least."""
    if len(found.strata) < 2:
        return found
    missed = [float(np.max(np.abs(stratum.equations(z)), initial=0.0)) for stratum in found.strata]
    return found.choose(int(np.argmin(np.nan_to_num(missed, nan=np.inf))))
