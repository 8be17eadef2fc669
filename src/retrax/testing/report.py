"""What a check is, what it measured, and the report in words."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..manifolds import RetraxError

Batch = dict[str, Any]  # arrays whose first axis counts the samples


class ConformanceError(RetraxError):
    """Facts that an object must satisfy do not hold; the message names them, ``report`` has all that was measured."""

    def __init__(self, report: "Report") -> None:
        super().__init__(report.describe(report.failures))
        self.report = report


@dataclass(frozen=True)
class Comparison:
    """A quantity ``what``, ``measured`` at each sample of ``at``, with its ``limit`` there, ``at most`` or ``at least``."""

    what: str
    measured: np.ndarray
    limit: np.ndarray
    at: Batch
    side: str = "at most"

    @property
    def holds(self) -> np.ndarray:
        """Whether the limit is kept, at each sample; NaN keeps none."""
        return self.measured <= self.limit if self.side == "at most" else self.measured >= self.limit

    @property
    def worst(self) -> int:
        """The sample to show: one where the limit is not kept if there is one, and of these one whose value is farthest off."""
        sign = 1 if self.side == "at most" else -1
        badness = np.nan_to_num(sign * self.measured, nan=np.inf)
        return int(np.argmax(badness if self.holds.all() else np.where(self.holds, -np.inf, badness)))


@dataclass(frozen=True)
class Inapplicable:
    """Why a check says nothing about an object."""

    reason: str


@dataclass(frozen=True)
class Check:
    """A fact with a name and the measurement that tells whether it holds."""

    name: str
    fact: str
    measure: Callable[[Any], Comparison | Inapplicable]

    def __str__(self) -> str:
        return f"{self.name}: {self.fact}"


def fact(measure: Callable[[Any], Comparison | Inapplicable]) -> Check:
    """The check that a function makes: its name, and its docstring as the fact."""
    return Check(measure.__name__, " ".join((measure.__doc__ or "").split()), measure)


@dataclass(frozen=True)
class Outcome:
    """What came of one check: ``status`` is holds, fails, skipped or not applicable; ``words`` say why."""

    check: Check
    status: str
    words: str
    where: str = ""


@dataclass(frozen=True)
class Report:
    """Outcomes of the checks of one object; printing it shows them as a table."""

    subject: str
    outcomes: tuple[Outcome, ...]

    @property
    def failures(self) -> tuple[Outcome, ...]:
        """Outcomes of the facts that do not hold."""
        return tuple(outcome for outcome in self.outcomes if outcome.status == "fails")

    def describe(self, outcomes: tuple[Outcome, ...]) -> str:
        """Some of the outcomes in words, under a line that counts all of them."""
        counts = {
            status: sum(o.status == status for o in self.outcomes) for status in ("fails", "holds", "skipped", "not applicable")
        }
        lines = [
            f"{' '.join(self.subject.split())}: " + ", ".join(f"{count} {status}" for status, count in counts.items() if count)
        ]
        for outcome in outcomes:
            lines.append(f"  {outcome.status:<14} {outcome.check.name}: {outcome.words}")
            if outcome.status == "fails":
                lines += [f"{'':<16} the fact: {outcome.check.fact}"]
                lines += [f"{'':<16} {outcome.where}"] if outcome.where else []
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.describe(self.outcomes)


def judge(check: Check, facts: Any) -> Outcome:
    """Measure one fact. An error raised on the way, which may be of any kind, is a fact that does not hold."""
    try:
        found = check.measure(facts)
    except Exception as error:
        return Outcome(check, "fails", f"it could not be measured: {type(error).__name__}: {error}")
    if isinstance(found, Inapplicable):
        return Outcome(check, "not applicable", found.reason)
    k = found.worst
    words = f"{found.what} is {found.measured[k]:.3g}, expected {found.side} {found.limit[k]:.3g}"
    return Outcome(check, "holds" if found.holds.all() else "fails", words, f"at {_place(found.at, k)}")


def _place(at: Batch, k: int) -> str:
    """Seed, point and tangent vector of one sample, with its entries in flat real coordinates."""
    shown = [
        f"{name} = {np.array2string(at[name][k], precision=4, threshold=20, max_line_width=10**6)}" for name in "xv" if name in at
    ]
    return ", ".join([f"seed {at['seed'][k]}", *shown])
