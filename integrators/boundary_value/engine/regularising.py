"""Shifts of indefinite Hessians, with which Newton's steps descend."""

import numpy as np

from ....manifolds.numerics.ambient import taken
from ..transcription.iterate import Iterate
from .acceptance import FIRST_SHIFT, RAISE, State
from .batches import put
from .conditions import Conditions
from .kkt_system import Assembled, Step
from .pursuit import CURVATURE

LARGEST_SHIFT = 1e10
CONVEX = 1e2  # a shift that makes the Hessian convex on the null space of the constraints, if these are independent


def regularised(
    conditions: Conditions,
    iterate: Iterate,
    assembled: Assembled,
    shift: np.ndarray,
    keep: np.ndarray,
    loose: np.ndarray,
) -> tuple[Step, np.ndarray, np.ndarray]:
    """Steps with the smallest tried shift of the Hessians that makes them descend; and whether they do.

    Where ``keep`` the shift that came is used as it is, and where ``loose`` positive curvature is enough.
    """
    step, curvature, size = conditions.eliminate(iterate, assembled, shift)
    descends = (curvature >= CURVATURE * size) & (step.convex | (shift >= CONVEX) | loose)
    while True:
        going = ~(descends | keep) & (shift < LARGEST_SHIFT)
        if not going.any():
            return step, shift, descends
        shift = np.where(going, np.maximum(RAISE * shift, FIRST_SHIFT), shift)
        places = np.flatnonzero(going)
        part = conditions if len(places) == len(going) else conditions.of(places)
        own, kept = taken((iterate, assembled), places)
        again, curvature, size = part.eliminate(own, kept, shift[places])
        step = put(step, places, again)
        convex = again.convex | (shift[places] >= CONVEX) | loose[places]
        descends[places] = (curvature >= CURVATURE * size) & convex


def solvable(state: State) -> np.ndarray:
    """Whether the step of each member is finite, with a shift that is not too large."""
    return state.step.finite & (state.shift < LARGEST_SHIFT)
