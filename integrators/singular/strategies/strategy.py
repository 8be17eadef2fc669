"""The abstract integrator on the final constraint manifold, and the refusal of one that does not apply."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Self

from jaxtyping import Array

from ....manifolds import InvalidInputError
from ....manifolds.numerics.ambient import Ambient
from ....retractions import CotangentLift
from ...initial_value.integrator import LiftedIntegrator
from ...problem import OptimalControlProblem
from ..integrability import Classification

Gauge = Callable[[Array, Any, Any], Any]


class NotApplicableError(InvalidInputError):
    """A strategy cannot integrate a problem; the message says why."""


class SingularIntegrator(LiftedIntegrator):
    """A method for the extremals of a singular problem on its final constraint manifold ``P_f``.

    ``presymplectic`` says whether it preserves the form ``omega_f`` of ``P_f``; ``keeps_nodes`` whether its nodes lie
    on ``P_f``, and not ``O(h^2)`` beside it; ``meets_stages`` whether ``dH/du = 0`` at the stage of each step.
    """

    presymplectic: ClassVar[bool]
    keeps_nodes: ClassVar[bool] = True
    meets_stages: ClassVar[bool] = False

    def energy(self, system: OptimalControlProblem, q: Ambient, p: Ambient, control: Any) -> Array:
        return system.hamiltonian(q, p, control)

    def hint(self, system: Any, first: tuple[Ambient, Ambient], last: tuple[Ambient, Ambient]) -> str:
        return (
            " Or the extremal leaves the regular part of P_f: the bracket {phi, psi}, which determines the singular "
            "controls, tends to zero there, and they grow without bound; then the arc ends near this time, whatever "
            "the step size."
        )

    @classmethod
    @abstractmethod
    def suited(cls, classification: Classification, lift: CotangentLift, gauge: Gauge | None) -> tuple[Self, str]:
        """The integrator of this kind for a classified problem, and why it applies.

        Raises ``NotApplicableError`` if there is none.
        """
