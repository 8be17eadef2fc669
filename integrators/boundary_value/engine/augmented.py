"""The augmented KKT system, with the multipliers of the inequalities among the unknowns of the steps.

Where an inequality is active its stiffness D grows without bound as the barrier vanishes: ``H + w J' D J`` then has a
curvature beside it that is small relative to its entries, and lost in their rounding. Newton's steps bear that [Wright
1998]; the inertia and derivatives by data do not. With ``e = w dnu`` as unknowns,

    [H  J'         ]
    [J  -1 / (w D) ],

the system has no large entries and the inertia of the other with one negative eigenvalue more for each inequality.
"""

from typing import TYPE_CHECKING, cast

import numpy as np

from ....manifolds.numerics.ambient import taken
from ..transcription.iterate import Iterate, Slacks
from .elimination import BlockSystem, eliminate, is_strict_minimum
from .inequalities import Held, stiffness
from .kkt_system import Assembled
from .scaling import Units
from .transcription import Blocks

if TYPE_CHECKING:
    from .conditions import Conditions

STIFFEST, IDLE = 1e6, 1e6  # in units of the cost and of the inequality, and one over these
TOGETHER = 16  # members: the large systems of more do not fit into the caches


def of_lagrangian(conditions: "Conditions", iterate: Iterate, assembled: Assembled) -> Blocks:
    """The blocks without the share of the inequalities in the Hessians."""
    slacks = iterate.slacks
    if slacks is None:
        return assembled.blocks
    free = slacks._replace(slacks=np.full_like(slacks.slacks, np.inf))  # inequalities this far away have no stiffness
    around = assembled.nodes, assembled.costates, assembled.paid
    return conditions.blocks(iterate._replace(slacks=free), *around)


def is_isolated_minimum(conditions: "Conditions", iterate: Iterate, assembled: Assembled) -> np.ndarray:
    """Whether the Hessian of the Lagrangian is positive definite on the null space of the constraints, beyond rounding,
    (B,).

    An inequality counts by its stiffness: as a constraint where it is active, not at all elsewhere.
    """
    members = np.arange(len(assembled.gap))
    parts = np.array_split(members, -(-len(members) // TOGETHER))
    if len(parts) > 1:
        each = (_is_isolated_minimum(conditions.of(part), *taken((iterate, assembled), part)) for part in parts)
        return np.concatenate(list(each))
    return _is_isolated_minimum(conditions, iterate, assembled)


def _is_isolated_minimum(conditions: "Conditions", iterate: Iterate, assembled: Assembled) -> np.ndarray:
    """The same of members that are looked at together."""
    blocks, held = of_lagrangian(conditions, iterate, assembled), assembled.blocks.inequalities
    limits, slacks = conditions.transcription.limits(blocks, conditions.data.steps), cast(Slacks, iterate.slacks)
    right = np.zeros((*limits.shape[:2], sum(limits.shape[2:]), 1)), np.zeros((*assembled.gap.shape, 1))
    system = BlockSystem(blocks.hessian, blocks.left, blocks.right, *right, *conditions.fixed_ends)
    del blocks  # what it was condensed from takes more memory than all that follows
    # Each of the others has a negative eigenvalue of its own.
    others, size = limits[0, :, :, 0].size, assembled.gap[0].size
    found = eliminate(*augmented(system, conditions.measured, limits, held, slacks))
    found = found._replace(negative=found.negative - others)
    strict = is_strict_minimum(found, size)
    if np.all(strict | (found.negative != size)):
        return strict
    # In the units that success is judged in, which no step has made wider.
    found = eliminate(*augmented(system, conditions.judging, limits, held, slacks, softly=True))
    return strict | is_strict_minimum(found._replace(negative=found.negative - others), size)


def augmented(
    system: BlockSystem, units: Units, limits: np.ndarray, held: Held, slacks: Slacks, softly: bool = False
) -> tuple[BlockSystem, Units]:
    """The system of the Lagrangian alone with its inequalities, and their units.

    ``limits``: derivatives in the unknowns of the steps, shape (B, N, c, z) with the inequalities of all points of a
    step. The slope of the system comes with their rows, shape (B, N, z + c, k). ``softly``: no inequality is stiffer
    than ``STIFFEST`` and those that are next to not stiff are not at all. What is positive definite with less stiffness
    is so with more, and two inequalities that hold almost the same, as at points beside the one that a trajectory
    touches, leave no small pivots.
    """
    shape, (c, z) = limits.shape[:2], limits.shape[2:]
    with np.errstate(all="ignore"):
        give = (1 / (held.weights * stiffness(slacks))).reshape(*shape, c)
        limits = np.where(np.isfinite(give)[..., None], limits, 0.0)  # else it is not asked for
        reach = np.max(np.sum(np.abs(limits) * units.unknowns[:, None, None], axis=3), axis=1)
        own = np.where(reach > 0, units.cost[:, None] / reach, units.cost[:, None])
        if softly:
            unit = (units.cost[:, None] / own**2)[:, None]
            give = np.where(give < IDLE * unit, np.maximum(give, unit / STIFFEST), np.inf)
            limits = np.where(np.isfinite(give)[..., None], limits, 0.0)
    give = np.where(np.isfinite(give), give, (units.cost[:, None] / own**2)[:, None])
    hessian = np.zeros((*shape, z + c, z + c))
    hessian[..., :z, :z], hessian[..., :z, z:], hessian[..., z:, :z] = system.hessian, limits.mT, limits
    hessian[..., z:, z:] = -give[..., None] * np.eye(c)
    none = np.zeros((*system.left.shape[:3], c))
    left, right = (np.concatenate([ends, none], axis=3) for ends in (system.left, system.right))
    wider = units._replace(unknowns=np.concatenate([units.unknowns, own], axis=1))
    return system._replace(hessian=hessian, left=left, right=right), wider
