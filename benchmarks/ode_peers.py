"""Peers: two mechanical systems on manifolds, integrated in their embedding with SciPy and diffrax.

Free rigid body, principal moments ``J = diag(1, 2, 3)``, attitude ``R`` in SO(3) and body momentum ``mu``, 12 numbers:

    R' = R hat(w),        mu' = mu x w,        w = J^-1 mu,        R(0) = I,  mu(0) = (1, -0.5, 0.7)

Spherical pendulum of unit mass, length and gravity, ``H = |p|^2 / 2 + q_z`` on T*S^2, 6 numbers:

    q' = p,        p' = -(e_z - q_z q) - |p|^2 q,        q(0) = (1, 0, 0),  p(0) = (0, 0.6, 0.3)

Every quantity is dimensionless. The error of a run is the Euclidean distance of its final state from the reference in
the embedding; the tolerance of a method is the loosest whose error meets the target, found by bisection. For a batch
the error is that of the worst member.
"""

import functools
import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

jax.config.update("jax_enable_x64", True)

BATCH = 1024
SPREAD = 0.1  # relative size of the scatter of the momenta over a batch


@dataclass(frozen=True)
class Problem:
    """A field ``x' = field(*x)`` on numbers or arrays of one shape, its initial state and its constraints.

    ``constraints(x)`` gives the defects of the manifold's equations, and ``energy(x)`` the energy, for states (n, ...).
    ``momentum`` are the positions in the state that a batch scatters; ``tangent`` makes a scattered state admissible.
    """

    name: str
    field: Callable
    initial: np.ndarray
    constraints: Callable
    energy: Callable
    momentum: slice

    def initial_batch(self, size=BATCH, seed=0):
        """Initial states (size, n): the first is ``initial``, the rest have momenta scattered about it."""
        states = np.tile(self.initial, (size, 1))
        moved = states[1:, self.momentum]
        moved += SPREAD * np.linalg.norm(self.initial[self.momentum]) * np.random.default_rng(seed).normal(size=moved.shape)
        return states
