"""The root of a system as one primitive of JAX, differentiated by the implicit function theorem however often and in
every mode.

``jax.lax.custom_root`` says the same, but where a loop is differentiated in reverse mode JAX forgets its rule: a
derivative of that derivative would go through the iterations, which say nothing where the first guess was the root. The
rule of a primitive stays.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import ClosedJaxpr, Jaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Bool

from .chord_newton import Vector, newton, row_sizes

Axes = tuple[tuple[int | None, ...], ...]  # for each level of vmap, innermost first, the mapped axis of every operand


def implicit_root(
    residual: Callable[[Vector], Vector],
    first: Vector,
    inverse: Array | None = None,
    known: bool = False,
) -> tuple[Vector, Bool[Array, ""]]:
    """Root of ``residual`` near ``first``, or, if it is ``known``, ``first`` itself; and whether the iteration
    converged.

    ``inverse`` is an approximate inverse Jacobian to begin with. Derivatives are those with respect to what
    ``residual`` closes over.
    """
    closed: Any = jax.make_jaxpr(residual)(first)
    begin = [first, *([] if inverse is None else [inverse])]
    # Since JAX 0.11 a program without its constants is of the same class as one that has them.
    jaxpr = closed.with_consts([]) if hasattr(closed, "with_consts") else closed.jaxpr
    root, converged = _root.bind(*begin, *closed.consts, jaxpr=jaxpr, begin=len(begin), known=known, axes=())
    return root, converged


_root = Primitive("implicit_root")
_root.multiple_results = True


def _residual(jaxpr: Jaxpr, consts: Sequence[Any]) -> Callable[[Vector], Vector]:
    function = jaxpr_as_fun(ClosedJaxpr(jaxpr, list(consts)))
    return lambda c: function(c)[0]


def _mapped(function: Callable[..., Any], axes: Axes) -> Callable[..., Any]:
    for level in axes:
        function = jax.vmap(function, in_axes=level)
    return function


@_root.def_impl
def _value(*operands: Any, jaxpr: Jaxpr, begin: int, known: bool, axes: Axes) -> Sequence[Array]:
    def value(*operands: Any) -> Sequence[Array]:
        (first, *inverse), consts = operands[:begin], operands[begin:]
        if known:
            return first, jnp.array(True)
        return newton(_residual(jaxpr, consts), first, *inverse or [None])

    return _mapped(value, axes)(*operands)


@_root.def_abstract_eval
def _shapes(*operands: Any, axes: Axes, **_: Any) -> Sequence[Any]:
    shapes = jax.eval_shape(_mapped(lambda first, *rest: (first, jnp.array(True)), axes), *operands)
    return [ShapedArray(s.shape, s.dtype) for s in shapes]


def _derivative(primals: Sequence[Any], tangents: Sequence[Any], *, axes: Axes, **parameters: Any) -> tuple[Any, Any]:
    """``dc = -(df/dc)^-1 df`` at the root."""
    root, converged = _root.bind(*primals, axes=axes, **parameters)
    jaxpr, begin = parameters["jaxpr"], parameters["begin"]
    moving = [i for i in range(begin, len(primals)) if not isinstance(tangents[i], ad.Zero)]
    still = ad.Zero(jax.typeof(converged).to_tangent_aval())
    if not moving:
        return (root, converged), (ad.Zero(jax.typeof(root).to_tangent_aval()), still)

    def push(root: Vector, *arguments: Any) -> Vector:
        consts, changes = arguments[: len(primals) - begin], arguments[len(primals) - begin :]

        def at_root(*moved: Any) -> Vector:
            values = list(consts)
            for i, value in zip(moving, moved, strict=True):
                values[i - begin] = value
            return _residual(jaxpr, values)(root)

        _, change = jax.jvp(at_root, tuple(consts[i - begin] for i in moving), changes)
        jacobian = jax.jacfwd(_residual(jaxpr, consts))(root)
        rows = row_sizes(jacobian)
        return -jnp.linalg.solve(jacobian / rows[:, None], change / rows)

    levels = tuple((0, *level[begin:], *(level[i] for i in moving)) for level in axes)
    change = _mapped(push, levels)(root, *primals[begin:], *(tangents[i] for i in moving))
    return (root, converged), (change, still)


def _batch(operands: Sequence[Any], dims: Sequence[Any], *, axes: Axes, **parameters: Any) -> tuple[Any, Any]:
    return _root.bind(*operands, axes=(*axes, tuple(dims)), **parameters), (0, 0)


ad.primitive_jvps[_root] = _derivative
batching.primitive_batchers[_root] = _batch
mlir.register_lowering(_root, mlir.lower_fun(partial(_value), multiple_results=True))
# Since JAX 0.11 some primitives, as that of ``jnp.interp``, are objects, which are written out before XLA compiles.
vars(_root)["to_lojax"] = _value
