"""Nonholonomic integrators: impulses of the constraint forces at the nodes, a cotangent-lifted step between them."""

from typing import NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from ...compute.jit_cache import compile_function
from ...index_bounds import require_indices
from ...manifolds import InvalidInputError, NotOnManifoldError
from ...manifolds.bundles import same_manifold
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.numerics.precision import default_tolerance
from ...manifolds.numerics.rank import is_regular, pivotal_values
from ...manifolds.numerics.root import find_root
from ...retractions import CotangentLift
from ..initial_value import LiftedIntegrator
from ..initial_value.integrator import check_hamiltonian
from ..initial_value.step import StepEquations, StepResult
from ..problem.user_functions import real_number
from ..problem_checks.smoothness.derivative_check import require_correct_hamiltonian_derivatives
from ..problem_checks.smoothness.step_primitives import program_of
from ..stages import HamiltonianStage
from .dirac_system import DiracSystem, Multipliers


class _Memory(NamedTuple):
    """The impulse at the end of a step and the multipliers, the mean constraint force over it."""

    impulse: Array
    multipliers: Array


@final
class DiracIntegrator(LiftedIntegrator):
    r"""An integrator of nonholonomic systems, with impulses of the constraint forces at both nodes of a step.

    Parameters
    ----------
    lift : CotangentLift
        The lift of a discretization map, such as ``CotangentLift(Midpoint(R))``.

    Notes
    -----
    A step is :math:`\Lambda \circ F_h \circ \Lambda` with the impulses :math:`\Lambda`:

    .. math::
        p_0^+ = p_0 + r_{0a} \mu^a(q_0), \quad (q_0, p_0^+; q_1, p_1^-) = R_d^{T^*}(h X_H(x, \pi)), \quad
        p_1 = p_1^- + r_{1a} \mu^a(q_1).

    ``r_0`` makes the velocity ``v / h`` of the stage satisfy the constraints at its base point ``x``, and ``r_1`` the
    velocity of the end node the constraints at ``q_1``. These are the discrete Lagrange-d'Alembert equations.
    Constraint forces at the stage would leave the nodes off the constraints by :math:`O(h^2)`.

    The method preserves the constraints at nodes and stages. With an equivariant map it preserves the momentum of a
    symmetry whose generator satisfies the constraints with ``c = 0``. With a symmetric map it is reversible and of
    order 2, and of order 4 by composition. The energy error is :math:`O(h^2)`: bounded if the motion is reversible and
    integrable, otherwise it may drift.

    The ``controls`` of a trajectory are the multipliers ``lambda``, averaged over each step.

    References
    ----------
    Cortés, Martínez, Nonlinearity 14, 2001. Modin, Verdier, Numer. Math. 145, 2020.
    """

    lift: CotangentLift

    def __check_init__(self) -> None:
        if not isinstance(self.lift, CotangentLift):
            raise InvalidInputError(
                f"DiracIntegrator takes a cotangent lift, got {self.lift!r}; try CotangentLift(Midpoint(...))"
            )

    def energy(self, system: DiracSystem, q: Ambient, p: Ambient, control: Multipliers) -> Array:
        return real_number("the Hamiltonian", system.hamiltonian(q, p))

    @property
    def control_times(self) -> np.ndarray:
        return np.asarray(0.5)

    def check(self, system: DiracSystem, q: Ambient, p: Ambient) -> None:
        if not isinstance(system, DiracSystem):
            raise InvalidInputError(f"DiracIntegrator integrates a DiracSystem, got {system!r}")
        if not same_manifold(system.manifold, self.manifold):
            raise InvalidInputError(
                f"the lift acts on {self.manifold}, the system on {system.manifold}; use one manifold"
            )
        _check_shapes(system, q, p)
        require_correct_hamiltonian_derivatives(system.hamiltonian, self.retraction, q, p)
        require_indices(program_of(system.constraint, q, p), "a function of the constraints")
        residual, mobility, parts = jax.device_get(_facts(system, q, self.manifold.projection(q, p)))
        if not (np.all(np.isfinite(mobility)) and np.all(np.isfinite(residual))):
            raise InvalidInputError(
                f"the constraints and their derivatives along the forms are {residual} and {mobility} at the start, "
                "expected finite numbers: give a smooth Hamiltonian, or one whose controls dH/du = 0 determines"
            )
        values = pivotal_values(mobility)
        if not is_regular(values):
            raise InvalidInputError(
                f"the matrix <mu^a, H_pp mu^b> has the singular values {values} in units of its diagonal at the start, "
                "expected all positive: give independent one-forms"
            )
        if not np.all(np.abs(residual) <= default_tolerance() * parts):
            raise NotOnManifoldError(
                f"start violates the constraints: <mu^a, dH/dp> - c^a is {residual}, expected 0; try system.project(q, "
                "p)"
            )

    def begin(self, system: DiracSystem, q: Ambient, p: Ambient) -> _Memory:
        nothing = jnp.zeros_like(system.constraint(q, vec.zeros(q)))
        return _Memory(nothing, nothing)

    def step(self, system: DiracSystem, h: ArrayLike, q: Ambient, p: Ambient, previous: _Memory) -> StepResult:
        stage = HamiltonianStage(hamiltonian=system.hamiltonian, discretization=self.lift.discretization, step=h)
        predicted = jax.lax.stop_gradient(previous.impulse)
        m = predicted.size
        equations = StepEquations.near(stage, q, system.kick(q, p, predicted), None)

        def residual(c: Array) -> Array:
            x, v, _ = equations.end(c[m:])[2]
            allowed = system.constraint(x, vec.scale(1 / h, v))
            return jnp.concatenate([allowed, equations.residual(c[m:], q, system.kick(q, p, c[:m]))])

        impulses = system.impulse_sizes(q, p, h)
        sizes = jnp.concatenate([impulses, equations.sizes])
        root, landed = find_root(residual, jnp.concatenate([predicted, equations.first]), sizes)
        q1, p1, _ = equations.end(root[m:])
        q1 = self.manifold.restore(q1)
        last, found = system.impulse(q1, p1, root[:m], impulses)
        p1 = system.kick(q1, p1, last)
        memory = _Memory(last, (root[:m] + last) / h)
        begun = equations.begins(root[m:], q)
        return StepResult(q1, p1, memory, landed & begun & found & jnp.isfinite(vec.size((q1, p1))))

    def control(self, unknowns: _Memory) -> Multipliers:
        return unknowns.multipliers


