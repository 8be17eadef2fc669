"""Units of coordinates that a guess near to rest hides, found from the first step that is refused.

A rate that only products of others change is reached by nothing at rest, and by next to nothing near to it. In the unit
that this gives it all steps end far outside the funnel, and none gets shorter by a shift: the constraints ask for it.
"""

from typing import Any

import numpy as np

from .acceptance import Funnel, State
from .batches import merged, put
from .conditions import Conditions
from .kkt_system import Assembled
from .scaling import Units

WIDER = 10.0  # times its unit: by less a unit is not mistaken


def lacking(assembled: Assembled) -> np.ndarray:
    """The sum of what nodes and points lack in each coordinate, shape (B, n)."""
    inner = assembled.blocks.inner
    return assembled.extent.missing + (0.0 if inner is None else np.abs(inner.defect).sum(axis=(1, 2)))


def widened(conditions: Conditions, before: State, after: Assembled) -> Units:
    """Units in which what a trial lacks to second order is no more than where all moves by its unit.

    After a part ``f`` of a step that moves the trajectory by ``k`` units ``1 - f`` of what was lacking is left, and
    ``k^2`` times the second-order change.
    """
    units, part = conditions.measured, before.fraction * before.step.reach
    moved = part * conditions.length(before.step)
    left = lacking(after) - (1 - part)[:, None] * lacking(before.assembled)
    with np.errstate(all="ignore"):
        second = np.nan_to_num(left / moved[:, None] ** 2, nan=0.0, posinf=0.0, neginf=0.0)
    nodes = np.where(second > WIDER * units.nodes, second, units.nodes)
    return units._replace(nodes=nodes, unknowns=np.concatenate([nodes, units.unknowns[:, nodes.shape[1] :]], axis=1))


def rewritten(
    rule: Funnel, both: tuple[Any, Any], before: State, state: State, trial: Assembled, refused: np.ndarray
) -> tuple[State, np.ndarray]:
    """The state in wider units where these are what the step is refused for; and where that is.

    ``rule``: by which trials are judged; ``both``: the conditions of all members, and of those of the state.
    """
    whole, conditions = both
    # Of phases each would have its own: they are left as they are.
    if not refused.any() or conditions.joint:
        return state, np.zeros(len(refused), bool)
    units = widened(conditions, before, trial)
    wider = refused & np.any(units.nodes > conditions.measured.nodes, axis=1)
    if not wider.any():
        return state, wider
    conditions.wider = merged(wider, units, conditions.measured)
    if conditions is not whole:
        # A copy: the units before are those that success is judged in.
        whole.wider = put(Units(*map(np.array, whole.measured)), state.member, conditions.wider)
    residuals = conditions.residuals(state.iterate, state.assembled)
    merit = rule.value(conditions, state.iterate, state.assembled)
    funnel = np.where(wider, rule.width(merit), state.funnel)
    best, shift = np.where(wider, residuals.largest, state.best), np.where(wider, before.shift, state.shift)
    return state._replace(residuals=residuals, merit=merit, funnel=funnel, best=best, shift=shift), wider
