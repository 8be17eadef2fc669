"""Where the cost is concave in the controls along an extremal: there, by Legendre and Clebsch, it is no minimum.

Pontryagin's principle asks for the maximum of ``H = <p, X> - F`` in the control. Along directions that no active
inequality holds, ``R = F_uu - p X_uu + nu g_uu`` has no negative eigenvalue there.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ....manifolds.numerics.rank import null_space
from ....manifolds.numerics.tolerances import REGULAR, rounding_of, tolerance
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.point_layout import PointLayout
from ..transcription.discrete_extremals import DiscreteExtremals
from ..transcription.functions.steps import AtStages
from ..transcription.transcribed_problem import TranscribedProblem

SWITCH = 2  # steps: as long as a control may take from bound to bound, where its ends determine it


class ConcaveDirection(NamedTuple):
    """The stages at which the cost of a trajectory is concave, shape (S,), and the most concave direction at the first,
    (m,)."""

    stages: np.ndarray
    direction: np.ndarray


def find_concave_directions(
    transcribed: TranscribedProblem,
    found: DiscreteExtremals,
    stages: AtStages,
    held: np.ndarray | None,
    success: np.ndarray,
) -> dict[int, ConcaveDirection]:
    """The members with success that are no minimum because the cost is concave in the controls.

    ``held``: where an inequality holds the trajectory. All that is convex is known to the search. A strict
    minimum of the discrete problem may pass from bound to bound within a step or two, at a stage that its ends hold.
    """
    suspected = success & ~(found.strict_minimum & found.convex)
    if not suspected.any() or not transcribed.traced.diagnosis.problem.controls.dimension:
        return {}
    suspects, points = np.flatnonzero(suspected), transcribed.traced.steps.stages
    result = dict[int, ConcaveDirection]()
    for k in suspects:
        one = _along(transcribed, found, stages, None if held is None else held[k], int(k))
        begin, end = longest_arc(one.stages)
        switches = found.strict_minimum[k] and held is not None and bool(held[k].any())
        if end - begin > (SWITCH * points if switches else 0):
            result[int(k)] = one
    return result


def _along(
    transcribed: TranscribedProblem, found: DiscreteExtremals, stages: AtStages, held: np.ndarray | None, k: int
) -> ConcaveDirection:
    """The stages of a member at which the cost is concave in the controls."""
    diagnosis, at = transcribed.traced.diagnosis, [part[k : k + 1] for part in stages]
    given, m = transcribed.conditions.data.parameters[k : k + 1], diagnosis.problem.controls.dimension
    slopes, curvatures = (part[0] for part in diagnosis.in_controls(tuple(at), given))
    limits, rows = np.zeros((len(slopes), m, m)), np.zeros((len(slopes), 0, m))
    active, limited = np.zeros((len(slopes), 0), bool), found.inequalities
    if held is not None and limited is not None:
        count = transcribed.traced.steps.own
        inside = np.s_[:, : transcribed.traced.steps.stages, :count]
        pull, active = (part[inside].reshape(len(slopes), count) for part in (limited.multipliers[k], held))
        limits = diagnosis.of_limits((*at[:2], pull[None]), given)[0]
        jacobian = found.system(k).limit_jacobians[0][:, :, :count]
        rows = jacobian[..., jacobian.shape[-1] - m :].reshape(len(slopes), count, m)
    flat = transcribed.traced.diagnosis.control.size == m
    sizes = np.abs(at[1][0]) if flat else np.ones((len(slopes), m))
    parts = np.concatenate([curvatures, limits[:, None]], axis=1)
    of_held = [limit_rows[which] for limit_rows, which in zip(rows, active, strict=True)]
    ways = [_direction(*one) for one in zip(slopes, parts, sizes, of_held, strict=True)]
    there = np.array([way is not None for way in ways], bool)
    first = next((way for way in ways if way is not None), np.zeros(m))
    return ConcaveDirection(there, first)


def _direction(slopes: np.ndarray, parts: np.ndarray, sizes: np.ndarray, active: np.ndarray) -> np.ndarray | None:
    """The direction in which ``R`` is most negative at a stage; None unless ``R`` is negative beyond rounding.

    The direction is in units of the controls and has the size 1.

    ``parts``: second derivatives of ``<p, X>``, ``F`` and ``nu g``; ``sizes`` of the controls, by which slopes round.
    """
    if not np.all(np.isfinite(parts)):
        return None
    rounding = rounding_of(parts)
    steep = np.outer(np.max(np.abs(slopes), axis=0), 1 / np.where(sizes > 0, sizes, np.inf))
    parts = np.where(np.abs(parts) <= rounding * np.minimum(steep, steep.T), 0.0, parts)
    matrix, terms = parts[1] - parts[0] + parts[2], np.sum(np.abs(parts), axis=0)
    matrix = np.where(np.abs(matrix) <= rounding * terms, 0.0, matrix)
    units = _units(matrix)
    scaled = units[:, None] * matrix * units
    rows = active * units
    rows = rows / np.max(np.abs(rows), axis=1, keepdims=True, initial=np.finfo(float).tiny)
    free = null_space(rows, limit=tolerance(rows, REGULAR))
    values, vectors = np.linalg.eigh(free.T @ scaled @ free)
    if not values.size or values[0] >= -tolerance(parts, REGULAR):
        return None
    return free @ vectors[:, 0]


def _units(matrix: np.ndarray) -> np.ndarray:
    """Units of the controls in which each has a curvature of size 1, by itself or with another; 1 where it has none."""
    sizes = np.sqrt(np.abs(np.diag(matrix)))
    alone = sizes == 0
    with np.errstate(all="ignore"):
        beside = np.max(np.where(alone, 0.0, np.abs(matrix) / sizes), axis=1)
    beside = np.where(beside > 0, beside, np.sqrt(np.max(np.abs(matrix), axis=1)))
    sizes = np.where(alone, beside, sizes)
    return 1 / np.where(sizes > 0, sizes, 1.0)


def longest_arc(flat: np.ndarray) -> tuple[int, int]:
    """Where the longest run of what is true begins and ends."""
    edges = np.diff(np.concatenate([[0], flat.astype(int), [0]]))
    begins, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
    if not begins.size:
        return 0, 0
    widest = int(np.argmax(ends - begins))
    return int(begins[widest]), int(ends[widest])


def concave_words(
    problem: OptimalControlProblem, one: ConcaveDirection, names: Sequence[str], controls: np.ndarray, times: Any
) -> str:
    """Where the cost is concave, and in which control, with these controls and times of the stages."""
    first, count = int(np.argmax(one.stages)), int(np.sum(one.stages))
    layout = PointLayout.of(problem.controls)
    frame = layout.flat_frame(problem.controls.basis(layout.points(controls[first])))
    entry = int(np.argmax(np.abs(one.direction @ np.asarray(frame))))
    where = f"at {count} of {len(times)} stages, the first" if count > 1 else "at one stage,"
    return f"It is concave in {names[entry]} {where} at t = {times[first]:.6g}."
