"""RATTLE on the final constraint manifold of first-order singular arcs."""

from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from ....manifolds import InvalidInputError, Manifold, NotOnManifoldError
from ....manifolds.manifold import default_tolerance
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.root import find_root
from ....retractions import CotangentLift
from ...initial_value.integrator import Integrator, extremal_control
from ...initial_value.step import StepEquations, StepResult
from ...problem import OptimalControlProblem
from ...stages import ControlStage
from .affine import ControlAffineSplitting, check_splitting, merge_controls
from .leaves import leaf_flow


class _Memory(NamedTuple):
    """Unknowns of the stage, and the singular controls of the last step."""

    stage: Any
    singular: Array


@final
class RattleIntegrator(Integrator):
    """A presymplectic integrator on ``P_f = {phi = 0, psi = 0}`` for controls that enter ``H`` affinely.

    With ``H = H_0 + s . phi`` and ``psi = {phi, H_0}``, one step from ``z`` in ``P_f`` moves along the leaf of ``{phi = 0}``
    through ``z``, takes a cotangent-lifted step of ``H_0`` that lands on ``phi = 0``, and moves along the leaf there to
    ``psi = 0``. Moves along leaves do not change the form pulled back to ``{phi = 0}``: the step preserves ``P_f`` and
    ``omega_f``, is symmetric if the lifted step is, and of its order. Needs ``{phi_a, phi_b} = 0`` and ``{phi_a, psi_b}``
    invertible on ``P_f``.
    [McLachlan, Modin, Verdier, Wilkins, Geometric generalisations of SHAKE and RATTLE, 2014]
    """

    lift: CotangentLift
    singular: tuple[int, ...] = eqx.field(static=True)

    @property
    def manifold(self) -> Manifold:
        return self.lift.discretization.manifold

    @property
    def control_times(self) -> np.ndarray:
        return np.asarray(self.lift.theta)

    def check(self, system: OptimalControlProblem, q: Ambient, p: Ambient) -> None:
        check_splitting(system, self.singular)
        system.check_discretization(self.lift.discretization)
        split = ControlAffineSplitting(system, self.singular)
        curvature, primary, secondary, among, across = jax.device_get(_facts(split, q, p))
        if not np.max(np.abs(curvature)) <= default_tolerance():
            raise InvalidInputError(
                f"Pontryagin's Hamiltonian is not affine in the controls {self.singular}: its second derivative in them reaches "
                f"{np.max(np.abs(curvature)):.3g}, expected 0; name the controls without cost of their own"
            )
        for name, value in (("phi = dH/du", primary), ("psi = {phi, H_0}", secondary)):
            if not np.max(np.abs(value)) <= default_tolerance():
                raise NotOnManifoldError(f"start is not on the constraint manifold: {name} is {value}, expected 0")
        if not np.max(np.abs(among)) <= default_tolerance():
            raise InvalidInputError(f"the brackets of the primary constraints are {among.tolist()}, expected 0")
        values = np.linalg.svd(across, compute_uv=False)
        if not values[-1] > 1e-8 * max(values[0], 1e-300):
            raise InvalidInputError(
                f"the brackets {{phi, psi}} have the singular values {values}, expected all positive: the singular arc is of "
                "higher order, or a control is gauge"
            )

    def begin(self, system: OptimalControlProblem, q: Ambient, p: Ambient) -> _Memory:
        regular = ControlAffineSplitting(system, self.singular).regular_problem()
        return _Memory((q, extremal_control(regular, q, p)), jnp.zeros(len(self.singular)))

    def step(self, system: OptimalControlProblem, h: ArrayLike, q: Ambient, p: Ambient, previous: _Memory) -> StepResult:
        split = ControlAffineSplitting(system, self.singular)
        m = len(self.singular)
        stage = ControlStage(problem=split.regular_problem(), discretization=self.lift.discretization, step=h)
        predicted = jax.lax.stop_gradient(previous.singular) * h / 2
        begin = leaf_flow(self.manifold, split.primary, (q, p), predicted)
        equations = StepEquations(stage, *begin, previous.stage)

        def residual(c: Array) -> Array:
            departed = leaf_flow(self.manifold, split.primary, (q, p), c[:m])
            return jnp.concatenate([split.primary(*equations.end(c[m:])[:2]) / h, equations.residual(c[m:], *departed)])

        sizes = jnp.concatenate([jnp.ones(m), equations.sizes])
        root, landed = find_root(residual, jnp.concatenate([predicted, equations.first]), sizes)
        q1, p1, unknowns = equations.end(root[m:])
        q1 = self.manifold.restore(q1)
        arrived = q1, self.manifold.projection(q1, p1)

        def to_secondary(t: Array) -> Array:
            return split.secondary(*leaf_flow(self.manifold, split.primary, arrived, t))

        last, found = find_root(to_secondary, root[:m])
        q2, p2 = leaf_flow(self.manifold, split.primary, arrived, last)
        return StepResult(q2, p2, _Memory(unknowns, (root[:m] + last) / h), landed & found)

    def control(self, unknowns: _Memory) -> Array:
        return merge_controls(unknowns.stage[1], unknowns.singular, self.singular)


@eqx.filter_jit
def _facts(split: ControlAffineSplitting, q: Ambient, p: Ambient) -> tuple[Array, ...]:
    """Second derivatives of H in the singular controls, the constraints, and their brackets."""
    problem = split.problem
    u = problem.controls.random_point(jax.random.key(0))
    curvature = jax.hessian(lambda u: problem.hamiltonian(q, p, u))(u)[np.asarray(split.singular)]
    return curvature, split.primary(q, p), split.secondary(q, p), *split.brackets((q, p))
