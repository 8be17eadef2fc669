"""What becomes machine code once it has run often."""

from abc import ABC, abstractmethod

from ..compute.threads import later

OFTEN = 200_000  # points at which the machine has taken as long as machine code takes to be made, or half as long
MOST = 20_000  # instructions: Python waits at its end for what is being made, two seconds for so many
SHORT = 20  # points, of which less take no less time, as it goes into the choice of instructions


class Often(ABC):
    """Counts the points at which it runs; after very many another thread compiles it."""

    def __init__(self) -> None:
        self._points, self._asked = 0, False

    @property
    @abstractmethod
    def instructions(self) -> int:
        """Number of instructions."""

    @abstractmethod
    def compile(self) -> None:
        """Make machine code of it, now, which gives the same numbers."""

    def ran(self, points: int) -> None:
        """Tell that it has run at so many points."""
        self._points += max(points, SHORT)
        if self._points > OFTEN and not self._asked:
            self._asked = True
            if self.instructions <= MOST:
                later(self.compile)
