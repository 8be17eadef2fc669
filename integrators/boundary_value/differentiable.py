"""An extremal as a function of what it is computed for, which JAX differentiates in both modes."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...manifolds import Manifold
from ...manifolds.numerics import ambient as vec
from .sensitivity import Derivative, Sensitivity
from .solution import Solution


class Extremal(NamedTuple):
    """The arrays of a ``Solution`` that have derivatives, as JAX arrays."""

    cost: Any
    states: Any
    costates: Any
    controls: Any


class Given(NamedTuple):
    """What an extremal is a function of; ``None`` where an end is free, and for no parameters."""

    start: Any
    end: Any
    horizon: Any
    parameters: Any


def extremal_of(
    manifold: Manifold, given: Given, solved: Callable[[Given], Solution], sensitivity: Callable[[Solution], Sensitivity]
) -> Extremal:
    """The extremal that ``solved`` finds, with the derivatives of the implicit function theorem.

    Forward mode multiplies by the columns of ``sensitivity``, and reverse mode is its transpose.
    """

    @jax.custom_jvp
    def extremal(given: Given) -> Extremal:
        return _arrays(solved(given))

    def with_tangent(primals: tuple[Given], tangents: tuple[Given]) -> tuple[Extremal, Extremal]:
        solution = solved(*primals)
        return _arrays(solution), _pushed(manifold, solution, sensitivity(solution), *tangents)

    extremal.defjvp(with_tangent)
    return extremal(_numbers(manifold, given))


def _numbers(manifold: Manifold, given: Given) -> Given:
    """All as arrays of floating-point numbers, because whole numbers have no derivatives."""
    real = jnp.zeros(()).dtype

    def point(end: Any) -> Any:
        return jax.tree.map(lambda a: jnp.asarray(a, jnp.promote_types(jnp.result_type(a), real)), end)

    return Given(*map(point, given))


def _arrays(solution: Solution) -> Extremal:
    return Extremal(*(jax.tree.map(jnp.asarray, getattr(solution, name)) for name in Extremal._fields))


def _pushed(manifold: Manifold, solution: Solution, by: Sensitivity, tangent: Given) -> Extremal:
    """The derivative of the extremal along a tangent, to which it is linear."""
    first, last = (jax.tree.map(lambda leaf, k=k: leaf[k], solution.states) for k in (0, -1))
    ends = (vec.components(manifold.basis(q), _filled(v, q)) for q, v in ((first, tangent.start), (last, tangent.end)))
    pairs = [*zip(ends, (by.start, by.end), strict=True), (tangent.horizon, by.horizon)]
    if tangent.parameters is not None:
        derivatives = jax.tree.leaves(by.parameters, is_leaf=lambda leaf: isinstance(leaf, Derivative))
        pairs += zip(jax.tree.leaves(tangent.parameters), derivatives, strict=True)
    found = []
    for name in Extremal._fields:
        parts = [
            jax.tree.map(lambda leaf, v=v: jnp.tensordot(v, jnp.asarray(leaf), jnp.ndim(v)), getattr(own, name)) for v, own in pairs
        ]
        found.append(jax.tree.map(lambda *leaves: sum(leaves[1:], leaves[0]), *parts))
    return Extremal(*found)


def _filled(tangent: Any, point: Any) -> Any:
    """A tangent of an end, zero where that is free."""
    if isinstance(point, tuple):
        given = (None,) * len(point) if tangent is None else tangent
        return tuple(_filled(v, q) for v, q in zip(given, point, strict=True))
    return np.zeros_like(point) if tangent is None else tangent
