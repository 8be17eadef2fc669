"""The figures of the solves of a controller."""

import json
from collections import Counter
from dataclasses import dataclass, replace
from typing import Literal, Self, final

import numpy as np

from ...manifolds import InvalidInputError
from ..reporting.records import write_protect
from ..reporting.text import brief, plural

Source = Literal["solve", "iterate", "feedback", "plan"]
ARRAYS = {"times": float, "iterations": int, "milliseconds": float}


@final
@dataclass(frozen=True, eq=False)
class ControllerStatistics:
    """The effort of a controller, with an entry for each control that it has returned.

    Attributes
    ----------
    times : array of shape (K,)
        The times of the samples.
    iterations : array of shape (K,)
        The iterations of the solves, also of solves without success.
    milliseconds : array of shape (K,)
        The time of each call, on the clock of the computer.
    sources : tuple of str
        The source of each control: ``"solve"``; ``"iterate"``, a feasible iterate of a solve without success within
        its budget; ``"feedback"``, the feedback law along an earlier solution; or ``"plan"``, an earlier plan alone.
    failures : dict of float to str
        The results of the solves without success, by the times of their samples.
    """

    times: np.ndarray
    iterations: np.ndarray
    milliseconds: np.ndarray
    sources: tuple[Source, ...]
    failures: dict[float, str]

    def __post_init__(self) -> None:
        write_protect(vars(self))

    @property
    def text(self) -> str:
        """The text of the figures in a file."""
        arrays = {name: getattr(self, name).tolist() for name in ARRAYS}
        return json.dumps({**arrays, "sources": self.sources, "failures": list(self.failures.items())})

    @classmethod
    def from_text(cls, text: str) -> Self:
        """The figures that wrote a text; raises ``InvalidInputError`` for another text.

        Parameters
        ----------
        text : str
            The text.
        """
        try:
            given = json.loads(text)
            arrays = {name: np.array(given[name], kind) for name, kind in ARRAYS.items()}
            return cls(**arrays, sources=tuple(given["sources"]), failures=dict(given["failures"]))
        except (ValueError, TypeError, KeyError) as error:
            raise InvalidInputError(f"its solves are {brief(text)}, expected figures of solves") from error

    def last(self, count: int) -> Self:
        """The figures of the last controls.

        Parameters
        ----------
        count : int
            The number of controls.
        """
        begin = len(self.sources) - count
        times = self.times[begin:]
        kept = {t: words for t, words in self.failures.items() if t in times}
        return replace(
            self, times=times, iterations=self.iterations[begin:], milliseconds=self.milliseconds[begin:],
            sources=self.sources[begin:], failures=kept,
        )  # fmt: skip

    @property
    def fallbacks(self) -> int:
        """The number of controls that are neither of a solution nor of an acceptable iterate at their sample."""
        return sum(source in ("feedback", "plan") for source in self.sources)

    def __repr__(self) -> str:
        """The essential numbers."""
        if not self.sources:
            return "ControllerStatistics(no controls yet)"
        words: dict[Source, str] = {
            "solve": "by solves",
            "iterate": "by iterates",
            "feedback": "by feedback",
            "plan": "by an old plan",
        }
        counts = Counter(self.sources)
        sources = ", ".join(f"{counts[name]} {said}" for name, said in words.items() if counts[name])
        return (
            f"ControllerStatistics({plural(len(self.sources), 'control')}: {sources}; iterations: median "
            f"{np.median(self.iterations):g}, at most {np.max(self.iterations)}; time: median "
            f"{np.median(self.milliseconds):.3g} ms, at most {np.max(self.milliseconds):.3g} ms)"
        )
