"""Errors raised for a user's mistake: what came, what was expected, what to try."""

from collections.abc import Callable
from typing import Any

import jax

from ...errors import TRACEABLE, InvalidInputError, RetraxError


class NotOnManifoldError(InvalidInputError):
    """The error of a point off its manifold, or of a vector that is not tangent."""


class UnknownRetractionError(RetraxError, TypeError):
    """The error of a retraction that no manifold of this kind has under the requested name.

    Examples
    --------
    >>> QR(Sphere(2))
    Traceback (most recent call last):
        ...
    retrax.manifolds.numerics.errors.UnknownRetractionError: ...
    """


class DomainError(InvalidInputError):
    """The error of a point outside the image of a retraction or of a discretization map.

    Examples
    --------
    >>> north = jnp.array([0.0, 0.0, 1.0])
    >>> Projection(Sphere(2)).inverse(north, -north)
    Traceback (most recent call last):
        ...
    retrax.manifolds.numerics.errors.DomainError: ...
    """


class ConvergenceError(RetraxError, RuntimeError):
    """The error of an iteration that ended before its conditions were met.

    Parameters
    ----------
    message : str
        The message.
    solution : Solution, optional
        The best iterate, whose ``success`` is False; None if there is none.

    Examples
    --------
    >>> issubclass(ConvergenceError, RuntimeError)
    True
    """

    def __init__(self, message: str, solution: Any = None) -> None:
        super().__init__(message)
        self.solution = solution


def shapes_of(function: Callable[..., Any], what: str, *arguments: Any) -> Any:
    """Shapes of the values of a user's ``function``, called ``what``, from the shapes of its arguments.

    Raises ``InvalidInputError`` where JAX cannot trace it, as one that is written with NumPy.
    """
    try:
        return jax.eval_shape(function, *arguments)
    except jax.errors.JAXTypeError as reason:
        raise InvalidInputError(f"{what} cannot be traced by JAX ({type(reason).__name__}); {TRACEABLE}") from reason
