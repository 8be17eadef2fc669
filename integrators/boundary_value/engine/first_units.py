"""Units in which a search begins, from its first iterate."""

from typing import TYPE_CHECKING

import numpy as np

from ..transcription.iterate import Iterate
from .kkt_system import Assembled
from .room import room
from .scaling import Units, natural_units

if TYPE_CHECKING:
    from .conditions import Conditions

FLAT = 1e-8  # of the largest curvature in the controls, by their ways to the bounds: less of it is rounding


def first_units(
    conditions: "Conditions", iterate: Iterate, assembled: Assembled, least: np.ndarray | float = 0.0
) -> Units:
    """Units from an iterate; ``least``: what the coordinates of the nodes have to move by, shape (B, n)."""
    extent, blocks, controls, curved = assembled.extent, assembled.blocks, conditions.control_sizes(iterate), True
    free: np.ndarray | float = np.inf
    if blocks.held is not None:
        # Where the cost is not curved in the controls, but for rounding, their way to the bounds measures them.
        own, (ways, free) = extent.curvature[:, assembled.gap.shape[2] :], room(conditions, iterate, assembled)
        changes = own * np.where(ways > 0, ways, 1.0) ** 2
        curved = (changes > FLAT * changes.max(axis=1, keepdims=True, initial=0.0)).all(axis=1)
        controls = np.where(curved[:, None], controls, np.maximum(controls, ways))
    moved, sizes = extent.moved(conditions.at_nodes.layout)
    fallback = np.concatenate([sizes, controls], axis=1)
    system = conditions.system(iterate, assembled)
    return natural_units(system, blocks.gradient, np.maximum(moved, least), controls, fallback, curved, free)


def reached(conditions: "Conditions", iterate: Iterate, assembled: Assembled) -> tuple[np.ndarray, np.ndarray]:
    """How far controls of a trajectory of size one move the coordinates of the nodes, zero where they do not; and sizes
    of those that nothing moves, shape (B, n)."""
    system, n = conditions.system(iterate, assembled), assembled.gap.shape[2]
    curvature = np.abs(np.diagonal(system.hessian, axis1=2, axis2=3)).sum(axis=1)[:, n:]
    controls = np.where(curvature > 0, 1 / np.sqrt(np.where(curvature > 0, curvature, 1.0)), 1.0)
    rest, unmoved = np.zeros_like(assembled.blocks.gradient), np.finfo(float).tiny
    units = natural_units(system, rest, np.zeros((len(controls), n)), controls, unmoved).nodes
    return np.where(units > unmoved, units, 0.0), assembled.extent.moved(conditions.at_nodes.layout)[1]
