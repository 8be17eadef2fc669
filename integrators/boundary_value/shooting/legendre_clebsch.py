"""The generalised Legendre-Clebsch condition along a singular arc."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....compute.jit_cache import compile_function
from ....manifolds import Euclidean
from ....manifolds.numerics import ambient as vec
from ...problem.optimal_control_problem import OptimalControlProblem
from ...singular.strategies import ControlAffineSplitting
from ...singular.strategies.control_affine_splitting import brackets, regular_places
from ...singular.strategies.hamiltonian_leaf_flow import ambient_field
from .segments import Pair

AFFINE = 1e-8  # a control's row of d2H/du2 below this fraction of the largest entry is zero
# A bracket below this fraction of what its differentials allow, or an eigenvalue of the largest, is zero.
VANISHING_BRACKET = 1e-7
NOT_DECIDED = "generalised Legendre-Clebsch condition not decided: "


def generalised_legendre_clebsch(problem: OptimalControlProblem, z: Pair, u: Array, order: int = 1) -> str:
    """Words on the generalised Legendre-Clebsch condition at nodes ``z`` of an extremal with controls ``u``.

    ``H = H_0 + s . phi`` is to be largest: ``d2H/dw2 < 0`` in the regular controls, ``{phi_a, phi_b} = 0`` [Goh 1966]
    and ``-d/ds (d2/dt2) phi = {phi_a, psi_b}``, ``psi = {phi, H_0}``, negative definite [Kelley, Kopp, Moyer 1967]. It
    is necessary for a minimum, and strictly met it is sufficient on short arcs: conjugate points are not looked for.
    A single control may be singular of a higher ``order`` k, where ``(-1)^k d/du (d/dt)^(2k) dH/du`` is to be negative
    [Kelley, Kopp, Moyer 1967].
    """
    if not isinstance(problem.controls, Euclidean) or np.ndim(u[0]) != 1:
        return NOT_DECIDED + "it is implemented for controls in R^m"
    curvature = np.asarray(_curvatures(problem, z, u))
    rows, size = np.max(np.abs(curvature), axis=(0, 2)), np.max(np.abs(curvature), initial=0.0)
    singular = tuple(int(i) for i in np.flatnonzero(rows <= AFFINE * size))
    if not singular:
        return NOT_DECIDED + "H is affine in none of the controls"
    if order > 1 and curvature.shape[1] == 1:
        return _words(np.asarray(_kelley(problem, z, order))[:, None], f"Kelley's condition of order {order}")
    regular = np.delete(np.delete(curvature, singular, axis=1), singular, axis=2)
    among, across, *bounds = (np.asarray(part) for part in _brackets(ControlAffineSplitting(problem, singular), z, u))
    scale, (bound, mixed_bound) = np.max(np.abs(across), initial=0.0), (np.max(part) for part in bounds)
    if regular.size and np.max(np.linalg.eigvalsh(regular)) > VANISHING_BRACKET * size:
        return "Legendre's condition fails in the regular controls: not a minimum"
    if np.max(np.abs(among)) > VANISHING_BRACKET * bound:
        largest = np.max(np.abs(among))
        return (
            f"Goh's condition fails: the primary constraints do not commute (brackets up to {largest:.3g}); "
            "not a minimum"
        )
    values = np.linalg.eigvalsh((across + np.swapaxes(across, 1, 2)) / 2)
    if not scale or np.max(np.abs(values)) <= VANISHING_BRACKET * mixed_bound:
        return NOT_DECIDED + "the arc is of higher order, or a control is gauge"
    return _words(values, "generalised Legendre-Clebsch condition", scale)


def _words(values: np.ndarray, condition: str, scale: float | None = None) -> str:
    """Words on a condition whose eigenvalues must be negative."""
    worst = float(np.max(values))
    if not np.isfinite(worst):
        return NOT_DECIDED + "the derivatives are not finite"
    clear = VANISHING_BRACKET * (float(np.max(np.abs(values))) if scale is None else scale)
    if worst > clear:
        return f"{condition} fails (largest eigenvalue {worst:.3g}, expected < 0): not a minimum"
    if worst >= -clear:
        return f"{condition} met, not strictly (largest eigenvalue {worst:.3g})"
    return f"strict {condition} met (largest eigenvalue {worst:.3g}); conjugate points not looked for"


@compile_function
def _kelley(problem: OptimalControlProblem, z: Pair, order: int) -> Array:
    """``(-1)^k d/du (d/dt)^(2k) dH/du`` at nodes, of one control in which H is affine, along an arc of order k.

    It is ``(-1)^k {f, phi}`` with ``f = {...{phi, H_0}..., H_0}`` of 2k - 1 brackets: brackets of fewer with ``phi``
    vanish along the arc.
    """
    rest = jnp.zeros(1)

    def primary(q: Any, p: Any) -> Array:
        return jax.grad(lambda u: problem.hamiltonian(q, p, u))(rest)[0]

    def rate(f: Any, energy: Any) -> Any:
        return lambda q, p: jax.jvp(f, (q, p), ambient_field(energy, (q, p)))[1]

    f = primary
    for _ in range(2 * order - 1):
        f = rate(f, lambda q, p: problem.hamiltonian(q, p, rest))
    return (-1) ** order * jax.vmap(rate(f, primary))(*jax.tree.map(jnp.asarray, z))


@compile_function
def _curvatures(problem: OptimalControlProblem, z: Pair, u: Array) -> Array:
    return jax.vmap(lambda q, p, u: jax.hessian(lambda u: problem.hamiltonian(q, p, u))(u))(*z, u)


@compile_function
def _brackets(split: ControlAffineSplitting, z: Pair, u: Array) -> tuple[Array, Array, Array, Array]:
    """``{phi_a, phi_b}`` and ``{phi_a, psi_b}`` at every node, with the products of the sizes of the differentials in
    them."""

    def one(node: tuple[Pair, Array]) -> tuple[Array, Array, Array, Array]:
        z, w = node[0], node[1][regular_places(len(node[1]), split.singular)]
        constraints = split.primary, lambda q, p: split.secondary(q, p, w)
        first, second = (vec.size(jax.jacrev(lambda z, f=f: f(*z))(z)) for f in constraints)
        motion = ambient_field(lambda q, p: split.regular_problem().hamiltonian(q, p, w), z)
        second = jnp.maximum(second, first * vec.size(motion))  # of a gauge control psi vanishes, and its terms do not
        phi, psi = split.fields(z, w)
        return brackets(phi, phi).values, brackets(phi, psi).values, first * first, first * second

    return jax.lax.map(one, jax.tree.map(jnp.asarray, (z, u)))
