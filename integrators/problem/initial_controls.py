"""Controls to begin from."""

from typing import TYPE_CHECKING

import jax
import numpy as np

from ...manifolds import Euclidean, Manifold
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.numerics.precision import working_precision
from .free_quantities import guess_inside

if TYPE_CHECKING:
    from .path_constraints import Inequalities

DISTANCE_FROM_BOUND = 0.1  # of the size of a bound, or of the room between both: how far inside a control is


def resting_control(controls: Manifold) -> Ambient:
    """A point of the control manifold to begin from: zero in Euclidean space, a fixed random point elsewhere."""
    return (
        np.zeros(controls.shape, working_precision())
        if isinstance(controls, Euclidean)
        else controls.random_point(jax.random.key(0))
    )


def within_bounds(limits: "Inequalities", u: Ambient) -> Ambient:
    """The control, moved strictly inside the bounds of the controls if there are any."""
    if not limits.lower:
        return u
    flat = guess_inside(np.ravel(np.asarray(u)), np.array(limits.lower), np.array(limits.upper), DISTANCE_FROM_BOUND)
    return flat.reshape(np.shape(u)).astype(np.asarray(u).dtype)
