"""Steps that functions compute, as of signs and whole numbers: what they are, and numbers that change sign where they
jump."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr
from jaxtyping import Array

from ....compute.program_digest import outputs_of, value_of
from ....jaxpr_tools import called_program, programs, scan_parts
from ....tracing import trace_program

WHOLE = "a whole number"
STEP_PRIMITIVES = {
    **{name: f"jnp.{name}" for name in ("round", "floor", "ceil", "sign", "argmax", "argmin")},
    **dict.fromkeys(("gt", "ge", "lt", "le", "eq", "ne", "eq_to", "le_to", "lt_to"), "a comparison"),
    "rem": "the remainder of a division",
    "atan2": "jnp.arctan2",
    "convert_element_type": WHOLE,
}


class Margins(NamedTuple):
    """Margins of steps: numbers that change sign where a step jumps, and the sizes of the terms of these numbers."""

    values: Array  # (G,)
    sizes: Array


def find_step_primitives(function: Callable[..., Any], *arguments: Any) -> list[str]:
    """Names of the steps that a function computes from its arguments, each once."""
    program = program_of(function, *arguments)
    found = (
        (STEP_PRIMITIVES.get(equation.primitive.name), equation) for equation in dependent_equations(program.jaxpr)
    )
    return list(dict.fromkeys(name for name, equation in found if name and (name != WHOLE or _is_rounding(equation))))


def program_of(function: Callable[..., Any], *arguments: Any) -> ClosedJaxpr:
    """The program of a function as it is now."""
    with np.errstate(all="ignore"):  # what else it reads may be zeros of NumPy
        return trace_program(function, *arguments)


def dependent_equations(jaxpr: Any) -> Iterator[Any]:
    """The equations of a program that compute something from its arguments, inner programs included."""
    known = set(map(id, jaxpr.invars))
    for equation in jaxpr.eqns:
        if not any(id(v) in known for v in equation.invars):
            continue
        known.update(map(id, equation.outvars))
        yield equation
        for inner in programs(equation):
            yield from dependent_equations(getattr(inner, "jaxpr", inner))


def _is_rounding(equation: Any) -> bool:
    """Whether an equation turns real numbers into whole numbers."""
    before, after = (v.aval.dtype for v in (equation.invars[0], equation.outvars[0]))
    return jnp.issubdtype(before, jnp.inexact) and not jnp.issubdtype(after, jnp.inexact)


def with_margins(function: Callable[..., Array], *arguments: Any) -> tuple[Array, Margins]:
    """The value of a function, and the margins of its steps, without steps in the body of loops of unknown length."""
    closed = jax.make_jaxpr(function)(*arguments)
    found: list[Margins] = []
    value = _run(closed, jax.tree.leaves(arguments), found)[0]
    none = jnp.zeros(0, value.dtype)
    parts = [[jnp.ravel(part).astype(value.dtype) for part in margin] for margin in found]
    return value, Margins(
        *(jnp.concatenate([none, *side]) for side in (zip(*parts, strict=True) if parts else ((), ())))
    )


def _run(closed: Any, arguments: list[Any], found: list[Margins]) -> list[Any]:
    """The outputs of a program; what it ``found`` of margins is added."""
    jaxpr = closed.jaxpr
    known = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*closed.consts, *arguments], strict=True))

    for equation in jaxpr.eqns:
        inputs, name = [value_of(known, v) for v in equation.invars], equation.primitive.name
        if name in STEP_PRIMITIVES and jnp.issubdtype(jnp.result_type(inputs[0]), jnp.floating):
            found.extend(_margin(equation, inputs))
        if (inner := called_program(equation)) is not None:
            outputs = _run(inner, inputs, found)
        elif name in LOOPS:
            outputs = LOOPS[name](equation.params, inputs, found)
        else:
            outputs = outputs_of(jaxpr, equation, known)
        # Of those that are not taken no output is used.
        for branch in equation.params["branches"] if name == "cond" else ():
            _run(branch, inputs[1:], found)
        known.update(zip(equation.outvars, outputs, strict=True))
    return [value_of(known, v) for v in jaxpr.outvars]


def _scan(params: dict[str, Any], inputs: list[Any], found: list[Margins]) -> list[Any]:
    """The outputs of a loop, and the margins of all rounds."""
    fixed, begin, each = scan_parts(params, inputs)

    def body(carry: list[Any], x: list[Any]) -> tuple[list[Any], Any]:
        own: list[Margins] = []
        outputs = _run(params["jaxpr"], [*fixed, *carry, *x], own)
        return outputs[: len(begin)], (outputs[len(begin) :], own)

    carry, (rows, own) = jax.lax.scan(body, begin, each, params["length"], params["reverse"])
    found.extend(own)
    return [*carry, *rows]


def _while(params: dict[str, Any], inputs: list[Any], found: list[Margins]) -> list[Any]:
    """The outputs of a loop of unknown length, and margins that change their signs with the number of rounds.

    Of each comparison that ends the loop: the smaller one of its margins in the last round and behind it.
    """
    first, last = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
    of_test, of_body, begin = inputs[:first], inputs[first:last], inputs[last:]

    def test(values: list[Any]) -> tuple[Any, list[Margins]]:
        own: list[Margins] = []
        return _run(params["cond_jaxpr"], [*of_test, *values], own)[0], own

    def body(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        values, sign, _ = carry
        return _run(params["body_jaxpr"], [*of_body, *values], []), -sign, test(values)[1]

    endless = jax.tree.map(lambda a: jnp.full_like(a, jnp.inf), test(begin)[1])
    values, sign, before = jax.lax.while_loop(lambda carry: test(carry[0])[0], body, (begin, 1, endless))
    for last_round, behind in zip(before, test(values)[1], strict=True):
        smaller = jnp.minimum(jnp.abs(last_round.values), jnp.abs(behind.values))
        found.append(Margins(sign * smaller, behind.sizes))
    return values


LOOPS = {"scan": _scan, "while": _while}


def _margin(equation: Any, inputs: list[Any]) -> list[Margins]:
    """The margins of a step of real numbers."""
    name, x = equation.primitive.name, inputs[0]
    if name in ("sign", "atan2"):
        return [Margins(x, jnp.abs(x))]
    if name in ("floor", "ceil", "round") or (name == "convert_element_type" and _is_rounding(equation)):
        return [_wave(x - 0.5 if name == "round" else x)]
    if name == "rem":
        return [_wave(x / inputs[1])]
    if name in ("argmax", "argmin"):
        rows = jnp.moveaxis(x, equation.params["axes"][0], -1)
        rows = rows if name == "argmax" else -rows
        others = jnp.where(jnp.eye(rows.shape[-1], dtype=bool), -jnp.inf, rows[..., None, :])
        return [Margins(rows - jnp.max(others, axis=-1), jnp.abs(rows))] if rows.shape[-1] > 1 else []
    if name == "convert_element_type":
        return []
    if name in ("eq", "eq_to", "ne"):  # of numbers that are the same along a piece, as a maximum and its argument
        size = jnp.maximum(jnp.abs(x), jnp.abs(inputs[1]))
        return [Margins(jnp.where(x == inputs[1], size, -jnp.abs(x - inputs[1])), size)]
    return [Margins(x - inputs[1], jnp.maximum(jnp.abs(x), jnp.abs(inputs[1])))]


def _wave(x: Array) -> Margins:
    """The wave ``sin(pi x)``, exactly zero at whole numbers in every precision.

    Its size is the distance between two whole numbers, or the rounding of ``x``, whichever is larger.
    """
    whole = jnp.round(x)
    sign = 1 - 2 * jnp.abs(whole - 2 * jnp.round(whole / 2))
    return Margins(sign * jnp.sin(jnp.pi * (x - whole)), jnp.maximum(1.0, 4 * jnp.abs(x)))
