"""The units of what a search has come to, by which it goes on and success is judged, not those of the guess."""

from copy import copy
from typing import Any

import numpy as np

from ....manifolds.numerics.ambient import joined, taken
from ....manifolds.numerics.tolerances import EPS, HALF
from .beginning import in_units
from .first_units import first_units
from .restoration import NARROW

LESS = 0.1  # of the units in use: where own ones are less, these take their place
RESTS = EPS**HALF  # of these units: what goes no farther, from no end to another or by no control, is rounding


def outgrown(conditions: Any, iterate: Any, assembled: Any) -> np.ndarray:
    """Whether the units of each member are far larger than those of its iterate, shape (B,).

    Units of states, controls or cost: whatever the guess, a search goes by the sizes of what it has come to.
    """
    own = _sizes(_measured_again(conditions, iterate, assembled))
    (goes, acts), share = _goes(conditions, iterate, assembled), own / _sizes(conditions)
    return acts & np.any(share < LESS, axis=1) & (goes | np.any(share > RESTS, axis=1))


def renewed(search: Any, state: Any, which: np.ndarray) -> Any:
    """The state of a search where members begin again where they stand, if their units are far larger than those of
    their iterates; itself where none does. Only those ``which`` are looked at.

    A cost that falls without end has no size: then the search goes on as it is.
    """
    far = np.flatnonzero(which)
    if far.size:
        own, count = search.conditions.of(state.member), len(search.unit)
        far = far[outgrown(own.of(far), *taken((state.iterate, state.assembled), far))]
        unclaimed = np.isin(np.arange(count), state.member[far[~state.claimed[far]]])
        far = far[~search.fall.lasts(unclaimed, search.unit)[state.member[far]]]
    if not far.size:
        return state
    again, rest = own.of(far), np.setdiff1d(np.arange(len(which)), far)
    options = search.tolerance, search.max_iterations, None
    alone = type(search)(again, *options, as_it_is=True, width=NARROW)
    fresh = alone.begun(taken(state.iterate, far))._replace(member=state.member[far])
    adopted(search.conditions, again, fresh.member, count)
    return taken(joined([taken(state, rest), fresh]), np.argsort(np.concatenate([rest, far])))


def adopted(conditions: Any, part: Any, members: np.ndarray, count: int) -> None:
    """Let the conditions of so many members have the units of a part in some."""
    rest = np.setdiff1d(np.arange(count), members)
    parts = [conditions.of(rest), part] if rest.size else [part]
    conditions.adopt(parts, np.argsort(np.concatenate([rest, members])))


def _measured_again(conditions: Any, iterate: Any, assembled: Any) -> Any:
    """The conditions with the units of an iterate."""
    again = copy(conditions)
    if conditions.joint:
        again.phases = tuple(map(copy, conditions.phases))
        again.in_units(iterate)
    elif iterate.slacks is None:
        again.units = first_units(again, iterate, assembled)
    else:
        in_units(again, iterate)
    return again


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
