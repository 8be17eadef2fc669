"""Errors below tape and layers, and how much of a traceback is shown of them."""

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import wraps
from types import TracebackType
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

TRACING = frozenset({"retrax", "jax", "jaxlib", "equinox"})  # packages between a call and the user's functions
CONCISE = "_retrax_concise"  # attribute of a concise function, for the parts of its calls
TRACEABLE = "try functions written in jax.numpy: jnp.sin instead of np.sin, jnp.where instead of if"

# Errors of functions that are given something else than expected.
FAILURES = TypeError, ValueError, IndexError, AttributeError, KeyError, NotImplementedError


class RetraxError(Exception):
    """The base of all errors of the library.

    Examples
    --------
    >>> issubclass(InvalidInputError, RetraxError), issubclass(ConvergenceError, RetraxError)
    (True, True)
    """


class InvalidInputError(RetraxError, ValueError):
    """The error of an argument with a wrong value, shape or structure.

    Examples
    --------
    >>> Stiefel(2, 3)
    Traceback (most recent call last):
        ...
    retrax.errors.InvalidInputError: ...
    """


class InvalidCallError(InvalidInputError, TypeError):
    """The error of a call with an argument that the function does not have, or without one that it needs.

    Examples
    --------
    >>> issubclass(InvalidCallError, TypeError), issubclass(InvalidCallError, InvalidInputError)
    (True, True)
    """


class NotDifferentiableError(RetraxError, ValueError):
    """The error of a function without derivatives: costates and Newton's method need them, forward and backward.

    Examples
    --------
    >>> issubclass(NotDifferentiableError, ValueError)
    True
    """


def _users_frames(error: Exception) -> TracebackType | None:
    """The frames of a user's function that raised an error, with what it called; None for an error of another
    origin."""
    places, entry = [], error.__traceback__
    while entry is not None:
        places.append(entry)
        entry = entry.tb_next
    names = [place.tb_frame.f_globals.get("__name__", "").partition(".")[0] for place in places]
    last = max((k for k, name in enumerate(names) if name in TRACING), default=-1)
    return places[last + 1] if last + 1 < len(places) else None


def concise(
    function: Callable[P, R],
    check: Callable[..., object] | None = None,
    within: Callable[[], AbstractContextManager[object]] | None = None,
) -> Callable[P, R]:
    """A public function whose errors are shown with the frames of users and one of the library.

    ``check`` is called before with the number of arguments and the names of options; the call runs ``within`` a
    context. Both are added to a function that is concise already, without a frame more. With the environment variable
    ``RETRAX_TRACEBACK=full``, all frames and causes are shown.
    """
    inner, own_check, own_within = _parts_of(function)
    check, within = check or own_check, within or own_within

    @wraps(function)
    def call(*arguments: P.args, **options: P.kwargs) -> R:
        try:
            if check is not None:
                check(len(arguments), *options)
            if within is None:
                return inner(*arguments, **options)
            with within():
                return inner(*arguments, **options)
        except Exception as error:
            frames = error.__traceback__ if isinstance(error, RetraxError) else _users_frames(error)
            if frames is None or os.environ.get("RETRAX_TRACEBACK") == "full":
                raise
            error.__notes__ = [note for note in getattr(error, "__notes__", []) if "internal frames" not in note]
            raise error.with_traceback(None if isinstance(error, RetraxError) else frames) from None

    # A traceback shows this frame by the function's name and without a line of its source, which tells users nothing.
    own: Any = call
    own.__code__ = own.__code__.replace(co_filename="<retrax>", co_name=getattr(function, "__name__", "call"))
    vars(call)[CONCISE] = call, (inner, check, within)
    return call


def _parts_of(function: Any) -> tuple[Any, ...]:
    """A function without its concise frame, with the check and the context of its calls."""
    owner, parts = getattr(function, "__dict__", {}).get(CONCISE, (None, ()))
    return parts if owner is function else (function, None, None)  # a wrapper has the attributes of what it wraps
