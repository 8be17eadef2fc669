"""How much of a two-form a step preserves."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool

from ...manifolds import ConvergenceError, PresymplecticManifold
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient, is_traced
from ...manifolds.symplectic import form_matrix
from ..compilation import compiled
from .integrator import Integrator

Pair = tuple[Ambient, Ambient]


def form_defect(space: PresymplecticManifold, integrator: Integrator, system: object, z: Pair, h: ArrayLike) -> Array:
    """Largest entry of ``F_h^* omega - omega`` at ``z``, for one step ``F_h``, in an orthonormal basis of ``T_zP``.

    ``space``: the manifold ``P`` in ``T*Q``, on which the step starts and ends, with its form, as
    ``classify(problem).presymplectic``. Returns a scalar: rounding for a presymplectic integrator, of some order in
    ``h`` for any other. Measure on a ``P`` that is curved and has more than two dimensions: elsewhere other methods may
    look exact.

    Raises ``InvalidInputError`` as ``integrate`` does, and ``ConvergenceError`` if the step cannot be solved.
    """
    integrator.check(system, *z)
    defect, solved = _defect(space, integrator, system, z, jnp.asarray(h))
    if not is_traced(solved) and not solved:
        raise ConvergenceError(f"the equations of a step of {h} from {z} have no solution near it; take a smaller one")
    return defect


@compiled
def _defect(
    space: PresymplecticManifold, integrator: Integrator, system: object, z: Pair, h: Array
) -> tuple[Array, Bool[Array, ""]]:
    def step(z: Pair) -> tuple[Pair, Bool[Array, ""]]:
        new = integrator.step(system, h, *z, integrator.begin(system, *z))
        return (new.q, new.p), new.converged

    frame = space.manifold.basis(z)
    end, push, solved = jax.linearize(step, z, has_aux=True)
    change = form_matrix(space.form, end, jax.vmap(push)(frame)) - form_matrix(space.form, z, frame)
    return vec.largest(change), solved
