"""Hamiltonians that are not finite where a step begins that could not be solved: no size of the step changes that."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array

from ...compute.at_points import evaluate_at_each
from ...manifolds.numerics import ambient as vec
from ...manifolds.numerics.ambient import Ambient
from .integrator import Integrator

SMOOTH = "a function that is smooth there, as jnp.sqrt(x @ x + 1e-6) instead of a norm"
AT_START = f"try another start, or {SMOOTH}"
LATER = f"try a smaller step size if the motion should not come there, or {SMOOTH}"


def not_finite_words(
    system: Any, integrator: Integrator, nodes: tuple[Ambient, Ambient], controls: Any, failed: int
) -> tuple[str, str]:
    """Words on a Hamiltonian without finite values or derivatives at the start or at the last node; otherwise empty.

    Step ``failed`` begins at the last node.

    Derivatives at the start count if no step was solved: the motion may leave a place where there are none.
    """

    def at(point: tuple[Ambient, Ambient, Any]) -> tuple[Array, Array]:
        q, p, control = point

        def energy(z: tuple[Ambient, Ambient]) -> Array:
            value = integrator.energy(system, *z, control)
            return jnp.zeros(()) if value is None else value

        return energy((q, p)), ravel_pytree(vec.gradient(energy, (q, p)))[0]

    first = vec.taken(controls, np.s_[:, *integrator.control_times.ndim * (0,)])
    points = *vec.taken(nodes, np.array([0, -1])), vec.taken(first, np.array([0, -1]))
    if not all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(points)):
        return "", ""
    with np.errstate(all="ignore"):
        values, slopes = evaluate_at_each(at, points)
    start, last = (
        _words(values[k], slopes[k], vec.taken(points, k), where)
        for k, where in enumerate(("at the start", "where this step begins"))
    )
    known = np.isfinite(values[0]) and failed > 0
    return ("" if known or not start else f"{start}; {AT_START}"), (last and f"{last}; {LATER}")


def _words(value: np.ndarray, slopes: np.ndarray, point: tuple[Ambient, Ambient, Any], where: str) -> str:
    """Words on values that are not finite at a point, empty if all are finite."""
    q, p, _ = point
    if not np.isfinite(value):
        return f"the Hamiltonian is not finite {where}, at q = {q}, p = {p}: its value is {value:.3g}"
    if not np.all(np.isfinite(slopes)):
        return f"the Hamiltonian has no finite derivatives {where}, at q = {q}, p = {p}: they are {slopes}"
    return ""
