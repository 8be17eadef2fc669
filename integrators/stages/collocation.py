"""The stage of a collocation method: Hamilton's equations, or Pontryagin's, at several points of a step."""

from collections.abc import Callable
from typing import Any, NamedTuple, Self, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from ...manifolds import Euclidean, Manifold
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient, Frame
from ...retractions import CollocationMethod, default_retraction
from ..problem.optimal_control_problem import OptimalControlProblem
from ..problem.user_functions import real_number
from .hamiltonian import Hamiltonian
from .stage import Stage, first_sizes, phase_sizes


class CollocationUnknowns(NamedTuple):
    """Centre of a step; for each of its points, along a leading axis, displacement, covector (both at the centre),
    control.

    A displacement is the velocity in the chart times the step, a covector stands for its projection at its point.
    """

    centre: Ambient
    displacements: Frame
    covectors: Frame
    controls: Ambient


@final
class CollocationStage(Stage):
    r"""The stage of a collocation method, with unknowns ``y = (x, w_1..w_s, pi_1..pi_s, u_1..u_s)``.

    Parameters
    ----------
    hamiltonian : callable
        ``H(q, p, u)``; all unknowns have the shape of a point, or of a control.
    controls : Manifold
        The controls, ``Euclidean(0)`` for a Hamiltonian system.
    method : CollocationMethod
        The collocation.
    step : float
        The step ``h``.

    Notes
    -----
    With the points :math:`q_i = R_x(\sum_j (a_{ij} - b_j/2) w_j)` and :math:`v_i = D R_x[w_i]` there, and
    :math:`\eta = \sum_j b_j w_j`, the generating function of a step is

    .. math::
        S = \langle p_1, R_x(\eta/2) \rangle - \langle p_0, R_x(-\eta/2) \rangle
        - \sum_i b_i (\langle \pi_i, v_i \rangle - h H(q_i, \pi_i, u_i)).

    It is stationary in :math:`\pi_i` if the collocation :math:`v_i = h\, \partial H / \partial p` holds, and in
    :math:`u_i` if Pontryagin's :math:`\partial H / \partial u = 0` holds. In ``x`` and :math:`w_i` these are the
    costate equations; :math:`\pi_i` are the costates at the points.

    Examples
    --------
    >>> method = SymplecticIntegrator(Gauss(2, Addition(Euclidean(1))))
    >>> type(method.stage(lambda q, p: p @ p / 2, 0.1)).__name__
    'CollocationStage'
    """

    hamiltonian: Callable[[Any, Any, Any], Array]
    controls: Manifold
    method: CollocationMethod
    step: ArrayLike

    @classmethod
    def of_hamiltonian(cls, hamiltonian: Hamiltonian, method: CollocationMethod, step: ArrayLike) -> Self:
        """The stage of Hamilton's equations for ``H(q, p)``.

        Parameters
        ----------
        hamiltonian, method, step
            As in the class, with ``H(q, p)``.
        """

        def energy(q: Ambient, p: Ambient, u: Ambient) -> Array:
            return real_number("the Hamiltonian", hamiltonian(q, p))

        return cls(hamiltonian=energy, controls=Euclidean(0), method=method, step=step)

    @classmethod
    def of_problem(cls, problem: OptimalControlProblem, method: CollocationMethod, step: ArrayLike) -> Self:
        """The stage of an optimal control problem.

        Parameters
        ----------
        problem : OptimalControlProblem
            The problem.
        method, step
            As in the class.
        """
        return cls(hamiltonian=problem.hamiltonian, controls=problem.controls, method=method, step=step)

    @property
    def manifold(self) -> Manifold:
        return self.method.manifold

    @property
    def _h(self) -> Array:
        """The step as a number, where it is given as an array of one entry too."""
        return jnp.reshape(jnp.asarray(self.step), ())

    @property
    def _sizes(self) -> tuple[int, int, int]:
        """Numbers ``s, n, m`` of points, of coordinates, of controls at a point."""
        return self.method.stages, self.manifold.dimension, self.controls.dimension

    @property
    def dimension(self) -> int:
        s, n, m = self._sizes
        return n + s * (2 * n + m)

    def begin(self, q: Ambient, p: Ambient, u: Ambient) -> CollocationUnknowns:
        """The unknowns of a step that stands still.

        Parameters
        ----------
        q, p, u : point, covector, control
            The state and the control.
        """
        return CollocationUnknowns(q, *map(self._at_points, (vec.zeros(q), p, u)))

    def frame(self, y: CollocationUnknowns) -> tuple[Frame, Any]:
        return self.manifold.basis(y.centre), jax.vmap(default_retraction(self.controls).frame)(y.controls)

    def move(self, y: CollocationUnknowns, frame: tuple[Frame, Any], d: Array) -> CollocationUnknowns:
        s, n, m = self._sizes
        (basis, charts), turn = frame, default_retraction(self.controls)
        dx, dw, dpi, du = jnp.split(d, np.cumsum([n, s * n, s * n]))
        x = self.method.retraction(y.centre, vec.combine(basis, dx))

        def move_frame(vectors: Frame, change: Array) -> Frame:
            changed = vec.add(vectors, vec.combine_each(basis, change.reshape(s, n)))
            return jax.vmap(lambda v: self.manifold.projection(x, v))(changed)

        u = jax.vmap(turn.chart)(y.controls, charts, du.reshape(s, m))
        return CollocationUnknowns(x, move_frame(y.displacements, dw), move_frame(y.covectors, dpi), u)

    def sizes(self, y: CollocationUnknowns, p: Ambient) -> Array:
        s, _, _ = self._sizes
        ahead, last, control = (vec.entries(part, -1) for part in y[1:])

        def energy(q: Ambient, p: Ambient) -> Array:
            return self.hamiltonian(q, p, control)

        position, covector = phase_sizes(self.manifold, energy, self._h, y.centre, ahead, last)
        turns = jax.vmap(lambda u: first_sizes(vec.coordinate_sizes(self.controls.basis(u), u)))(y.controls)
        return jnp.concatenate([jnp.tile(position, 1 + s), jnp.tile(covector, s), turns.ravel(), covector])

    def base(self, y: CollocationUnknowns) -> Ambient:
        return y.centre

    def ends(self, y: CollocationUnknowns) -> tuple[Ambient, Ambient]:
        return self.method.retraction.both_ways(
            y.centre, vec.combine(y.displacements, jnp.asarray(self.method.weights) / 2)
        )

    def cost(self, y: CollocationUnknowns) -> Array:
        def rate(xi: Ambient, w: Ambient, pi: Ambient, u: Ambient) -> Array:
            q, v = jax.jvp(lambda a: self.method.retraction(y.centre, a), (xi,), (w,))
            return vec.pairing(pi, v) - self._h * self.hamiltonian(q, self.manifold.projection(q, pi), u)

        rates = jax.vmap(rate)(self._to_points(y.displacements), y.displacements, y.covectors, y.controls)
        return rates @ self.method.weights

    def predict(self, q0: Ambient, p0: Ambient, previous: CollocationUnknowns) -> CollocationUnknowns:
        u = vec.entries(previous.controls, -1)
        velocity = self.manifold.projection(q0, vec.gradient(lambda p: self.hamiltonian(q0, p, u), p0))
        ahead = vec.scale(self._h, velocity)
        x = self.method.retraction(q0, vec.scale(self.method.theta, ahead))
        fibre = self.manifold.projection
        return CollocationUnknowns(x, *map(self._at_points, (fibre(x, ahead), fibre(x, p0), u)))

    def small_step_inverse(self) -> np.ndarray | None:
        s, n, m = self._sizes
        if m:
            return None  # the block of the controls depends on the problem
        # At w = 0 and h = 0 the equations are x - b'w/2 = q0, p1 = p0, b_i (p0 + p1)/2 = b_i pi_i and b_i w_i = 0.
        b, none = self.method.weights, np.zeros
        rows = [
            np.block([[1.0, -b / 2, none(s), 0.0]]),
            np.block([[0.0, none(2 * s), 1.0]]),
            np.block([[none((s, 1 + s)), -np.diag(b), b[:, None] / 2]]),
            np.block([[none((s, 1)), -np.diag(b), none((s, s + 1))]]),
        ]
        return np.kron(np.linalg.inv(np.concatenate(rows)), np.eye(n))

    def _at_points(self, a: Ambient) -> Frame:
        """``a`` for each of the points."""
        return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (self.method.stages, *jnp.shape(leaf))), a)

    def _to_points(self, displacements: Frame) -> Frame:
        """The tangent vectors at the centre that lead to the points."""
        return vec.combine_each(displacements, jnp.asarray(self.method.centred))
