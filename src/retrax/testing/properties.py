"""Facts about one object: samples of points and vectors, and what compiled kernels measure there."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import jax
import numpy as np

from ..manifolds import InvalidInputError, LevelSet, Manifold, MatrixLieGroup
from ..manifolds.numerics import ambient as vec
from ..manifolds.numerics.ambient import Ambient
from .draws import Sampler
from .numerics import STEP_SCALES, coarse_differences, compiled, differences, violation_kernel
from .precision import WORST, precision
from .rank import lost_rank
from .report import THE_VALUE, Batch, Check, Comparison, ConformanceError, Hint, Outcome, Report, judge, multiple
from .sites import Site, given_sites, special_sites

SAMPLE_SEEDS = tuple(range(6))

Sample = dict[str, Any]  # names of flat arrays and numbers


class Facts(ABC):
    """Measured facts of one object of the class ``kind``.

    A kernel is compiled and run when the first check reads it.

    It is run at a random point for each seed, at points where formulas often fail, as the identity, and at the
    ``points`` given. ``tolerance`` is the rounding that is allowed in values and first derivatives, relative to ``1 +``
    their size; default: 4500 times the machine epsilon of the precision that JAX is set to.
    """

    kind: type
    subject: Any
    manifold: Manifold

    def __init__(self, subject: Any, seeds: Iterable[int], points: Iterable[Ambient], tolerance: float | None) -> None:
        if not isinstance(subject, self.kind):
            raise InvalidInputError(
                f"these are the checks of a {self.kind.__name__}, got {subject!r}; see list_checks(object)"
            )
        self.subject = subject
        self.manifold = manifold = subject if isinstance(subject, Manifold) else subject.manifold
        self.seeds, self.tolerance = tuple(seeds), precision().tolerance if tolerance is None else tolerance
        points = tuple(points)
        if not self.seeds and not points:
            raise InvalidInputError(
                "the facts are measured at one random point for each seed and at the points given, got no seed and no "
                "point; try seeds=range(6)"
            )
        if not all(hasattr(leaf, "shape") and hasattr(leaf, "dtype") for leaf in jax.tree.leaves(manifold.ambient)):
            raise InvalidInputError(
                f"the ambient of {manifold} must consist of arrays without entries, got {manifold.ambient!r}; "
                "try jax.ShapeDtypeStruct((2,), float)"
            )
        self.sampler = Sampler(manifold)
        self.kernels: dict[str, Callable[..., Any]] = {}
        self._samples: dict[str, list[Sample]] = {}
        self._measured: dict[tuple[str, str], Batch] = {}
        self._broken: dict[str, Exception] = {}
        self.errors: dict[tuple, str] = {}  # those raised on the way, with the check that met each first
        self.violation = violation_kernel(manifold)
        self._given = given_sites(manifold, points)

    @cached_property
    def sites(self) -> tuple[Site, ...]:
        """The points at which samples are drawn."""
        drawn = [Site(f"seed {seed}", seed, np.asarray(self.sampler.random(seed))) for seed in self.seeds]
        return (*drawn, *special_sites(self.manifold, self.violation), *self._given)

    def fraction(self, site: Site) -> float:
        """A number in ``(0, 1]`` that grows from site to site, for lengths that differ."""
        return (1 + self.sites.index(site)) / len(self.sites)

    @abstractmethod
    def draw(self, kind: str, site: Site) -> Sample:
        """The sample of one kind and site: named flat arrays, ``x`` among them."""

    def samples(self, kind: str) -> list[Sample]:
        """The samples of one kind, one for each site."""
        if kind not in self._samples:
            self._samples[kind] = [self.draw(kind, site) for site in self.sites]
        return self._samples[kind]

    def measure(self, kernel: Callable[..., dict], *kinds: str) -> Batch:
        """Values of ``kernel(subject, sample)`` at the samples of some kinds, with the samples; the first axis counts
        them."""
        found = [self._measure_kind(kernel, kind) for kind in kinds]
        return vec.joined(found)

    def _measure_kind(self, kernel: Callable[..., dict], kind: str) -> Batch:
        name = kernel.__name__
        if name in self._broken:
            raise self._broken[name]
        if name not in self.kernels:
            self.kernels[name] = compiled(lambda sample: kernel(self.subject, sample))
        if (name, kind) not in self._measured:
            try:
                rows = [{**sample, **self.kernels[name](sample)} for sample in self.samples(kind)]
            except Exception as error:
                self._broken[name] = error
                raise
            found = vec.stacked(rows)
            places = {"place": np.array([site.words for site in self.sites]), "doubtful": self._doubtful}
            self._measured[name, kind] = {**found, **places}
        return self._measured[name, kind]

    @property
    def _doubtful(self) -> np.ndarray:
        """The sites that are points of the manifold only if ``violations``, which are being checked, say so rightly."""
        judged = self.subject is self.manifold and not isinstance(self.manifold, MatrixLieGroup)
        return np.array([judged and site.special for site in self.sites])

    def report(self, *outcomes: Outcome) -> Report:
        """The report of some outcomes."""
        failed = any(outcome.status == "fails" for outcome in outcomes)
        return Report(str(self.subject), outcomes, self._reason if failed else "")

    @cached_property
    def _reason(self) -> str:
        """Why the manifold is none, where its equations say so."""
        if not isinstance(self.manifold, LevelSet):
            return ""
        try:
            points = [site.x for site in self.sites if not site.special]
        except Exception:  # the checks that need points report it
            return ""
        return lost_rank(self.manifold, np.stack(points))

    def compare(
        self,
        what: str,
        at: Batch,
        got: Any,
        expected: Any,
        limit: float | np.ndarray,
        names: tuple[str, str] = (THE_VALUE, "the one expected"),
        hint: Hint | None = None,
    ) -> Comparison:
        """Largest difference, relative to ``1 +`` the largest entry expected, at each sample.

        ``names`` are those of the two, for the words on one that is a multiple of the other; ``hint`` has more words.
        """
        got, expected = np.asarray(got), np.broadcast_to(expected, np.shape(got))
        size = 1 + largest_entries(expected)

        def words(k: int) -> str:
            return "; ".join(
                filter(None, (multiple(got[k], expected[k], *names, precision().half), hint(k) if hint else ""))
            )

        relative = f"{what}, relative to 1 + the largest entry expected," if np.any(size > 1) else what
        return self.bound(relative, at, largest_entries(got - expected) / size, limit, hint=words)

    def compare_slopes(
        self, what: str, at: Batch, exact: np.ndarray, values: np.ndarray, step: np.ndarray | float
    ) -> Comparison:
        """Derivatives against differences of ``values`` along ``along``, to the accuracy that coarser differences
        confirm."""
        longest = np.broadcast_to(step, len(exact))
        chosen = [_best_differences(v, h) for v, h in zip(values, longest, strict=True)]
        fine, unsure, steps, sizes = (np.stack(part) for part in zip(*chosen, strict=True))
        limit = np.minimum(self.tolerance / steps + unsure, WORST)
        found = self.compare(what, at, exact, fine, limit)
        hidden = precision().floor * (1 + sizes) / steps > WORST * (1 + largest_entries(fine))
        return replace(found, hidden=hidden, because="where differences of both orders agree they are rounding")

    def bound(
        self,
        what: str,
        at: Batch,
        measured: Any,
        limit: float | np.ndarray,
        side: str = "at most",
        hint: Hint | None = None,
    ) -> Comparison:
        """A measured number at each sample, with what it is expected to be ``at most`` or ``at least``."""
        measured = np.asarray(measured, float)
        return Comparison(what, measured, np.broadcast_to(np.asarray(limit, float), measured.shape), at, side, hint)


def _best_differences(values: np.ndarray, step: float) -> tuple[np.ndarray, float, float, float]:
    """Differences of order 6 at the longest step that agrees with order 4, their distance, the step, and the size of
    values."""
    found = []
    for part, scale in zip(values, STEP_SCALES, strict=False):
        fine, coarse = (d(part, scale * step) for d in (differences, coarse_differences))
        unsure = float(np.nan_to_num(np.max(np.abs(fine - coarse), initial=0.0), nan=np.inf))
        found.append((fine, unsure, scale * step, float(np.max(np.abs(part), initial=0.0))))
        if unsure <= 0.1 * WORST * (1 + np.max(np.abs(fine), initial=0.0)):
            break
    return min(found, key=lambda one: one[1])


def largest_entries(a: np.ndarray) -> np.ndarray:
    """Largest absolute entry at each sample; NaN if any entry is."""
    return np.max(np.abs(a.reshape(a.shape[0], -1)), axis=1, initial=0.0)


def examine(
    facts: Facts, checks: Sequence[Check], only: Iterable[str] | str | None, skip: dict[str, str] | None, throw: bool
) -> Report:
    """Judge the named checks, by default all; checks in ``skip`` are left out, each with its reason."""
    skip = skip or {}
    named = [only] if isinstance(only, str) else [check.name for check in checks] if only is None else list(only)
    refuse_unknown((*named, *skip), checks)
    outcomes = [
        Outcome(check, "skipped", skip[check.name]) if check.name in skip else judge(check, facts)
        for check in checks
        if check.name in named
    ]
    report = facts.report(*outcomes)
    if throw and report.failures:
        raise ConformanceError(report)
    return report


def refuse_unknown(names: Iterable[str], checks: Sequence[Check]) -> None:
    """Raise ``InvalidInputError`` for a name that no check has."""
    known = [check.name for check in checks]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InvalidInputError(
            f"no check is named {', '.join(map(repr, unknown))}; the checks here are {', '.join(known)}"
        )
