"""Whether success was judged in a unit of the cost that is the solution's own."""

from typing import Any

import numpy as np

from ....manifolds.numerics.ambient import taken
from ....manifolds.numerics.tolerances import EPS, HALF

LESS = 0.1  # of the unit of the guess: one that is less by that much judges again
RESTS = EPS**HALF  # of the units of the guess: a trajectory that goes no farther has no units of its own


def judged_loosely(conditions: Any, found: Any) -> np.ndarray:
    """Members whose success was judged in a unit of the cost that is much larger than their own.

    Products of slacks and multipliers are measured by that of the guess, which may cost much more, as a way through an
    obstacle, or have the costates of another problem. It is measured again only where what cancels in the derivative of
    the Lagrangian is less than it: elsewhere no evaluation is made. Trajectories whose ends are coupled are judged so
    too, unless they are at rest, where what they move by is rounding.
    """
    if found.iterate.slacks is None and not conditions.joint:
        return np.zeros(0, int)
    places = np.flatnonzero(found.claimed & (_parts(conditions, found.assembled) < LESS * found.unit))
    if not places.size:
        return places
    own = conditions.of(places)
    least = RESTS * own.judging.nodes if conditions.joint else 0.0
    own.begin(taken(found.iterate, places))
    moves = np.any(own.judging.nodes > least, axis=1)
    return places[moves & (own.judging.cost < LESS * found.unit[places])]


def _parts(conditions: Any, assembled: Any) -> np.ndarray:
    """The largest of what cancels in the derivative of the Lagrangian, in the unit of the cost, shape (B,)."""
    if conditions.joint:
        return np.max([_parts(*of) for of in zip(conditions.phases, assembled.parts, strict=True)], axis=0)
    return (assembled.extent.parts * conditions.judging.unknowns).max(axis=1, initial=0.0)
