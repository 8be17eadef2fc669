"""How much of a two-form a step preserves."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool

from ...compute.jit_cache import compile_function
from ...manifolds import ConvergenceError, PresymplecticManifold
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient, is_traced
from ...manifolds.symplectic import form_matrix
from .integrator import Integrator

Pair = tuple[Ambient, Ambient]


def symplecticity_defect(
    space: PresymplecticManifold, integrator: Integrator, system: object, z: Pair, h: ArrayLike
) -> Array:
    r"""The largest entry of :math:`F_h^* \omega - \omega` at ``z``, in an orthonormal basis of :math:`T_zP`.

    Parameters
    ----------
    space : PresymplecticManifold
        The manifold ``P`` in ``T*Q`` with its form, such as ``classify(problem).presymplectic``.
    integrator : Integrator
        The method, whose step is ``F_h``.
    system : callable or OptimalControlProblem
        As in ``integrate``.
    z : tuple of point and covector
        A state on ``P``.
    h : float or array_like
        The step, or an array of steps, of whose shape the result is.

    Returns
    -------
    Array
        The defect: rounding for a presymplectic integrator, a power of ``h`` for others.

    Raises
    ------
    InvalidInputError
        As ``integrate``.
    ConvergenceError
        If a step cannot be solved.

    Notes
    -----
    Measure on a ``P`` that is curved and has more than two dimensions; elsewhere other methods may look exact.
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


@compile_function
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
