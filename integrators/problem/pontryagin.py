"""Controls of extremals, where ``dH/du = 0``."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ...compute.jit_cache import compile_function
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from ...manifolds.numerics.root import find_root
from .initial_controls import resting_control
from .optimal_control_problem import OptimalControlProblem

RESTING = 1e-3  # of the largest coordinate of a control: one that is smaller is not measured by its own size


@compile_function
def extremal_control(problem: OptimalControlProblem, q: Ambient, p: Ambient) -> Ambient:
    """Control with ``dH/du(q, p, u) = 0`` by Newton's method from the resting control, which is kept if there is none
    near."""
    return find_control(problem, q, p, resting_control(problem.controls))[0]


def find_control(
    problem: OptimalControlProblem, q: Ambient, p: Ambient, near: Ambient
) -> tuple[Ambient, Bool[Array, ""]]:
    """Control with ``dH/du(q, p, u) = 0`` by Newton's method from ``near``, and whether there is one; else ``near``."""
    zero = jnp.zeros(problem.controls.dimension)
    slope = jax.grad(lambda c: problem.hamiltonian(q, p, problem._steer(near, c)))
    root, found = find_root(slope, zero, _control_sizes(problem, q, p, near))
    return problem._steer(near, jnp.where(found, root, zero)), found


def _control_sizes(problem: OptimalControlProblem, q: Ambient, p: Ambient, near: Ambient) -> Array:
    """Sizes of the coordinates of a control, from ``near`` and from the steps that the parts of ``dH/du`` ask for."""
    q, p, near = jax.lax.stop_gradient((q, p, near))

    def size_along(e: Array) -> Array:
        def parts(s: Array) -> Array:
            return jnp.stack(problem._parts(q, p, problem._steer(near, s * e)))

        zero, one = jnp.zeros(()), jnp.ones(())
        slopes, curvatures = jax.jvp(lambda s: jax.jvp(parts, (s,), (one,))[1], (zero,), (one,))
        return jnp.max(jnp.abs(slopes)) / jnp.abs(curvatures[0] - curvatures[1])

    frame = problem.controls.basis(near)
    asked = jax.vmap(size_along)(jnp.eye(problem.controls.dimension))
    own = jnp.maximum(jnp.abs(vec.components(frame, near)), jnp.where(jnp.isfinite(asked), asked, 0.0))
    # A coordinate that rests is as exact as the rounding of others lets it be.
    largest = jnp.maximum(jnp.max(own, initial=0.0), jnp.max(vec.coordinate_sizes(frame, near), initial=0.0))
    return jnp.where(largest > 0, jnp.maximum(own, RESTING * largest), 1.0)