def _check_shapes(system: DiracSystem, q: Ambient, p: Ambient) -> None:
    """Raise if a function of the system returns something of the wrong structure."""
    check_hamiltonian(system.hamiltonian, q, p)
    forms = jax.eval_shape(system.forms, q)
    counts = {leaf.shape[:1] for leaf in jax.tree.leaves(forms)}
    single = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), forms)
    wrong = system.manifold.describe_mismatch(single, "each of the forms, a covector")
    if wrong or len(counts) != 1:
        raise InvalidInputError(
            f"forms(q) must return m covectors with a leading axis on every array, got {forms}: {wrong}"
        )
    if system.rates is not None:
        rates, (count,) = jax.eval_shape(system.rates, q), counts
        if getattr(rates, "shape", None) != count:
            raise InvalidInputError(
                f"rates(q) must return one number for each of the {count[0]} one-forms, got {rates}"
            )


@compile_function
def _facts(system: DiracSystem, q: Ambient, p: Ambient) -> tuple[Array, Array, Array]:
    """The constraints at ``(q, p)``, their derivatives along impulses there, and the sizes of their parts."""

    v, nothing = system.velocity(q, p), jnp.zeros_like(system.constraint(q, p))
    residual = system.constraint(q, v)
    parts = jax.vmap(lambda form: vec.size(form) * vec.size(v))(system.forms(q))
    if system.rates is not None:
        parts = jnp.maximum(parts, jnp.abs(system.rates(q)))
    return residual, system.mobility(q, p, nothing), parts
