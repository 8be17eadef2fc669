"""Whether functions lose digits at a point that nothing brings back: exponentials that are zero, sigmoids that are
one."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from ....compute.program_digest import outputs_of, value_of
from ....jaxpr_tools import called_program


def _vanishes(out: Array, *_: Array) -> Array:
    return out == 0


def _saturates(out: Array, *_: Array) -> Array:
    return jnp.abs(out) == 1


def _loses(out: Array, *factors: Array) -> Array:
    return (out == 0) & jnp.all(jnp.stack([jnp.broadcast_to(a != 0, out.shape) for a in factors]), axis=0)


LOSING_PRIMITIVES: dict[str, Callable[..., Array]] = {
    "exp": _vanishes,
    "exp2": _vanishes,
    "erfc": _vanishes,
    "expm1": lambda out, *_: out == -1,
    "tanh": _saturates,
    "erf": _saturates,
    "logistic": lambda out, *_: (out == 0) | (out == 1),
    "mul": _loses,
    "integer_pow": _loses,
    "square": _loses,
    "pow": lambda out, base, _: _loses(out, base),
    "div": lambda out, above, _: _loses(out, above),
}


def loses_digits(function: Callable[..., Any], *arguments: Any) -> Bool[Array, ""]:
    """Whether an operation in ``function`` underflows, as ``exp(-800)``, or is constant to all digits, as ``tanh(20)``.

    Loops and branches are evaluated as they are, without a look into them.
    """
    leaves, tree = jax.tree.flatten(arguments)
    closed = jax.make_jaxpr(lambda *leaves: function(*jax.tree.unflatten(tree, leaves)))(*leaves)
    return _evaluate(closed.jaxpr, closed.consts, leaves)[1]


def _evaluate(jaxpr: Any, constants: Any, arguments: list[Any]) -> tuple[list[Any], Array]:
    known = dict(zip(jaxpr.constvars, constants, strict=True)) | dict(zip(jaxpr.invars, arguments, strict=True))
    lost = jnp.zeros((), bool)
    for equation in jaxpr.eqns:
        values, name = [value_of(known, v) for v in equation.invars], equation.primitive.name
        if (inner := called_program(equation)) is not None:
            results, within = _evaluate(inner.jaxpr, inner.consts, values)
            lost |= within
        else:
            results = outputs_of(jaxpr, equation, known)
        if name in LOSING_PRIMITIVES and jnp.issubdtype(results[0].dtype, jnp.floating):
            lost |= jnp.any(LOSING_PRIMITIVES[name](results[0], *map(jnp.asarray, values)))
        known.update(zip(equation.outvars, results, strict=True))
    return [value_of(known, v) for v in jaxpr.outvars], lost
