"""Conditions on both ends of a trajectory: equations between them, and periodic ends."""

from collections.abc import Callable, Collection, Mapping
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from ...manifolds import InvalidInputError, Manifold
from ...manifolds.numerics.ambient import Ambient
from ..reporting.text import brief
from .path_constraints import TAKEN
from .user_functions import in_precision, real_vector, shapes_in

PERIODIC = "periodic"
ZERO = "return a number that is zero where the condition holds, as a - b for a == b"
BoundaryConstraint = Callable[..., Any]


@final
class BoundaryConditions(eqx.Module):
    """``b(q(0), q(T)) = 0`` for functions by their ``names``, and ``q(T) = turn(q(0))`` if there is a ``turn``.

    ``factor``: the latter is of the first factor of a product only. ``closed``: it is ``q(T) = q(0)``.
    """

    names: tuple[str, ...] = eqx.field(static=True, default=())
    functions: tuple[BoundaryConstraint, ...] = ()
    turn: Callable[..., Any] | None = None
    factor: bool = eqx.field(static=True, default=False)
    closed: bool = eqx.field(static=True, default=False)

    @classmethod
    def of(cls, constraints: Any, periodic: Any, taken: Collection[str] = ()) -> "BoundaryConditions":
        """The conditions of a user, checked without a look at the arguments of the functions.

        ``taken``: names of other multipliers.
        """
        if isinstance(constraints, cls):
            return constraints
        given = {} if constraints is None else constraints
        expected = (
            'boundary_constraints must be a dictionary of functions by their names, {"name": function of (q_0, q_T)}'
        )
        if not isinstance(given, Mapping):
            raise InvalidInputError(f"{expected}, got {brief(given)}")
        for name in given:
            if not isinstance(name, str) or not name.strip():
                raise InvalidInputError(f"{expected}, got the name {name!r}; try a word")
            if name in (PERIODIC, *TAKEN, *taken):
                raise InvalidInputError(
                    f"{boundary_words(name)} has a name under which other conditions or their multipliers are found; "
                    f"expected one of its own; try {name + ' of the ends'!r}"
                )
        if not (isinstance(periodic, bool) or callable(periodic)):
            raise InvalidInputError(
                f"periodic must be True, for q(T) = q(0), or a function g with q(T) = g(q(0)), got {brief(periodic)}"
            )
        turn = identity if periodic is True else periodic if callable(periodic) else None
        return cls(tuple(given), tuple(given.values()), turn, closed=turn is identity)

    @property
    def any(self) -> bool:
        """Whether there is one."""
        return bool(self.functions) or self.turn is not None

    def each(self, first: Ambient, last: Ambient) -> tuple[Array, ...]:
        """The values of each function, in a row."""
        named = zip(self.names, self.functions, strict=True)
        return tuple(boundary_values(name, function(first, last)) for name, function in named)

    def values(self, first: Ambient, last: Ambient) -> Array:
        """The values of all functions."""
        return jnp.concatenate([jnp.zeros(0), *self.each(first, last)])


def identity(q: Ambient) -> Ambient:
    """The point itself."""
    return q


def boundary_words(name: str) -> str:
    """The name of the function of a boundary constraint in a message."""
    return f"boundary_constraints[{name!r}]"


def boundary_values(name: str, value: Any) -> Array:
    """The values of the function of a boundary constraint, in a row; raises if these are something else than
    numbers."""
    return jnp.ravel(real_vector(boundary_words(name), value, ZERO))


def linkage(name: str, function: Callable[..., Any], manifold: Manifold, q: Ambient) -> Ambient:
    """The image under a map between states; raises ``InvalidInputError`` if its structure is not a point's."""
    image = function(q)
    wrong = manifold.describe_mismatch(shapes_in(image), f"the value of {name}, a point")
    if wrong:
        raise InvalidInputError(wrong)
    return jax.tree.map(lambda s, a: in_precision(name, a, s.dtype), manifold.ambient, image)
