"""How much of a two-form a step preserves."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool

from ...manifolds import ConvergenceError, PresymplecticManifold
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient, is_traced
from ...manifolds.symplectic import form_matrix
from ..compilation import compiled
from .integrator import Integrator

Pair = tuple[Ambient, Ambient]


def symplecticity_defect(
    space: PresymplecticManifold, integrator: Integrator, system: object, z: Pair, h: ArrayLike
) -> Array:
    """Largest entry of ``F_h^* omega - omega`` at ``z``, for one step ``F_h``, in an orthonormal basis of ``T_zP``.

    ``space``: the manifold ``P`` in ``T*Q``, on which the step starts and ends, with its form, as
    ``classify(problem).presymplectic``. ``h``: the length of the step, or an array of lengths, of whose shape the
    result is. Rounding for a presymplectic integrator, of some order in ``h`` for any other. Measure on a ``P`` that is
    curved and has more than two dimensions: elsewhere other methods may look exact.

    Raises ``InvalidInputError`` as ``integrate`` does, and ``ConvergenceError`` if a step cannot be solved.
    """
    integrator.check(system, *z)
    sizes = jnp.asarray(h)
    defects, solved = _defects(space, integrator, system, z, sizes)
    if not is_traced(solved) and not np.all(solved):
        size = np.asarray(sizes)[~np.asarray(solved)].ravel()[0]
        raise ConvergenceError(
            f"the equations of a step of {size:.6g} from {z} have no solution near it; take a smaller one"
        )
    return defects


@compiled
def _defects(
    space: PresymplecticManifold, integrator: Integrator, system: object, z: Pair, sizes: Array
) -> tuple[Array, Bool[Array, " ..."]]:
    """The defects of steps of these lengths, and whether the steps are solved."""
    frame = space.manifold.basis(z)
    before = form_matrix(space.form, z, frame)

    def defect(h: Array) -> tuple[Array, Bool[Array, ""]]:
        def step(z: Pair) -> tuple[Pair, Bool[Array, ""]]:
            new = integrator.step(system, h, *z, integrator.begin(system, *z))
            return (new.q, new.p), new.converged

        end, push, solved = jax.linearize(step, z, has_aux=True)
        return vec.largest(form_matrix(space.form, end, jax.vmap(push)(frame)) - before), solved

    found = jax.lax.map(defect, sizes.ravel())
    return jax.tree.map(lambda each: each.reshape(sizes.shape), found)
