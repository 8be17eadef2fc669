"""The abstract integrator on the final constraint manifold, and the refusal of one that does not apply."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Self

import equinox as eqx
from jaxtyping import Array, ArrayLike

from ....manifolds import InvalidInputError, NotOnManifoldError
from ....manifolds.numerics.ambient import Ambient
from ....retractions import CotangentLift
from ...initial_value.integrator import LiftedIntegrator
from ...initial_value.step import StepResult
from ...problem.optimal_control_problem import OptimalControlProblem
from ..integrability import AffineHull, Classification

Gauge = Callable[[Array, Any, Any], Any]


class NotApplicableError(InvalidInputError):
    """A strategy cannot integrate a problem; the message says why."""


class SingularIntegrator(LiftedIntegrator):
    """A method for the extremals of a singular problem on its final constraint manifold ``P_f``: a base class.

    Parameters
    ----------
    hull : AffineHull, optional
        The affine space of the piece of ``P_f``; a step that leaves it is not solved.

    Notes
    -----
    ``presymplectic``: whether the method preserves the form ``omega_f`` of ``P_f``. ``keeps_nodes``: whether its nodes
    lie on ``P_f``, not at a distance :math:`O(h^2)`. ``meets_stages``: whether ``dH/du = 0`` holds at the stage of each
    step.
    """

    hull: AffineHull | None = eqx.field(default=None, kw_only=True)
    presymplectic: ClassVar[bool]
    keeps_nodes: ClassVar[bool] = True
    meets_stages: ClassVar[bool] = False

    def energy(self, system: OptimalControlProblem, q: Ambient, p: Ambient, control: Any) -> Array:
        return system.hamiltonian(q, p, control)

    @abstractmethod
    def unchecked_step(
        self, system: OptimalControlProblem, h: ArrayLike, q: Ambient, p: Ambient, previous: Any
    ) -> StepResult:
        """The step, which may lead to another piece of ``P_f``.

        Parameters
        ----------
        system, h, q, p, previous
            As in ``step``.
        """

    def step(self, system: OptimalControlProblem, h: ArrayLike, q: Ambient, p: Ambient, previous: Any) -> StepResult:
        new = self.unchecked_step(system, h, q, p, previous)
        if self.hull is None:
            return new
        # Of a problem with other data, from a point of its own, nothing is said.
        left = self.hull.holds((q, p)) & ~self.hull.holds((new.q, new.p))
        return new._replace(converged=new.converged & ~left)

    def check(self, system: Any, q: Ambient, p: Ambient) -> None:
        if self.hull is not None and not self.hull.holds((q, p)):
            raise NotOnManifoldError(
                f"start is not on the piece of P_f that the integrator is for: its equations are {self.hull((q, p))}, "
                "expected 0; classification.manifold.nearby((q, p)) is a point of it, and classification.choose(i) "
                "another piece"
            )

    def hint(self, system: Any, first: tuple[Ambient, Ambient], last: tuple[Ambient, Ambient]) -> str:
        met = "" if self.hull is None else ", or the piece of P_f that the integrator is for meets another one"
        return (
            " Or the extremal leaves the regular part of P_f: the bracket {phi, psi}, which determines the singular "
            f"controls, tends to zero there, and they grow without bound{met}; then the arc ends near this time, "
            "whatever the step size."
        )

    @classmethod
    @abstractmethod
    def suited(cls, classification: Classification, lift: CotangentLift, gauge: Gauge | None) -> tuple[Self, str]:
        """The integrator of this kind for a classified problem, and the reason; raises ``NotApplicableError``
        without one.

        Parameters
        ----------
        classification : Classification
            The classified problem.
        lift : CotangentLift
            The lift of a discretization map.
        gauge : callable or None
            As in ``singular_integrator``.
        """
