"""The units of what a search has come to, by which it goes on and success is judged, not those of the guess."""

from copy import copy
from typing import Any

import numpy as np

from ....manifolds.numerics.ambient import joined, taken
from ....manifolds.numerics.tolerances import EPS, HALF
from .beginning import in_units, started
from .first_units import first_units
from .regularising import regularised
from .scaling import Units

LESS = 0.1  # of the units in use: where own ones are less, these take their place
RESTS = EPS**HALF  # of these units: what goes no farther, from no end to another or by no control, is rounding


def own_units(conditions: Any, iterate: Any, assembled: Any) -> tuple[Any, Any]:
    """The conditions with the units of an iterate, and its system in these.

    Steps are measured by these, success by the lesser ones of these and of those before: what a search runs away to is
    no measure. Phases have one measure for both, but for the cost, which multipliers make larger than it is.
    """
    again = copy(conditions)
    if conditions.joint:
        again.phases = tuple(map(copy, conditions.phases))
        first = again.in_units(iterate)
        cost = np.minimum(conditions.judging.cost, again.judging.cost)
        again.units = again.judging._replace(cost=cost)
        for phase, own in zip(again.phases, first, strict=True):
            phase.units = phase.judging._replace(cost=cost)
            started(phase, *own)
        return again, again.assemble(iterate)
    first = iterate, assembled
    if iterate.slacks is None:
        again.units = first_units(again, iterate, assembled)
    else:
        first = in_units(again, iterate)
    own, again.units = again.judging, Units(*map(np.minimum, conditions.judging, again.judging))
    again.wider = own._replace(cost=again.units.cost)
    started(again, *first)
    return again, assembled


def outgrown(conditions: Any, again: Any, iterate: Any, assembled: Any) -> np.ndarray:
    """Whether the units of each member are far larger than those of its iterate, shape (B,); ``again``: the conditions
    with these.

    Units of states, controls or cost: whatever the guess, a search goes by the sizes of what it has come to.
    """
    (goes, acts), share = _goes(conditions, iterate, assembled), _sizes(again) / _sizes(conditions)
    return acts & np.any(share < LESS, axis=1) & (goes | np.any(share > RESTS, axis=1))


def renewed(search: Any, state: Any, ended: np.ndarray, after_round: bool) -> Any:
    """The state of a search with members in units of their iterates where theirs are far from these; itself if none
    are.

    After a round all are looked at, else those that have ``ended``. A cost that falls without end has no size: there
    the search goes on as it is.
    """
    looked, count = np.flatnonzero(ended | after_round), len(search.unit)
    unclaimed = np.isin(np.arange(count), state.member[looked[~state.claimed[looked]]])
    looked = looked[~search.fall.lasts(unclaimed, search.unit)[state.member[looked]]]
    if not looked.size:
        return state
    part = state if len(looked) == len(ended) else taken(state, looked)
    conditions = search.conditions.of(part.member)
    again, assembled = own_units(conditions, part.iterate, part.assembled)
    far = np.flatnonzero(outgrown(conditions, again, part.iterate, part.assembled))
    if not far.size:
        return state
    if len(far) < len(looked):
        again, part, assembled = again.of(far), taken(part, far), taken(assembled, far)
    adopted(search.conditions, again, part.member, count)
    near = again.residuals(part.iterate, assembled).largest <= np.sqrt(search.tolerance)
    step = regularised(again, part.iterate, assembled, np.zeros(len(far)), near, near)
    part = search.standing(again, part.member, (part.iterate, assembled), *step)
    rest = np.setdiff1d(np.arange(len(ended)), looked[far])
    return taken(joined([taken(state, rest), part]), np.argsort(np.concatenate([rest, looked[far]])))


def adopted(conditions: Any, part: Any, members: np.ndarray, count: int) -> None:
    """Let the conditions of so many members have the units of a part in some."""
    rest = np.setdiff1d(np.arange(count), members)
    parts = [conditions.of(rest), part] if rest.size else [part]
    conditions.adopt(parts, np.argsort(np.concatenate([rest, members])))


def _sizes(conditions: Any) -> np.ndarray:
    """The units of all unknowns and of the costs that success is judged by, shape (B, k)."""
    phases = [phase.judging for phase in getattr(conditions, "phases", (conditions,))]
    return np.hstack([part for units in phases for part in (units.unknowns, units.cost[:, None])])


def _goes(conditions: Any, iterate: Any, assembled: Any) -> np.ndarray:
    """Whether a trajectory moves by more than rounding of a prescribed end, and its controls by more than rounding of
    its states, shape (2, B): else its own sizes are rounding."""
    if conditions.joint:
        each = zip(conditions.phases, iterate.parts, assembled.parts, strict=True)
        return np.any([_goes(*of) for of in each], axis=0)
    ends, extent, n = conditions.ends, assembled.extent, assembled.gap.shape[2]
    given = np.maximum(np.abs(ends.start) * ends.start_entries, np.abs(ends.end) * ends.end_entries)
    pushed = np.abs(assembled.blocks.right[..., n:]).sum(axis=1) @ conditions.control_sizes(iterate)[:, :, None]
    acts = pushed[..., 0] > RESTS * extent.moved(conditions.at_nodes.layout)[1]
    return np.stack([np.any(extent.moves & (given > 0), axis=1), np.any(acts, axis=1)])
