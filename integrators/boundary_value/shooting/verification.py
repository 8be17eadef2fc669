"""The conditions of a singular extremal, evaluated at the states, costates and controls that are returned."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Ambient
from ....manifolds.numerics.precision import default_tolerance
from ....manifolds.numerics.tolerances import rounding_of, tolerance
from ...problem.optimal_control_problem import OptimalControlProblem
from ...singular import SingularIntegrator
from ...singular.wording import component_words
from .end_conditions import EndConditions, EndValues

STATIONARY_POWER = 0.57  # of the machine epsilon: dH/du, and the equations of P_f, relative to their parts: 1e-9


class Stationarity(NamedTuple):
    """``dH/du`` of every step, in coordinates of U: at its first node, its stage and its last node, shape ``(3, N,
    m)``.

    ``parts``: the sizes of the terms that it is a sum of.
    """

    values: Array
    parts: Array


def stationarity(problem: OptimalControlProblem, points: tuple[Any, Any, Any], controls: Ambient) -> Stationarity:
    """``dH/du`` with the control of each step at three points ``(q, p)`` of it, with the steps along the leading
    axis."""
    zero = jnp.zeros(problem.controls.dimension)

    def at(z: tuple[Ambient, Ambient], u: Ambient) -> tuple[Array, Array]:
        q, p = z
        velocities = jax.jacfwd(lambda c: problem.velocity(q, problem._steer(u, c)))(zero)

        def slope(x: Ambient, c: Array) -> Array:
            return jax.grad(lambda c: problem.cost_rate(x, problem._steer(u, c)))(c)

        rate, by_state, by_control = slope(q, zero), jax.jacrev(slope)(q, zero), jax.jacfwd(slope, 1)(q, zero)
        power = sum(jnp.tensordot(a, v, a.ndim) for a, v in _pairs(jax.tree.map(jnp.conj, p), velocities)).real
        along = [jnp.max(jnp.abs(v), axis=tuple(range(v.ndim - 1)), initial=0.0) for v in jax.tree.leaves(velocities)]
        # What the slope of the cost is a sum of shows in its derivatives: those of (q + u)^2 do not vanish where q + u
        # = 0.
        terms = [jnp.sum(jnp.abs(s), axis=tuple(range(1, s.ndim))) * vec.size(q) for s in jax.tree.leaves(by_state)]
        terms.append(jnp.abs(by_control) @ jnp.broadcast_to(vec.size(u), zero.shape))
        least = rounding_of(zero)  # of a costate: below it an extremal at p = 0 is rounding
        return power - rate, jnp.maximum(vec.size(p), least) * sum(along) + jnp.abs(rate) + sum(terms)

    return Stationarity(*(jnp.stack(a) for a in zip(*(jax.vmap(at)(z, controls) for z in points), strict=True)))


def _pairs(a: Any, b: Any) -> Iterator[tuple[Any, Any]]:
    return zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)


def find_violation(
    problem: OptimalControlProblem,
    integrator: SingularIntegrator,
    stages: np.ndarray,
    found: Stationarity,
    residual: float,
) -> str:
    """The first claim on the steps of an extremal that is false, in words with what is evaluated; empty if there is
    none.

    ``residual``: the largest violation of the equations of ``P_f`` at the nodes.
    """
    broken = stationarity_violation(problem, stages, found, integrator.meets_stages)
    limit = tolerance(np.asarray(found.values), STATIONARY_POWER)
    if broken or residual <= limit or not integrator.keeps_nodes:
        return broken
    return f"the equations of P_f are violated by {residual:.3g} (relative) at a node, expected 0"


def stationarity_violation(problem: OptimalControlProblem, stages: np.ndarray, found: Stationarity, exact: bool) -> str:
    """Where ``dH/du`` is not zero with the control of a step, in words; empty if it is.

    It vanishes where the control belongs, at the stage or a node; if not ``exact``, of methods whose stage is not that
    of the record, somewhere in the step, and is then no larger than what it varies by over a step.
    """
    values, parts = np.asarray(found.values), np.max(found.parts, axis=(0, 1))
    limit = tolerance(values, STATIONARY_POWER)
    smallest = np.min(np.abs(values), axis=0)
    varies = 0.0 if exact else np.max(np.ptp(values, axis=0), axis=0, initial=0.0)
    excess = np.nan_to_num(smallest - limit * parts - varies, nan=np.inf)
    step, component = np.unravel_index(int(np.argmax(excess)), excess.shape) if excess.size else (0, 0)
    if excess.size and excess[step, component] > 0:
        name = component_words(problem.controls, int(component))
        return (
            f"dH/du is {smallest[step, component]:.3g} in {name} at t = {stages[step]:.6g}, and its parts are "
            f"{parts[component]:.3g}, expected 0"
        )
    return ""


def find_end_violation(conditions: EndConditions, ends: EndValues, states: Ambient, costates: Ambient) -> str:
    """The first boundary condition that is missed relative to the trajectory itself, in words; empty if there is
    none."""
    covector = max((float(np.max(np.abs(leaf))) for leaf in jax.tree.leaves(costates)), default=0.0) / float(
        conditions.unit
    )
    if conditions.problem.terminal_cost is not None:  # p + dPhi = 0 has terms of this size, though both may vanish
        covector = max(covector, 1.0)
    rounding = rounding_of(np.asarray(ends.start))
    for condition, rows in ((conditions.start, ends.start), (conditions.end, ends.end)):
        leaf = row = 0
        leaves = jax.tree.leaves(states)
        for part in condition.parts:
            here, missed = leaves[leaf : leaf + part.leaves], np.asarray(rows)[row : row + part.dimension]
            size = max((float(np.max(np.abs(a), initial=0.0)) for a in here), default=0.0) if part.fixed else covector
            worst = float(np.max(np.abs(missed), initial=0.0))
            if not worst <= max(default_tolerance() * size, rounding):
                kind = "state" if part.fixed else "costate"
                unit = 1.0 if part.fixed else float(conditions.unit)
                return (
                    f"the condition on the {kind} at the {part.name} is missed by {unit * worst:.3g}, and the {kind}s "
                    f"reach {unit * size:.3g}"
                )
            leaf, row = leaf + part.leaves, row + part.dimension
    return ""
