"""Functions that a lower floor calls and a file of a higher floor defines."""

from collections.abc import Callable
from typing import Generic, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


class Hook(Generic[P, R]):
    """A function that a lower floor calls, and whose work a file above registers when it is imported.

    ``place``: the file that does so.
    """

    def __init__(self, place: str) -> None:
        self.place = place
        self.work: Callable[P, R] | None = None

    def register(self, work: Callable[P, R]) -> Callable[P, R]:
        """The decorator of the function that does the work."""
        self.work = work
        return work

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        if self.work is None:
            raise RuntimeError(f"{self.place}, which does this work, is not imported yet; import retrax first")
        return self.work(*args, **kwargs)
