"""Errors raised for a user's mistake: what came, what was expected, what to try."""

from collections.abc import Callable
from typing import Any

import jax

from ...errors import TRACEABLE, InvalidInputError, RetraxError


class NotOnManifoldError(InvalidInputError):
    """A point is off its manifold, or a vector is not tangent."""


class UnknownRetractionError(RetraxError, TypeError):
    """No retraction of the requested name is known on a manifold.

    >>> QR(Sphere(2))
    Traceback (most recent call last):
        ...
    retrax.manifolds.numerics.errors.UnknownRetractionError: ...
    """


class DomainError(InvalidInputError):
    """A point lies outside the image of a retraction or of a discretization map.

    >>> north = jnp.array([0.0, 0.0, 1.0])
    >>> Projection(Sphere(2)).inverse(north, -north)
    Traceback (most recent call last):
        ...
    retrax.manifolds.numerics.errors.DomainError: ...
    """


class ConvergenceError(RetraxError, RuntimeError):
    """An iteration ended without meeting the conditions that its result claims.

    ``solution`` holds what was reached, where ``solve`` raised it: a record whose ``success`` is false, or None.

    >>> issubclass(ConvergenceError, RuntimeError)
    True
    """

    def __init__(self, message: str, solution: Any = None) -> None:
        super().__init__(message)
        self.solution = solution


def shapes_of(function: Callable[..., Any], what: str, *arguments: Any) -> Any:
    """Shapes of the values of a user's ``function``, called ``what``, from those of its arguments.

    Raises ``InvalidInputError`` where JAX cannot trace it, as one that is written with NumPy.
    """
    try:
        return jax.eval_shape(function, *arguments)
    except jax.errors.JAXTypeError as reason:
        raise InvalidInputError(f"{what} cannot be traced by JAX ({type(reason).__name__}); {TRACEABLE}") from reason
