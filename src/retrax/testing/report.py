"""The record of a check, its measurement, and the report in words."""

import re
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ..errors import TRACEABLE
from ..manifolds import RetraxError
from .precision import precision

NAN = (
    "a value or a derivative is NaN, as that of a norm at v = 0; try jnp.where with arguments that are safe in both "
    "branches, or a domain without this point"
)
DOUBTFUL = (
    "`violations` are zero there; if that is not a point of the manifold, try adding the equation that excludes it"
)
THE_VALUE = "the value"
_TOLD = re.compile(r"EquinoxRuntimeError: (.+)")  # the line of an error of a compiled program that is for its user
# Folders of files that errors pass through on their way from what is checked.
_INNER = ("/jax/", "/equinox/", "/numpy/", "/retrax/testing/", "/numerics/shapes.py", "/level_set.py", "/functools.py")

Batch = dict[str, Any]  # arrays whose first axis counts the samples
Hint = Callable[[int], str]  # words on one sample: what it looks like, what to try; empty if there is nothing to say


class ConformanceError(RetraxError):
    """The error of an object with facts that do not hold; the message names them.

    Parameters
    ----------
    report : Report
        The measurements.
    """

    def __init__(self, report: "Report") -> None:
        super().__init__(report.describe(report.failures))
        self.report = report


@dataclass(frozen=True)
class Comparison:
    """A quantity ``what``, ``measured`` at each sample of ``at``, with its ``limit`` there, ``at most`` or ``at
    least``.

    At samples that are ``hidden`` it says nothing in this precision, ``because`` of something.
    """

    what: str
    measured: np.ndarray
    limit: np.ndarray
    at: Batch
    side: str = "at most"
    hint: Hint | None = None
    hidden: np.ndarray | None = None
    because: str = ""

    @property
    def decided(self) -> np.ndarray:
        """The samples at which something is said."""
        return np.ones(len(self.measured), bool) if self.hidden is None else ~self.hidden

    @property
    def holds(self) -> np.ndarray:
        """Whether the limit is kept, at each sample at which something is said; NaN keeps none."""
        kept = self.measured <= self.limit if self.side == "at most" else self.measured >= self.limit
        return kept | ~self.decided

    @property
    def worst(self) -> int:
        """The sample to show: one where the limit is not kept if there is one, and of these one whose value is farthest
        off.

        A point that may be none of the manifold is shown only if it is kept at all others.
        """
        sign = 1 if self.side == "at most" else -1
        badness = np.where(self.decided, np.nan_to_num(sign * self.measured, nan=np.inf), -np.inf)
        failing, certain = ~self.holds, ~self.at["doubtful"]
        shown = failing & certain if np.any(failing & certain) else failing
        return int(np.argmax(np.where(shown, badness, -np.inf) if failing.any() else badness))


@dataclass(frozen=True)
class Inapplicable:
    """Why a check says nothing about an object."""

    reason: str


@dataclass(frozen=True)
class Check:
    """A fact with a name and the measurement that decides whether it holds.

    Attributes
    ----------
    name, fact : str
        A name, and the fact in words.
    measure : callable
        A function of the facts of an object that returns a comparison.
    """

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
    """The outcome of one check.

    Attributes
    ----------
    check : Check
        The check.
    status : str
        ``"holds"``, ``"fails"``, ``"not decided"``, ``"skipped"`` or ``"not applicable"``.
    words : str
        The reason.
    where : str
        The place of a failure.
    same_as : str
        The check that met the same error first.
    """

    check: Check
    status: str
    words: str
    where: str = ""
    same_as: str = ""  # the check that met the same error first


