"""Controls to begin from."""

import jax
import numpy as np

from ..manifolds import Euclidean, Manifold
from ..manifolds.numerics.ambient import Ambient
from ..manifolds.numerics.precision import working_precision


def resting_control(controls: Manifold) -> Ambient:
    """A point of the control manifold to begin from: zero in Euclidean space, a fixed random point elsewhere."""
    return (
        np.zeros(controls.shape, working_precision())
        if isinstance(controls, Euclidean)
        else controls.random_point(jax.random.key(0))
    )
