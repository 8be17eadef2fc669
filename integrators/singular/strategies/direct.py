"""The definition of the paper, where it composes into a flow: stages on the final constraint manifold."""

from dataclasses import replace
from typing import Any, ClassVar, Self, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.newton import tolerance
from ....retractions import CotangentLift
from ...compilation import compiled
from ...initial_value.step import StepResult
from ...problem import OptimalControlProblem
from ..integrability import Classification
from .dynamics import DynamicsIntegrator, FinalDynamics, Memory
from .strategy import Gauge, NotApplicableError

TEST_STEP = 0.1  # how far the steps of the test of composability go, relative to the size of the states
TEST_STEPS = 10  # steps from each state: one alone may hide how they leave P_f
COMPOSED = 0.77  # power of the machine epsilon up to which equations of P_f, of order one near it, hold to rounding: 1e-12


@final
class DirectIntegrator(DynamicsIntegrator):
    """``(1/h) (R_d^{T*})^-1 (z, z')`` lies in ``S_f`` over its base point.

    [Barbero-Linan, Martin de Diego, Presymplectic integrators for optimal control problems via retraction maps, Definition 3.]
    The relation is Lagrangian in ``P_{f,d}``. It is a map of ``P_f`` into itself only where the ends of its steps stay on
    ``P_f``, as on an affine ``P_f`` with a theta-method; ``suited`` measures that, and takes nothing but rounding for it.
    """

    presymplectic: ClassVar[bool] = True

    @classmethod
    def suited(cls, classification: Classification, lift: CotangentLift, gauge: Gauge | None) -> Self:
        found = cls(lift=lift, dynamics=FinalDynamics.of(classification, gauge), reason="")
        departure = _departure(found, classification.problem, classification.stratum.states)
        gap, words = float(departure), f"after {TEST_STEPS}"
        if not np.isfinite(gap):
            raise NotApplicableError("a step with its stage in S_f was not found from every point of P_f that was tried")
        if not gap <= tolerance(departure, COMPOSED):
            raise NotApplicableError(f"steps with stages in S_f leave P_f, its equations {gap:.1e} {words}: they do not compose")
        return replace(found, reason=f"steps with stages in S_f stay on P_f (equations to {gap:.0e} {words}), so they compose")

    def begin(self, system: OptimalControlProblem, q: Ambient, p: Ambient) -> Memory:
        return self.dynamics.begin()

    def step(self, system: OptimalControlProblem, h: ArrayLike, q: Ambient, p: Ambient, previous: Memory) -> StepResult:
        return self.dynamics.on(system).step(self.lift, h, q, p, previous)

    def control(self, unknowns: Memory) -> Ambient:
        return unknowns.control


@compiled
def _departure(integrator: DirectIntegrator, problem: OptimalControlProblem, states: Any) -> Array:
    """Largest violation of the equations of ``P_f`` along some steps from each of some points of it (leading axis)."""
    states = jax.tree.map(jnp.asarray, states)
    first = integrator.begin(problem, *jax.tree.map(lambda leaf: leaf[0], states))
    # Of all points together: one that is almost at rest would ask for a step without end.
    speed = jnp.mean(jax.vmap(lambda z: vec.size(problem.velocity(z[0], first.control)))(states))
    h = TEST_STEP * jnp.where(speed > 0, jnp.mean(jax.vmap(vec.size)(states)) / jnp.where(speed > 0, speed, 1.0), 1.0)

    def one(z: tuple[Ambient, Ambient]) -> Array:
        def step(last: tuple[Ambient, Ambient, Memory], _: None) -> tuple[tuple[Ambient, Ambient, Memory], Array]:
            new = integrator.step(problem, h, *last)
            gaps = integrator.dynamics.manifold.violations((new.q, new.p)).values()
            return new[:3], jnp.where(new.converged, jnp.max(jnp.stack(list(gaps))), jnp.nan)

        return jnp.max(jax.lax.scan(step, (*integrator.dynamics.manifold.restore(z), first), length=TEST_STEPS)[1])

    return jnp.max(jax.lax.map(one, states))
