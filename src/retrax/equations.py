"""What equations of JAX's programs say: what they call, and how loops part their inputs, in every version of JAX."""

from typing import Any, TypeVar

import jax

HIGH = "call_hi_primitive"  # since JAX 0.11: an object says what is computed, and how that is differentiated

T = TypeVar("T")


def name_of(equation: Any) -> str:
    """What an equation computes."""
    name = equation.primitive.name
    return type(equation.params["_prim"]).__name__ if name == HIGH else name


def expansion(equation: Any) -> Any:
    """The program, a closed jaxpr, of an equation whose primitive is an object; None for another one."""
    if equation.primitive.name != HIGH:
        return None
    high = equation.params["_prim"]

    def flat(*arguments: Any) -> list[Any]:
        return jax.tree.leaves(high.expand(*jax.tree.unflatten(high.in_tree, arguments)))

    return jax.make_jaxpr(flat)(*(jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in equation.invars))


def scan_parts(params: dict[str, Any], inputs: list[T]) -> tuple[list[T], list[T], list[T]]:
    """Of the inputs of an equation ``scan``: the constants, what is carried from round to round, and the rows."""
    if "ft_in" in params:  # since JAX 0.11
        fixed, carry, rows = map(list, params["ft_in"].update(inputs).unpack())
        return fixed, carry, rows
    first = params["num_consts"]
    last = first + params["num_carry"]
    return inputs[:first], inputs[first:last], inputs[last:]
