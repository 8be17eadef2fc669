"""The stage of an optimal control problem."""

from typing import Any, final

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from ...manifolds import Manifold
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...retractions import DiscretizationMap, default_retraction
from ..problem.optimal_control_problem import OptimalControlProblem
from .stage import Stage, first_sizes, phase_sizes

Unknowns = tuple[Ambient, Ambient]


@final
class ControlStage(Stage):
    r"""The stage of an optimal control problem under a discretization map, with unknowns ``y = (x, u)``.

    Parameters
    ----------
    problem : OptimalControlProblem
        The problem; ``x`` has the shape of a point, ``u`` of a control.
    discretization : DiscretizationMap
        The map :math:`R_d = (R_1, R_2)`.
    step : float
        The step ``h``.

    Notes
    -----
    The generating function is
    :math:`S(x, u; p_0, p_1) = \langle p_1, R_2(x, hX) \rangle - \langle p_0, R_1(x, hX) \rangle - h p_0 F`, with the
    cost :math:`h p_0 F(x, u)`. The control belongs to the base point ``x``, at time :math:`t_k + \theta h`.

    Examples
    --------
    >>> problem = OptimalControlProblem(Euclidean(1), lambda q, u: u, lambda q, u: u @ u / 2, 1)
    >>> method = PresymplecticIntegrator(CotangentLift(Midpoint(Addition(Euclidean(1)))))
    >>> type(method.stage(problem, 0.1)).__name__
    'ControlStage'
    """

    problem: OptimalControlProblem
    discretization: DiscretizationMap
    step: ArrayLike

    @property
    def manifold(self) -> Manifold:
        return self.discretization.manifold

    @property
    def dimension(self) -> int:
        return self.manifold.dimension + self.problem.controls.dimension

    def frame(self, y: Unknowns) -> tuple[Any, Any]:
        return self.discretization.retraction.frame(y[0]), default_retraction(self.problem.controls).frame(y[1])

    def move(self, y: Unknowns, frame: tuple[Any, Any], d: Array) -> Unknowns:
        retractions = self.discretization.retraction, default_retraction(self.problem.controls)
        x, u = (
            r.chart(*part)
            for r, *part in zip(retractions, y, frame, jnp.split(d, [self.manifold.dimension]), strict=True)
        )
        return x, u

    def sizes(self, y: Unknowns, p: Ambient) -> Array:
        x, u = y

        def energy(q: Ambient, p: Ambient) -> Array:
            return self.problem.hamiltonian(q, p, u)

        position, covector = phase_sizes(self.manifold, energy, self.step, x, self.tangent(y)[1], p)
        return jnp.concatenate(
            [position, first_sizes(vec.coordinate_sizes(self.problem.controls.basis(u), u)), covector]
        )

    def base(self, y: Unknowns) -> Ambient:
        return y[0]

    def tangent(self, y: Unknowns) -> tuple[Ambient, Ambient]:
        """The tangent vector ``(x, h X(x, u))``, the argument of the discretization map.

        Parameters
        ----------
        y : tuple
            The unknowns.
        """
        return y[0], vec.scale(self.step, self.problem.velocity(*y))

    def ends(self, y: Unknowns) -> tuple[Ambient, Ambient]:
        return self.discretization(*self.tangent(y))

    def covector(self, y: Unknowns, p0: Ambient, p1: Ambient) -> Ambient:
        """The covector at the base point, from the covectors at the ends, by the lift of the discretization map.

        Parameters
        ----------
        y : tuple
            The unknowns.
        p0, p1 : covector
            The covectors at the ends.
        """
        x, v = self.tangent(y)
        pull = vec.pullback(lambda w: self.discretization(x, w), v)[1]
        return self.manifold.projection(x, pull((vec.scale(-1.0, p0), p1))[0])

    def cost(self, y: Unknowns) -> Array:
        return jnp.asarray(self.step) * self.problem.cost_rate(*y)

    def predict(self, q0: Ambient, p0: Ambient, previous: Unknowns) -> Unknowns:
        u = previous[1]
        ahead = vec.scale(self.discretization.theta * self.step, self.problem.velocity(q0, u))
        return self.discretization.retraction(q0, ahead), u

    def small_step_inverse(self) -> None:
        return None  # the block of the controls depends on the problem
