"""Constraints at the stages only: the regular integrator's equations on a singular problem."""

from typing import Any, ClassVar, Self, final

from jaxtyping import ArrayLike

from ....manifolds.numerics.ambient import Ambient
from ....retractions import CotangentLift
from ...initial_value.step import StepResult, lifted_step, restore
from ...problem.optimal_control_problem import OptimalControlProblem
from ...stages import ControlStage
from ..integrability import Classification
from .final_dynamics import DynamicsIntegrator, FinalDynamics
from .strategy import Gauge, NotApplicableError


@final
class StageIntegrator(DynamicsIntegrator):
    """``(1/h) (R_d^{T*})^-1 (z, z')`` lies in ``S_H``: the equations of the boundary-value problem, step by step.

    The primary constraints hold at the stages, and the nodes stay beside ``P_f`` by ``O(h^2)``. The step is a
    symplectic map near ``P_f`` in ``T*Q``. Stable where the primary constraints are second class among themselves, as
    ``p = theta(q)`` is; where their brackets vanish only if the leaves are straight. Unstable for any theta but 1/2.

    As ``h`` goes to 0 a step tends to the reflection in ``P_f`` and not to the identity: a point beside ``P_f`` changes
    sides, for its constraint holds half-way. Compositions of such steps stay of order 2; of pairs,
    ``Composition(Composition(method, (1/2, 1/2)))``, they are of order 4.
    """

    presymplectic: ClassVar[bool] = False
    keeps_nodes: ClassVar[bool] = False
    meets_stages: ClassVar[bool] = True

    @classmethod
    def suited(cls, classification: Classification, lift: CotangentLift, gauge: Gauge | None) -> tuple[Self, str]:
        if classification.gauge_controls:
            raise NotApplicableError(
                "the equations at the stages leave the gauge controls free, and the step with them"
            )
        if classification.k_f_base > 0:
            raise NotApplicableError(
                f"P_f has equations up to level {classification.k_f_base}, and the primary ones alone, at the stages, "
                "make no stable step"
            )
        if lift.theta != 0.5:
            raise NotApplicableError(
                "the deviation of the nodes from P_f grows from step to step unless theta = 1/2, and it is "
                f"{lift.theta}"
            )
        reason = (
            "the primary constraints determine all controls along their motion; they hold at the stages, at "
            "nodes to O(h^2)"
        )
        return cls(lift=lift, dynamics=FinalDynamics.of(classification, gauge)), reason

    def begin(self, system: OptimalControlProblem, q: Ambient, p: Ambient) -> Any:
        return q, self.dynamics.begin().control

    def stage(self, system: OptimalControlProblem, h: ArrayLike) -> ControlStage:
        return ControlStage(problem=system, discretization=self.lift.discretization, step=h)

    def unchecked_step(
        self, system: OptimalControlProblem, h: ArrayLike, q: Ambient, p: Ambient, previous: Any
    ) -> StepResult:
        return restore(self.manifold, lifted_step(self.stage(system, h), q, p, previous))

    def control(self, unknowns: Any) -> Ambient:
        return unknowns[1]
