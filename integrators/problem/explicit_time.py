"""Functions of a problem with explicit time: the names of their arguments, and a time that they ignore."""

from collections.abc import Callable
from functools import wraps
from inspect import Parameter, Signature
from typing import Any

from .argument_errors import takes_more

# The arguments of functions of a state, of a state and its time, of a state and its control, of both ends, of a node.
ARGUMENTS = ("q",), ("q", "t"), ("q", "u", "t"), ("q_0", "q_T", "t"), ("q", "k")
TIMELESS = 0, 4  # kinds without a time


def with_time(function: Callable[..., Any], kind: int) -> Callable[..., Any]:
    """A function without explicit time, with a time that it ignores."""
    if kind in TIMELESS:
        return function
    count = len(ARGUMENTS[kind]) - 1
    names = argument_names(kind, True, takes_more(function, count))
    return with_signature(function, names, lambda *given: function(*given[:count], *given[count + 1 :]))


def argument_names(kind: int, time_dependent: bool, parameters: bool) -> tuple[str, ...]:
    """The names of the arguments of functions of a kind."""
    names = [name for name in ARGUMENTS[kind] if time_dependent or name != "t"]
    return (*names, "parameters") if parameters else tuple(names)


def with_signature(function: Any, names: tuple[str, ...], call: Callable[..., Any]) -> Callable[..., Any]:
    """A function in the name of another one, with arguments of these names."""
    named: Any = wraps(function)(lambda *given: call(*given))
    named.__signature__ = Signature([Parameter(name, Parameter.POSITIONAL_OR_KEYWORD) for name in names])
    return named
