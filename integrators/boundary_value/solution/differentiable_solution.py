"""An extremal as a function of what it is computed for, which JAX differentiates in both modes."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import eval_context

from ....manifolds import InvalidInputError, Manifold
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import is_transformed
from ...problem.free_quantities import is_free
from ...reporting.text import brief
from ..inputs.arguments import BoundaryData
from .record import Solution
from .sensitivity import Derivative, Sensitivity

INSTEAD = "solver.extremal, which has derivatives, or solver.solve_many, which takes batches"


class DifferentiableSolution(NamedTuple):
    """The arrays of a ``Solution`` that have derivatives, as JAX arrays; ``Solver.extremal`` returns them.

    Attributes
    ----------
    cost : Array
        The cost, a scalar.
    states, costates : Array, or tuple of Arrays
        At the ``N + 1`` nodes, in the shapes of ``Solution``.
    controls : Array, or tuple of Arrays
        At the stages.
    """

    cost: Any
    states: Any
    costates: Any
    controls: Any


def differentiable_extremal(
    manifold: Manifold,
    given: BoundaryData,
    solved: Callable[[BoundaryData], Solution],
    sensitivity: Callable[[Solution], Sensitivity],
) -> DifferentiableSolution:
    """The extremal that ``solved`` finds, with the derivatives of the implicit function theorem.

    Forward mode multiplies by the columns of ``sensitivity``, and reverse mode is its transpose.
    """

    @jax.custom_jvp
    def extremal(given: BoundaryData) -> DifferentiableSolution:
        return _arrays(solved(_values(given)))

    def with_tangent(
        primals: tuple[BoundaryData], tangents: tuple[BoundaryData]
    ) -> tuple[DifferentiableSolution, DifferentiableSolution]:
        with eval_context():  # else JAX would record the solver too, for the tangents
            solution = solved(_values(*primals))
            derivatives = sensitivity(solution)
        return _arrays(solution), push_forward(manifold, solution, derivatives, *tangents)

    extremal.defjvp(with_tangent)
    return extremal(_numbers(given))


def _numbers(given: BoundaryData) -> BoundaryData:
    """All as arrays of floating-point numbers, because whole numbers have no derivatives."""
    real = jnp.zeros(()).dtype

    def number(a: Any) -> Any:
        if not vec.is_traced(a) and np.asarray(a).dtype.kind not in "fciub":
            hint = "; solve with it free, and give extremal what was found" if is_free(a) else ""
            raise InvalidInputError(f"extremal takes numbers and arrays of them, got {brief(a)}{hint}")
        return jnp.asarray(a, jnp.promote_types(jnp.result_type(a), real))

    return jax.tree.map(number, given)


def _values(given: BoundaryData) -> BoundaryData:
    """In NumPy; raises where only JAX could know them."""
    if is_transformed(given):
        raise InvalidInputError(
            "extremal is called with values that JAX is tracing, as under jit and vmap and for second derivatives, "
            "expected numbers; it has first derivatives, outside jit and vmap: try differences of those"
        )
    return jax.tree.map(np.asarray, given)


def _arrays(solution: Solution) -> DifferentiableSolution:
    return DifferentiableSolution(
        *(jax.tree.map(jnp.asarray, getattr(solution, name)) for name in DifferentiableSolution._fields)
    )


def push_forward(
    manifold: Manifold, solution: Solution, by: Sensitivity, tangent: BoundaryData
) -> DifferentiableSolution:
    """The derivative of the extremal along a tangent, to which it is linear."""
    first, last = (vec.taken(solution.states, k) for k in (0, -1))
    ends = (vec.components(manifold.basis(q), _fill(v, q)) for q, v in ((first, tangent.start), (last, tangent.end)))
    pairs = [*zip(ends, (by.start, by.end), strict=True), (tangent.horizon, by.horizon)]
    if tangent.parameters is not None:
        derivatives = jax.tree.leaves(by.parameters, is_leaf=lambda leaf: leaf is None or isinstance(leaf, Derivative))
        pairs += zip(jax.tree.leaves(tangent.parameters), derivatives, strict=True)
    parts = [
        _along(v, derivative) for v, derivative in pairs if derivative is not None
    ]  # by what is free there are none
    return jax.tree.map(lambda *leaves: sum(leaves[1:], leaves[0]), *parts)


def _along(v: Any, by: Derivative) -> DifferentiableSolution:
    """A derivative by an array times a change of it."""
    derivatives = DifferentiableSolution(*(getattr(by, name) for name in DifferentiableSolution._fields))
    return jax.tree.map(lambda leaf: jnp.tensordot(v, jnp.asarray(leaf), jnp.ndim(v)), derivatives)


def _fill(tangent: Any, point: Any) -> Any:
    """A tangent of an end, zero where that is free."""
    if isinstance(point, tuple):
        given = (None,) * len(point) if tangent is None else tangent
        return tuple(_fill(v, q) for v, q in zip(given, point, strict=True))
    return np.zeros_like(point) if tangent is None else tangent
