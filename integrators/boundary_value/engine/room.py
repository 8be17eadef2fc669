"""How far the controls of a guess can go before an inequality holds them: a unit of controls whose cost has no curvature.

In the middle of a ball, ``u @ u <= r^2`` at rest, an inequality has no slope in the controls; there its curvature says
how far they can go.
"""

from typing import TYPE_CHECKING

import numpy as np

from .inequalities import Slacks
from .system import Assembled, Iterate

if TYPE_CHECKING:
    from .conditions import Conditions


def room(conditions: "Conditions", iterate: Iterate, assembled: Assembled) -> np.ndarray:
    """The way of each control of a step to the nearest inequality, zero where there is none, shape (B, s m)."""
    held, m = assembled.blocks.inequalities, conditions.transcription.controls.dimension
    if not m:
        return np.zeros((len(held.values), 0))
    found = _nearest(np.abs(held.values)[..., None], np.abs(held.jacobian[..., -m:]) * held.asked[..., None])
    if np.all(found > 0):
        return found
    curved = np.stack([_curvature(conditions, iterate, assembled, k) for k in range(held.values.shape[3])], axis=3)
    return np.where(found > 0, found, np.sqrt(_nearest(2 * np.abs(held.values)[..., None], curved)))


def _nearest(values: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """The least of the largest ways in a step, shape (B, s m), from values and slopes (B, N, s, c, m)."""
    with np.errstate(all="ignore"):
        way = np.where(slopes > 0, values / slopes, 0.0).max(axis=1)
    way = np.where(way > 0, way, np.inf).min(axis=2, initial=np.inf)
    return np.where(np.isfinite(way), way, 0.0).reshape(len(way), -1)


def _curvature(conditions: "Conditions", iterate: Iterate, assembled: Assembled, k: int) -> np.ndarray:
    """Second derivatives of one inequality in each control of a point, shape (B, N, s, m)."""
    held, n = assembled.blocks.inequalities, assembled.gap.shape[2]
    alone = Slacks.none(held.values.shape)
    alone.slacks.fill(np.inf)  # else it has a stiffness beside its curvature
    alone.multipliers[..., k] = 1.0
    around = assembled.nodes, assembled.costates, assembled.terminal, assembled.initial
    pulled = conditions.blocks(iterate._replace(slacks=alone), *around).hessian - assembled.blocks.hessian
    curvature = np.diagonal(pulled, axis1=2, axis2=3)[..., n:].reshape(*held.values.shape[:3], -1)
    weights = held.weights[..., k, None]
    return np.where(weights > 0, curvature / np.where(weights > 0, weights, 1.0), 0.0)
