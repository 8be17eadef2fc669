"""The equations of a jaxpr that its wanted values need; JAX keeps unused equations of derivatives and linear solves."""

from typing import Any

from jax.extend.core import Literal

from ..jaxpr_tools import CALLS, called_program

RULES = {"custom_jvp_call", "custom_vjp_call"}  # calls with derivatives of their own


def open_jaxpr(jaxpr: Any) -> Any:
    """The jaxpr without its constants."""
    return getattr(jaxpr, "jaxpr", jaxpr)


def live_equations(jaxpr: Any, wanted: list[bool]) -> tuple[list[tuple[Any, list[bool], list[bool]]], set[Any]]:
    """Equations in order, each with the outputs that are wanted of it and the inputs that it needs, and the live
    variables."""
    live = {v for v, want in zip(jaxpr.outvars, wanted, strict=True) if want and not isinstance(v, Literal)}
    found = []
    for eqn in reversed(jaxpr.eqns):
        outputs = [v in live for v in eqn.outvars]
        if any(outputs):
            inputs = _inputs(eqn, outputs)
            found.append((eqn, outputs, inputs))
            live.update(v for v, need in zip(eqn.invars, inputs, strict=True) if need and not isinstance(v, Literal))
    return found[::-1], live


def _inputs(eqn: Any, outputs: list[bool]) -> list[bool]:
    if eqn.primitive.name in CALLS.keys() - RULES:
        inner = open_jaxpr(called_program(eqn))
        live = live_equations(inner, outputs)[1]
        return [v in live for v in inner.invars]
    if eqn.primitive.name == "custom_linear_solve":  # its factors are made anew from the linear map
        counts = eqn.params["const_lengths"]
        return [k < counts.matvec or k >= sum(counts) for k in range(len(eqn.invars))]
    return [True] * len(eqn.invars)
