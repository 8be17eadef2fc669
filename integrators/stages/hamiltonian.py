"""The stage of Hamilton's equations, on the Pontryagin bundle TQ + T*Q."""

from collections.abc import Callable
from typing import Any, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from ...manifolds import Manifold
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient, Frame
from ...retractions import DiscretizationMap
from ..problem.user_functions import real_number
from .stage import Stage, phase_sizes

Hamiltonian = Callable[[Any, Any], Any]
Unknowns = tuple[Ambient, Ambient, Ambient]


@final
class HamiltonianStage(Stage):
    r"""The stage of Hamilton's equations under a discretization map, with unknowns ``y = (x, v, pi)``.

    Parameters
    ----------
    hamiltonian : callable
        ``H(q, p)``; all unknowns have the shape of a point.
    discretization : DiscretizationMap
        The map :math:`R_d = (R_1, R_2)`.
    step : float
        The step ``h``.

    Notes
    -----
    The generating function is
    :math:`S = \langle p_1, R_2(x, v) \rangle - \langle p_0, R_1(x, v) \rangle - \langle \pi, v \rangle + h H(x, \pi)`.
    If it is stationary, :math:`v = h\, \partial H / \partial p`, ``pi`` is the covector of the lifted map, and the step
    is :math:`(q_0, p_0; q_1, p_1) = R_d^{T^*}(h X_H(x, \pi))`.

    Examples
    --------
    >>> method = SymplecticIntegrator(CotangentLift(Midpoint(Addition(Euclidean(1)))))
    >>> type(method.stage(lambda q, p: p @ p / 2, 0.1)).__name__
    'HamiltonianStage'
    """

    hamiltonian: Hamiltonian
    discretization: DiscretizationMap
    step: ArrayLike

    def energy(self, q: Ambient, p: Ambient) -> Array:
        """The Hamiltonian ``H(q, p)``, a real number.

        Parameters
        ----------
        q, p : point, covector
            The state.
        """
        return real_number("the Hamiltonian", self.hamiltonian(q, p))

    @property
    def manifold(self) -> Manifold:
        return self.discretization.manifold

    @property
    def dimension(self) -> int:
        return 3 * self.manifold.dimension

    def frame(self, y: Unknowns) -> Frame:
        return self.manifold.basis(y[0])

    def move(self, y: Unknowns, frame: Frame, d: Array) -> Unknowns:
        x, v, pi = y
        dx, dv, dpi = (vec.combine(frame, part) for part in jnp.split(d, 3))
        moved = self.discretization.retraction(x, dx)
        fibre = self.manifold.projection
        return moved, fibre(moved, vec.add(v, dv)), fibre(moved, vec.add(pi, dpi))

    def sizes(self, y: Unknowns, p: Ambient) -> Array:
        position, covector = phase_sizes(self.manifold, self.energy, self.step, *y)
        return jnp.concatenate([position, position, covector, covector])

    def base(self, y: Unknowns) -> Ambient:
        return y[0]

    def ends(self, y: Unknowns) -> tuple[Ambient, Ambient]:
        return self.discretization(y[0], y[1])

    def cost(self, y: Unknowns) -> Array:
        x, v, pi = y
        return vec.pairing(pi, v) - jnp.asarray(self.step) * self.energy(x, pi)

    def predict(self, q0: Ambient, p0: Ambient, previous: Unknowns) -> Unknowns:
        fibre = self.manifold.projection
        velocity = fibre(q0, vec.scale(self.step, vec.gradient(lambda p: self.energy(q0, p), p0)))
        x = self.discretization.retraction(q0, vec.scale(self.discretization.theta, velocity))
        return x, fibre(x, velocity), fibre(x, p0)

    def small_step_inverse(self) -> np.ndarray:
        # At v = 0 and h = 0 the equations are x - theta v = q0, p1 = p0, (1 - theta) p1 + theta p0 = pi and v = 0.
        n, theta = self.manifold.dimension, self.discretization.theta
        blocks = np.array([[1, -theta, 0, 0], [0, 0, 0, 1], [0, 0, -1, 1 - theta], [0, -1, 0, 0]])
        return np.kron(np.linalg.inv(blocks), np.eye(n))