@dataclass(frozen=True)
class Report:
    """The outcomes of the checks of one object; printed, a table.

    Attributes
    ----------
    subject : str
        The object.
    outcomes : tuple of Outcome
        The outcomes.
    reason : str
        One reason for several failures.
    """

    subject: str
    outcomes: tuple[Outcome, ...]
    reason: str = ""

    @property
    def failures(self) -> tuple[Outcome, ...]:
        """The outcomes of facts that do not hold."""
        return tuple(outcome for outcome in self.outcomes if outcome.status == "fails")

    def describe(self, outcomes: tuple[Outcome, ...]) -> str:
        """Some of the outcomes in words, below a line that counts all of them.

        Parameters
        ----------
        outcomes : tuple of Outcome
            The outcomes.
        """
        counts = {
            status: sum(o.status == status for o in self.outcomes)
            for status in ("fails", "holds", "not decided", "skipped", "not applicable")
        }
        lines = [
            f"{' '.join(self.subject.split())}: "
            + ", ".join(f"{count} {status}" for status, count in counts.items() if count)
        ]
        lines += [f"  {self.reason}"] if self.reason else []
        again = [outcome.check.name for outcome in outcomes if outcome.same_as]
        for outcome in outcomes:
            if outcome.same_as:
                continue
            lines.append(f"  {outcome.status:<14} {outcome.check.name}: {outcome.words}")
            if outcome.status == "fails":
                lines += [f"{'':<16} the fact: {outcome.check.fact}"]
                lines += [f"{'':<16} {outcome.where}"] if outcome.where else []
        if again:
            lines.append(f"  {'fails':<14} for the same error: {', '.join(again)}")
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.describe(self.outcomes)


def judge(check: Check, facts: Any) -> Outcome:
    """Measure one fact. An error raised on the way, which may be of any kind, is a fact that does not hold."""
    try:
        found = check.measure(facts)
    except Exception as error:
        words, first = _in_words(error, check, facts)
        return Outcome(check, "fails", f"it could not be measured: {words}", same_as=first)
    if isinstance(found, Inapplicable):
        return Outcome(check, "not applicable", found.reason)
    unsaid = f"not decided in {precision().name} precision" + (f": {found.because}" if found.because else "")
    if not found.decided.any():
        return Outcome(check, "not decided", unsaid)
    k = found.worst
    words = f"{found.what} is {number(found.measured[k])}, expected {found.side} {number(found.limit[k])}"
    if found.holds.all():
        if not found.decided.all():
            words += f"; at {np.sum(~found.decided)} of {len(found.decided)} samples it is {unsaid}"
        return Outcome(check, "holds", words, f"at {_place(found.at, k)}")
    hint = NAN if np.isnan(found.measured[k]) else found.hint(k) if found.hint else ""
    if found.at["doubtful"][k]:
        hint = f"{DOUBTFUL}; otherwise {hint}" if hint == NAN else "; ".join(filter(None, (hint, DOUBTFUL)))
    return Outcome(check, "fails", words + (f"; {hint}" if hint else ""), f"at {_place(found.at, k)}")


def number(value: float) -> str:
    """A number as reports show it: two digits of what is small or large, three of what is neither."""
    return f"{value:.3g}" if value == 0 or 1e-2 <= abs(value) < 1e4 or not np.isfinite(value) else f"{value:.1e}"


def multiple(got: np.ndarray, expected: np.ndarray, name: str, other: str, rounding: float) -> str:
    """Words where what came is a multiple of what was expected by another factor than 1; empty where it is none."""
    # Any two numbers are multiples.
    square = np.sum(expected * expected) if expected.size > 1 or name != THE_VALUE else 0.0
    factor = np.sum(got * expected) / square if square > 0 else np.nan
    if np.max(np.abs(got - factor * expected), initial=0.0) <= rounding * np.sqrt(square) and abs(factor - 1) > 5e-4:
        return f"{name} is {factor:.3f} times {other}"
    return ""


def _in_words(error: Exception, check: Check, facts: Any) -> tuple[str, str]:
    """An error with its first line and the place that it comes from, and the check that met the same one before, if any
    did."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not any(part in f.filename for part in _INNER)]
    where = f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
    told = _TOLD.search(str(error))
    line = told[1] if told else next(iter(str(error).strip().splitlines()), "no message")
    first = facts.errors.setdefault((type(error), where or line), check.name)
    if first != check.name:
        return f"the {type(error).__name__}{where} of {first}", first
    if told:
        return line, ""
    advice = f"; {TRACEABLE}" if isinstance(error, jax.errors.JAXTypeError) else ""
    return f"{type(error).__name__}{where}: {line}{advice}", ""


def _place(at: Batch, k: int) -> str:
    """Where one sample is, its point and its tangent vector, with their entries in flat real coordinates."""
    return ", ".join([str(at["place"][k]), *(f"{name} = {entries(at[name][k])}" for name in "xv" if name in at)])


def entries(a: np.ndarray) -> str:
    """The entries of a vector on one line, the first and the last of many."""
    return np.array2string(a, precision=4, threshold=20, max_line_width=10**6)
