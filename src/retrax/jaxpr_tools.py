"""Equations of JAX's programs: the programs that they call, and the inputs of loops, in every version of JAX."""

from collections.abc import Iterator
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr
from jaxtyping import Array

# Of the programs that equations call, by the names of parameters.
CALLS = {
    **dict.fromkeys(("jit", "pjit", "remat", "remat2", "checkpoint"), "jaxpr"),
    **dict.fromkeys(("closed_call", "core_call", "custom_jvp_call", "custom_vjp_call", "eval_jaxpr"), "call_jaxpr"),
}
HIGH = "call_hi_primitive"  # since JAX 0.11: an object says what is computed, and how that is differentiated

T = TypeVar("T")


def name_of(equation: Any) -> str:
    """The name of the operation of an equation."""
    if equation.primitive.name != HIGH:
        return equation.primitive.name
    high = equation.params["_prim"]
    while type(high).__name__ == "VmapOf":
        high = high.prim
    return type(high).__name__


def called_program(equation: Any) -> Any:
    """The program, a closed jaxpr, that an equation calls; None for one that calls none, or has several."""
    name = equation.primitive.name
    if name == HIGH:
        return expansion(equation.params["_prim"])
    if name not in CALLS:
        return None
    program = equation.params[CALLS[name]]
    own = _in_scalars(program)
    if own is not None:
        return jax.make_jaxpr(own)(*(jax.ShapeDtypeStruct(kind.shape, kind.dtype) for kind in program.in_avals))
    return program if hasattr(program, "consts") else ClosedJaxpr(program, [])


def programs(equation: Any) -> Iterator[Any]:
    """The closed or open programs in an equation: the called program, or the programs among its parameters."""
    own = called_program(equation)
    params = [*equation.params.values()] if own is None else [own]
    yield from (leaf for leaf in jax.tree.leaves(params, is_leaf=_has_equations) if _has_equations(leaf))


def _has_equations(value: Any) -> bool:
    return hasattr(value, "eqns")


def expansion(high: Any) -> Any:
    """The program, a closed jaxpr, that a primitive that is an object stands for."""

    def flat(*arguments: Any) -> list[Any]:
        return jax.tree.leaves(high.expand(*jax.tree.unflatten(high.in_tree, arguments)))

    return jax.make_jaxpr(flat)(*(jax.ShapeDtypeStruct(kind.shape, kind.dtype) for kind in high.in_avals_flat))


def _det2(a: Array) -> Array:
    return a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]


def _det3(a: Array) -> Array:
    return jnp.dot(a[0], jnp.cross(a[1], a[2]))


# Functions that JAX 0.11 and later compute with comparisons of entries, a pivot by the input, or bits, by their names.
IN_SCALARS = {"_det_2x2": _det2, "_det_3x3": _det3, "exp_neg_sq": lambda x: jnp.exp(-(x**2))}


def is_in_scalars(equation: Any) -> bool:
    """Whether an equation calls a known function, whose derivatives are the derivatives of its scalar expression."""
    name = equation.primitive.name
    return name in CALLS and _in_scalars(equation.params[CALLS[name]]) is not None


def _in_scalars(program: Any) -> Any:
    """The known function as a program of products, sums and elementary functions, with the derivatives that JAX states.

    None for a program that is not known.
    """
    source = str(getattr(getattr(getattr(program, "jaxpr", program), "debug_info", None), "func_src_info", ""))
    name, _, place = source.partition(" at ")
    if name not in IN_SCALARS or "/jax/_src/" not in place.replace("\\", "/"):
        return None
    # The axis of a batch may be anywhere in matrices.
    return IN_SCALARS[name] if name == "exp_neg_sq" or program.in_avals[0].ndim == 2 else None


def scan_parts(params: dict[str, Any], inputs: list[T]) -> tuple[list[T], list[T], list[T]]:
    """The constants, the carried values and the rows among the inputs of an equation ``scan``."""
    if "ft_in" in params:  # since JAX 0.11
        fixed, carry, rows = map(list, params["ft_in"].update(inputs).unpack())
        return fixed, carry, rows
    first = params["num_consts"]
    last = first + params["num_carry"]
    return inputs[:first], inputs[first:last], inputs[last:]
