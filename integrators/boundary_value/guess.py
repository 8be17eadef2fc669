"""First guesses of a trajectory."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...retractions import DiscretizationMap
from ..initial_value.integrator import resting_control
from ..problem import OptimalControlProblem


class Guess(NamedTuple):
    """A guess for ``solve``: states and controls at the N stages, and costates at the N + 1 nodes (None: zero).

    Leaves carry the stages or nodes along their leading axis.
    """

    states: Ambient
    controls: Any
    costates: Any = None


def interpolate(
    problem: OptimalControlProblem, discretization: DiscretizationMap, start: Ambient, end: Ambient, steps: int
) -> Guess:
    """Guess on the curve ``s -> R(start, s v)`` with ``R(start, v) = end``, controls at rest.

    Entries are NaN if ``end`` is outside the image of the retraction at ``start``.
    """
    retraction = discretization.retraction
    v = retraction.preimage(start, end)
    times: Array = (jnp.arange(steps) + discretization.theta) / steps
    states = jax.vmap(lambda s: retraction(start, vec.scale(s, v)))(times)
    rest = resting_control(problem.controls)
    return Guess(states, jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (steps, *leaf.shape)), rest))
