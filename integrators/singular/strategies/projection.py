"""Projection methods: a step beside the final constraint manifold, then the nearest point of it. Not presymplectic."""

from typing import ClassVar, Self, final

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from ....manifolds import Submanifold
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.root import find_root
from ....retractions import CotangentLift
from ...initial_value.step import StepResult
from ...problem.optimal_control_problem import OptimalControlProblem
from ..integrability import Classification
from .final_dynamics import DynamicsIntegrator, FinalDynamics, Memory
from .strategy import Gauge


@final
class ProjectedIntegrator(DynamicsIntegrator):
    """A lifted step of the dynamics on ``P_f``, moved along the normals of ``P_f`` at its end back to it.

    Keeps ``P_f``, and the order of the step up to 2; it is not symmetric, so compositions for order 4 make order 3 of
    it. It does not preserve ``omega_f``: the defect of a step is of order ``h^3``, and energy drifts. For problems that
    no other strategy integrates.
    """

    presymplectic: ClassVar[bool] = False

    @classmethod
    def suited(cls, classification: Classification, lift: CotangentLift, gauge: Gauge | None) -> tuple[Self, str]:
        reason = "a projection needs P_f only; it is not presymplectic: omega_f changes by O(h^3) a step"
        return cls(lift=lift, dynamics=FinalDynamics.of(classification, gauge)), reason

    def begin(self, system: OptimalControlProblem, q: Ambient, p: Ambient) -> Memory:
        return self.dynamics.begin()

    def unchecked_step(
        self, system: OptimalControlProblem, h: ArrayLike, q: Ambient, p: Ambient, previous: Memory
    ) -> StepResult:
        dynamics = self.dynamics.on(system)
        new, final = dynamics.step(self.lift, h, q, p, previous), dynamics.manifold
        if not isinstance(final, Submanifold):
            return new
        z = new.q, new.p
        normals = final.normals(z)

        def move(c: Array) -> tuple[Ambient, Ambient]:
            return final.parent.restore(vec.add(z, vec.combine(normals, c)))

        root, found = find_root(lambda c: final.equations(move(c)), jnp.zeros(jax.tree.leaves(normals)[0].shape[0]))
        q1, p1 = move(root)
        return new._replace(q=q1, p=p1, converged=new.converged & found)

    def control(self, unknowns: Memory) -> Ambient:
        return unknowns.control
