"""The measure of success: units of what was found and of the data, not of the guess."""

from copy import copy
from typing import Any

import numpy as np

from ....manifolds.numerics.ambient import taken
from ....manifolds.numerics.tolerances import EPS, HALF
from .beginning import in_units
from .first_units import first_units

LESS = 0.1  # of the units that a success was judged in: where its own ones are less, it is judged again
RESTS = EPS**HALF  # of these units: a trajectory that goes no farther, and from no end to another, has none of its own


def judged_loosely(conditions: Any, found: Any) -> np.ndarray:
    """Members whose success was judged in units far larger than those of what was found.

    Units of states, controls or cost: whatever the guess, success is judged by the sizes of the solution.
    """
    places = np.flatnonzero(found.claimed)
    if not places.size:
        return places
    own, iterate, assembled = conditions.of(places), taken(found.iterate, places), taken(found.assembled, places)
    pairs = [*zip(_sizes(_measured_again(own, iterate, assembled)), _sizes(own), strict=True)]
    shares = np.min([new / old for new, old in pairs], axis=0)
    rests = np.all([new <= RESTS * old for new, old in pairs], axis=0) & ~_goes(own, assembled)
    return places[(shares < LESS) & ~rests]


def _measured_again(conditions: Any, iterate: Any, assembled: Any) -> Any:
    """The conditions with the units of an iterate."""
    again = copy(conditions)
    if conditions.joint:
        again.phases = tuple(map(copy, conditions.phases))
        again.begin(iterate)
    elif iterate.slacks is None:
        again.units = first_units(again, iterate, assembled)
    else:
        in_units(again, iterate)
    return again


def _sizes(conditions: Any) -> list[np.ndarray]:
    """The units of all unknowns and of the costs that success is judged by, shape (B,) each."""
    phases = [phase.judging for phase in getattr(conditions, "phases", (conditions,))]
    return [size for units in phases for size in (*units.unknowns.T, units.cost)]


def _goes(conditions: Any, assembled: Any) -> np.ndarray:
    """Whether a trajectory moves by more than rounding of a prescribed end, shape (B,)."""
    if conditions.joint:
        return np.any([_goes(*of) for of in zip(conditions.phases, assembled.parts, strict=True)], axis=0)
    ends, extent = conditions.ends, assembled.extent
    given = np.maximum(np.abs(ends.start) * ends.start_entries, np.abs(ends.end) * ends.end_entries)
    return np.any(extent.moves & (given > 0), axis=1)
