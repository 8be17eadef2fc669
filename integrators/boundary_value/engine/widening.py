"""Units of coordinates that a guess near to rest hides, found from the first step that is refused.

A rate that only products of others change is reached by nothing at rest, and by next to nothing near to it. In the unit that
this gives it all steps end far outside the funnel, and none gets shorter by a shift: the constraints ask for it.
"""

from typing import Any

import numpy as np

from .conditions import Conditions
from .system import Assembled, Step

WIDER = 10.0  # times its unit: by less a unit is not mistaken


def lacking(assembled: Assembled) -> np.ndarray:
    """The sum of what nodes and points lack in each coordinate, shape (B, n)."""
    inner = assembled.blocks.inner
    return assembled.extent.missing + (0.0 if inner is None else np.abs(inner.defect).sum(axis=(1, 2)))


def widened(conditions: Conditions, before: Assembled, after: Assembled, step: Step, part: np.ndarray) -> tuple[Any, np.ndarray]:
    """Units in which what a part of a step leaves to second order is no more than where all moves by its unit; and whose differ.

    After a part ``f`` of a step that moves the trajectory by ``k`` units ``1 - f`` of what was lacking is left, and ``k^2`` times
    the second-order change.
    """
    units = conditions.measured
    moved = part * (np.abs(step.unknowns) / units.unknowns[:, None]).max(axis=(1, 2))
    left = lacking(after) - (1 - part)[:, None] * lacking(before)
    with np.errstate(all="ignore"):
        second = np.nan_to_num(left / moved[:, None] ** 2, nan=0.0, posinf=0.0, neginf=0.0)
    nodes = np.where(second > WIDER * units.nodes, second, units.nodes)
    unknowns = np.concatenate([nodes, units.unknowns[:, nodes.shape[1] :]], axis=1)
    return units._replace(nodes=nodes, unknowns=unknowns), np.any(nodes > units.nodes, axis=1)
