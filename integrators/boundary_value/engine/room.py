"""How far the controls of a guess can go between the inequalities: a unit of controls whose cost has no curvature.

In a ball, ``u @ u <= r^2``, an inequality has no slope in the controls at rest, or along the sphere that is its bound;
there its curvature says how far they can go.
"""

from typing import TYPE_CHECKING

import numpy as np

from ..transcription.iterate import Iterate, Slacks
from .kkt_system import Assembled

if TYPE_CHECKING:
    from .conditions import Conditions

# Of the largest slope, or curvature, of an inequality in a control along the trajectory: where one passes through zero,
# as those of a cone do, it says nothing of the way.
LEAST = 1e-2
SUM_ROUNDING = 1e-13  # of a curvature: less of it than this is what its sum with another is rounded by


def room(conditions: "Conditions", iterate: Iterate, assembled: Assembled) -> tuple[np.ndarray, np.ndarray]:
    """Half of the way of each control of a step from one inequality to the other, or that to the only one.

    The largest of all steps, zero where there is none, shape (B, s m); and the same but infinite where a side is open,
    on which a way to the other says nothing.
    """
    held, m = assembled.blocks.inequalities, conditions.transcription.controls.dimension
    held = held.at_points(conditions.transcription.stages)
    if not m:
        return np.zeros((len(held.values), 0)), np.zeros((len(held.values), 0))
    slopes = held.jacobian[..., -m:] * held.asked[..., None]
    size = np.maximum(np.abs(slopes), LEAST * _largest(np.abs(slopes)))
    with np.errstate(all="ignore"):
        straight = np.where(slopes == 0, np.inf, np.abs(held.values[..., None]) / size)
    bounds = sum(map(len, conditions.at_nodes.problem._limits.bounded.values()))  # these are straight
    left = [k for k in range(bounds, held.values.shape[3]) if np.any(held.asked[..., k])]
    curved = (_curved(conditions, iterate, assembled, k) for k in left)
    ball = np.min([np.full((*slopes.shape[:3], m), np.inf), *curved], axis=0)
    sides = [np.where(side, straight, np.inf).min(axis=3, initial=np.inf) for side in (slopes > 0, slopes < 0)]
    ways = np.minimum(sides, ball)
    found = np.where(np.isfinite(ways), ways, 0.0).sum(axis=0) / np.maximum(np.isfinite(ways).sum(axis=0), 1)
    return tuple(a.max(axis=1).reshape(len(a), -1) for a in (found, ways.mean(axis=0)))


def _largest(parts: np.ndarray) -> np.ndarray:
    """The largest of all points of each member."""
    return np.where(np.isfinite(parts), parts, 0.0).max(axis=(1, 2), keepdims=True)


def _curved(conditions: "Conditions", iterate: Iterate, assembled: Assembled, k: int) -> np.ndarray:
    """How far the controls of a point can go inside an inequality that is curved, shape (B, N, s, m), else infinite.

    For ``g = |u|^2 - r^2`` in whatever units of the controls it is ``|u| + r``.
    """
    held, n = assembled.blocks.inequalities, assembled.gap.shape[2]
    alone = Slacks.none(held.values.shape)
    held = held.at_points(conditions.transcription.stages)
    alone.slacks.fill(np.inf)  # else it has a stiffness beside its curvature
    alone.multipliers[..., k] = 1.0
    around = assembled.nodes, assembled.costates, assembled.paid
    both = conditions.blocks(iterate._replace(slacks=alone), *around).hessian, assembled.blocks.hessian
    pulled, own = (np.diagonal(a, axis1=2, axis2=3)[..., n:].reshape(*held.values.shape[:3], -1) for a in both)
    curvature = np.where(np.abs(pulled - own) > SUM_ROUNDING * np.abs(own), pulled - own, 0.0)
    slope, value = held.jacobian[..., k, -curvature.shape[3] :], np.abs(held.values[..., k, None])
    with np.errstate(all="ignore"):
        curvature = curvature / held.weights[..., k, None]
        curvature = np.where(curvature > 0, np.maximum(curvature, LEAST * _largest(curvature)), curvature)
        own = np.sum(np.where(curvature > 0, slope**2 / curvature, 0.0), axis=3, keepdims=True)
        way = (np.sqrt(own) + np.sqrt(own + 2 * value)) / np.sqrt(curvature)
    return np.where((curvature > 0) & np.isfinite(way), way, np.inf)
