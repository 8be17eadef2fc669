"""Shapes of what is given to methods that act on one point, checked when they are traced.

A retraction has one such method, its call, which checks and then calls the ``retract`` that a class writes. A manifold
and a metric have several, and a second name for each, one to write and one to call, would be two words for one thing of
the field: there the methods that a class defines are wrapped where it is made.
"""

import functools
import inspect
from collections.abc import Callable
from typing import Any

from .ambient import Ambient
from .errors import InvalidInputError


def check_shapes(cls: type, roles: dict[str, tuple[str, ...]], manifold: Callable[[Any], Any]) -> None:
    """Let methods that a class defines refuse, when they are traced, arrays of other shapes than an ambient vector has.

    ``roles`` says what their first arguments are called. A batch without ``jax.vmap`` would broadcast and be wrong
    silently.
    """
    for name in roles.keys() & vars(cls).keys():
        setattr(cls, name, _at_one_point(vars(cls)[name], roles[name], manifold))


def _at_one_point(
    method: Callable[..., Any], roles: tuple[str, ...], manifold: Callable[[Any], Any]
) -> Callable[..., Any]:
    @functools.wraps(method)
    def checked(self: Any, *given: Any, **named: Any) -> Any:
        if named:
            given = inspect.signature(method).bind(self, *given, **named).args[1:]
        require_shapes(manifold(self), dict(zip(roles, given, strict=False)))
        return method(self, *given)

    return checked


def require_shapes(manifold: Any, given: dict[str, Ambient]) -> None:
    """Raise ``InvalidInputError`` unless what is given, by what it is called, has the shapes of an ambient vector."""
    for role, a in given.items():
        wrong = manifold.describe_shapes(a, role)
        if wrong:
            raise InvalidInputError(f"{wrong}; methods act on one point at a time, jax.vmap makes them take batches")
        wrong = manifold.describe_kinds(a, role)
        if wrong:
            raise InvalidInputError(wrong)
