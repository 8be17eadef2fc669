"""The generalised Legendre-Clebsch condition along a singular arc."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....manifolds import Euclidean
from ....manifolds.numerics import ambient as vec
from ...compilation import compiled
from ...problem import OptimalControlProblem
from ...singular import ControlAffineSplitting
from ...singular.strategies.affine import brackets, regular_places
from .segments import Pair

AFFINE = 1e-8  # a control's row of d2H/du2 below this fraction of the largest entry is zero
# A bracket below this fraction of what its differentials allow, or an eigenvalue of the largest, is zero.
VANISHING = 1e-7
NOT_DECIDED = "generalised Legendre-Clebsch condition not decided: "


def second_order(problem: OptimalControlProblem, z: Pair, u: Array) -> str:
    """What the generalised Legendre-Clebsch condition says at nodes ``z`` of an extremal with controls ``u``, in words.

    ``H = H_0 + s . phi`` is to be largest: ``d2H/dw2 < 0`` in the regular controls, ``{phi_a, phi_b} = 0`` [Goh 1966]
    and ``-d/ds (d2/dt2) phi = {phi_a, psi_b}``, ``psi = {phi, H_0}``, negative definite [Kelley, Kopp, Moyer 1967]. It
    is necessary for a minimum, and strictly met it is sufficient on short arcs: conjugate points are not looked for.
    """
    if not isinstance(problem.controls, Euclidean) or np.ndim(u[0]) != 1:
        return NOT_DECIDED + "it is implemented for controls in R^m"
    curvature = np.asarray(_curvatures(problem, z, u))
    rows, size = np.max(np.abs(curvature), axis=(0, 2)), np.max(np.abs(curvature), initial=0.0)
    singular = tuple(int(i) for i in np.flatnonzero(rows <= AFFINE * size))
    if not singular:
        return NOT_DECIDED + "H is affine in none of the controls"
    regular = np.delete(np.delete(curvature, singular, axis=1), singular, axis=2)
    among, across, *bounds = (np.asarray(part) for part in _brackets(ControlAffineSplitting(problem, singular), z, u))
    scale, (bound, mixed_bound) = np.max(np.abs(across), initial=0.0), (np.max(part) for part in bounds)
    if regular.size and np.max(np.linalg.eigvalsh(regular)) > VANISHING * size:
        return "Legendre's condition fails in the regular controls: not a minimum"
    if np.max(np.abs(among)) > VANISHING * bound:
        largest = np.max(np.abs(among))
        return (
            f"Goh's condition fails: the primary constraints do not commute (brackets up to {largest:.3g}); "
            "not a minimum"
        )
    values = np.linalg.eigvalsh((across + np.swapaxes(across, 1, 2)) / 2)
    if not scale or np.max(np.abs(values)) <= VANISHING * mixed_bound:
        return NOT_DECIDED + "the arc is of higher order, or a control is gauge"
    worst = float(np.max(values))
    if worst > VANISHING * scale:
        return (
            f"generalised Legendre-Clebsch condition fails (largest eigenvalue {worst:.3g}, expected < 0): not "
            "a minimum"
        )
    if worst > -VANISHING * scale:
        return f"generalised Legendre-Clebsch condition met, not strictly (largest eigenvalue {worst:.3g})"
    return (
        f"strict generalised Legendre-Clebsch condition met (largest eigenvalue {worst:.3g}); conjugate points "
        "not looked for"
    )


@compiled
def _curvatures(problem: OptimalControlProblem, z: Pair, u: Array) -> Array:
    return jax.vmap(lambda q, p, u: jax.hessian(lambda u: problem.hamiltonian(q, p, u))(u))(*z, u)


@compiled
def _brackets(split: ControlAffineSplitting, z: Pair, u: Array) -> tuple[Array, Array, Array, Array]:
    """``{phi_a, phi_b}`` and ``{phi_a, psi_b}`` at every node, with the products of the sizes of the differentials in
    them."""

    def one(node: tuple[Pair, Array]) -> tuple[Array, Array, Array, Array]:
        z, w = node[0], node[1][regular_places(len(node[1]), split.singular)]
        constraints = split.primary, lambda q, p: split.secondary(q, p, w)
        first, second = (vec.size(jax.jacrev(lambda z, f=f: f(*z))(z)) for f in constraints)
        phi, psi = split.fields(z, w)
        return brackets(phi, phi).values, brackets(phi, psi).values, first * first, first * second

    return jax.lax.map(one, jax.tree.map(jnp.asarray, (z, u)))
