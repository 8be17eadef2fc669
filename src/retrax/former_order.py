"""Former orders of arguments, which work for one more release with a ``DeprecationWarning``."""

import warnings
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

from .errors import InvalidCallError, concise
from .retractions import CollocationMethod, DiscretizationMap

P = ParamSpec("P")
R = TypeVar("R")


def accept_former_order(*names: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """A decorator that also accepts arguments in a former order, in which the method came second.

    ``names``: the former order of the arguments, in which the method was called ``discretization``.
    """

    def accepting(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def call(*arguments: P.args, **options: P.kwargs) -> R:
            second: Any = arguments[1] if len(arguments) > 1 else None
            if not isinstance(second, DiscretizationMap | CollocationMethod) and "discretization" not in options:
                return function(*arguments, **options)
            given: dict[str, Any] = dict(zip(names, arguments, strict=False))
            if len(arguments) > len(names) or given.keys() & options.keys():
                raise InvalidCallError(f"{function.__name__} was given an argument twice, or too many of them")
            warnings.warn(
                f"{function.__name__}({', '.join(names[:6])}) is deprecated; "
                f"write {function.__name__}(problem, start, end, horizon, method=..., steps=...)",
                DeprecationWarning,
                stacklevel=3,
            )
            given |= options
            given["method"] = given.pop("discretization", None)
            accept: Callable[..., R] = function
            return accept(**given)

        return concise(call)

    return accepting
