"""The measure of success: units of what was found and of the data, not of the guess."""

from copy import copy
from typing import Any

import numpy as np

from ....manifolds.numerics.ambient import taken
from ....manifolds.numerics.tolerances import EPS, HALF
from .beginning import in_units
from .first_units import first_units

LESS = 0.1  # of the units that a success was judged in: where its own ones are less, it is judged again
RESTS = EPS**HALF  # of these units: what goes no farther, from no end to another or by no control, is rounding


def judged_loosely(conditions: Any, found: Any) -> np.ndarray:
    """Members whose success was judged in units far larger than those of what was found.

    Units of states, controls or cost: whatever the guess, success is judged by the sizes of the solution.
    """
    places = np.flatnonzero(found.claimed)
    if not places.size:
        return places
    own, iterate, assembled = conditions.of(places), taken(found.iterate, places), taken(found.assembled, places)
    (goes, acts), share = _goes(own, iterate, assembled), _sizes(_measured_again(own, iterate, assembled)) / _sizes(own)
    return places[acts & np.any(share < LESS, axis=1) & (goes | np.any(share > RESTS, axis=1))]


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
