"""The immutable record of a classified optimal control problem, and its report."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jaxtyping import ArrayLike

from ....manifolds import (
    CotangentBundle,
    Euclidean,
    Immersion,
    InvalidInputError,
    Manifold,
    PresymplecticManifold,
    Submanifold,
)
from ....manifolds.numerics.ambient import Ambient
from ...problem.optimal_control_problem import OptimalControlProblem, is_same_problem
from ...reporting.text import Line, plural, table
from .. import wording
from ..integrability_result import IntegrabilityResult
from .algorithm_stages import Level
from .final_equations import FinalEquations
from .lagrangian_submanifolds import immersed_dynamics
from .sample_points import APPROACHED
from .strata import Stratum

SHOWN = 1e-9  # of the size of numbers: smaller ones are shown as zeros


@dataclass(frozen=True)
class MorseTest:
    r"""A test at points with ``dH/du = 0`` whether ``H`` is a Morse family and whether the problem is regular.

    Attributes
    ----------
    count : int
        The number of points.
    states : pair of points and covectors
        The points ``(q, p)``, shape ``(count, *leaf)``.
    controls : array, or tuple of arrays
        The controls there.
    family : bool
        Whether :math:`D(\partial H / \partial u)` has rank m at all points.
    family_singular_values : array
        Singular values at the point with the smallest one, in units of the sizes of the problem.
    regular : bool
        Whether :math:`\partial^2 H / \partial u^2` has rank m at all points.
    hessian_singular_values : array
        Its singular values, likewise.
    gap : float
        The last counted singular value over the first one that is not counted.
    """

    count: int
    states: Ambient
    controls: Ambient
    family: bool
    family_singular_values: np.ndarray
    regular: bool
    hessian_singular_values: np.ndarray
    gap: float


@dataclass(frozen=True, eq=False)
class Classification(IntegrabilityResult[Stratum]):
    """The result of the integrability algorithm at points of ``T*Q``, with the evidence of each level.

    Attributes
    ----------
    problem : OptimalControlProblem
        The problem.
    strata : tuple of Stratum
        The pieces of ``P_f``, largest dimension first. The properties describe the first one.
    morse : MorseTest or None
        The test for a Morse family and for regularity; None if no point was found.
    levels : tuple of Level
        The evidence, level by level.
    excluded : int
        The number of points that were left out.
    zero_costate_excluded : bool
        Whether extremals with ``p = 0`` were left out.
    digest : bytes or None
        A digest of the functions of the problem.
    jump : str
        Words on a jump of the functions between the points, on whose sides ``P_f`` may differ; empty without one.
    """

    morse: MorseTest | Any
    levels: tuple[Level, ...]
    excluded: int
    zero_costate_excluded: bool
    digest: bytes | None = field(repr=False)
    jump: str = field(default="", repr=False)

    @property
    def regular(self) -> bool:
        """Whether ``dH/du = 0`` determines every control: then ``P_f = T*Q``."""
        return self.morse is not None and self.morse.regular

    @property
    def irregular(self) -> bool:
        """Whether Gauss-Newton was slow: the differentials of the equations vanish or become dependent on their zero
        set."""
        return any(level.slow for level in self.levels)

    @property
    def reliable(self) -> bool:
        """Whether every level has points where its equations are regular and ranks clear, so that ``P_f`` is known."""
        return not any(level.unknown for level in self.levels)

    @property
    def contradictory(self) -> bool:
        """Whether no piece was found because the conditions contradict each other, not for want of a point that meets
        them."""
        if not self.empty or self.excluded:
            return self.empty
        return self.levels[-1].residual > APPROACHED and self.levels[-1].opposed

    @property
    def sparse(self) -> bool:
        """Whether half of the points or more are missing: not found, or left out for irregular equations or unclear
        ranks."""
        return self.reliable and not self.empty and any(2 * level.missing >= level.tried for level in self.levels)

    def is_of(self, problem: OptimalControlProblem) -> bool:
        """Whether this is the classification of a problem whose functions still compute the same.

        Parameters
        ----------
        problem : OptimalControlProblem
            The problem.
        """
        unchanged = self.digest is None or self.digest == problem._digest()
        return unchanged and is_same_problem(self.problem, problem)

    def require_reliable(self) -> None:
        """Raise ``InvalidInputError`` if the equations of ``P_f`` are irregular or ranks not clear, so that nothing is
        known."""
        if self.reliable:
            return
        if any(level.unknown and level.slow == level.consistent for level in self.levels):
            raise InvalidInputError(
                "the equations of P_f are irregular: their differentials vanish or depend on each other on P_f, so "
                f"they do not make it a manifold\n{self}\nreplace them by equivalent ones, as x = 0 for x^2 = 0, in "
                "the problem"
            )
        raise InvalidInputError(
            "P_f is not known: at every point found, a number that decides a rank may be zero or not within the "
            "precision of the point, or a function underflows or is smaller than the rounding of the "
            f"others\n{self}\ntry near=(q, p), a state where the functions are of comparable size, or other units"
        )

    @property
    def gauge_components(self) -> tuple[int, ...]:
        """Components of the control that you can choose freely; the remaining components follow from the choice and the
        state.

        They are entries of ``u`` in R^m; on another U coordinates in its chart around ``stratum.feedback.center``.
        """
        return self.stratum.feedback.pivots.free

    @property
    def equations(self) -> FinalEquations:
        """Equations of ``P_f``, a JAX function of ``z = (q, p)`` with values of shape ``(codimension,)``."""
        return self.stratum.equations

    @cached_property
    def manifold(self) -> Submanifold | Any:
        """``P_f`` as an embedded manifold; ``Projection(P_f)`` is a retraction of it, ``P_f.nearby(z)`` a point of it
        near ``z``.

        Valid around the point of the stratum, as far as the elimination of the controls reaches. Raises
        ``InvalidInputError`` if the equations are irregular there.
        """
        self.require_reliable()
        bundle = CotangentBundle(self.problem.manifold)
        return Submanifold(bundle, self.equations, self.stratum.piece) if self.codimension else bundle

    @property
    def presymplectic(self) -> PresymplecticManifold:
        """``(P_f, omega_f)``: with the rank and the kernel of the form at any point of ``P_f``."""
        return PresymplecticManifold(self.manifold, CotangentBundle(self.problem.manifold).two_form)

    def control(self, q: Ambient, p: Ambient, gauge: ArrayLike | None = None) -> Ambient:
        """The control at a point of ``P_f``, a JAX function that is compiled at its first call.

        Parameters
        ----------
        q, p : point, covector
            A point of ``P_f``.
        gauge : array_like of shape (gauge controls,), optional
            The components ``gauge_components``; by default their values at the point of the stratum.

        Notes
        -----
        Entries are NaN where the equations do not determine the other components, as on a piece of ``P_f`` that was not
        told apart from that of the stratum.
        """
        return self._control((q, p), gauge)

    @cached_property
    def _control(self) -> Callable[..., Ambient]:
        feedback = self.stratum.feedback
        return jax.jit(lambda z, gauge: feedback.determined_control(z, gauge))

    @property
    def dynamics(self) -> Immersion:
        """``S_f`` in ``(TP_f, d_T omega_f)``, immersed from ``P_f`` times the space of gauge controls."""
        control = self.stratum.feedback.control
        return immersed_dynamics(self.problem, self.manifold, Euclidean(self.gauge_controls), control)

    def __str__(self) -> str:
        return report_text(self)

    def __repr__(self) -> str:
        nothing = "empty" if self.contradictory else "no point found"
        kind = nothing if self.empty else f"dim P_f = {self.dimension}, k_f = {self.k_f}"
        return f"Classification({kind})"


def report_text(classification: Classification) -> str:
    """The report for readers of papers, a line for each fact."""
    lines = [*_problem(classification), *_morse(classification), *_levels(classification)]
    lines += _empty(classification) if classification.empty else _final(classification)
    return table(lines)


def _problem(c: Classification) -> Iterator[Line]:
    yield "problem", wording.problem_words(c.problem)
    if c.zero_costate_excluded:
        yield "costate", wording.EXCLUDED + (f": {c.excluded} of the points found had it" if c.excluded else "")

    if c.jump:
        yield "JUMP", f"{c.jump}; {wording.ON_EACH_SIDE}"


def _morse(c: Classification) -> Iterator[Line]:
    if c.morse is None:
        return
    where = f"{plural(c.morse.count, 'point')} with dH/du = 0"
    values = f"smallest singular values {_values(c.morse.family_singular_values)} at {where}"
    yield "H", f"{wording.family_words(c.morse.family)} ({values})"
    kind = "regular" if c.morse.regular else "singular"
    yield "kind", f"{kind}: d2H/du2 has singular values {_values(c.morse.hessian_singular_values)}; {_gap(c.morse.gap)}"


def _levels(c: Classification) -> Iterator[Line]:
    for level in c.levels:
        yield f"P^{level.index}", _level(level)


def _level(level: Level) -> str:
    if level.empty:
        return f"no consistent point from {level.tried} starts, smallest residual {level.residual:.1e} (relative)"
    strata = "; ".join(
        wording.level_words(*signature) + (f" ({plural(count, 'point')})" if len(level.strata) > 1 else "")
        for signature, count in level.strata.items()
    )
    return f"{strata} [{level.consistent} of {level.tried} points, {_gap(level.gap)}{_irregular(level)}]"


def _irregular(level: Level) -> str:
    notes = [(level.unclear, "where ranks are not decided")] if level.unclear else []
    notes += [(level.slow, "where equations are irregular, as where pieces cross")] if level.slow else []
    if level.unknown and level.slow == level.consistent:
        return ", equations irregular at all of them: ranks not reliable"
    if level.unknown and level.unclear == level.consistent:
        return ", ranks not decided at any of them"
    return "".join(
        f", {count} of them {where}: {'ranks not reliable' if level.unknown else 'not counted'}"
        for count, where in notes
    )


def _gap(gap: float) -> str:
    return "smallest gap " + ("infinite" if np.isinf(gap) else f"{gap:.0e}")


def _empty(c: Classification) -> Iterator[Line]:
    if c.excluded:
        yield "P_f", wording.EMPTY_WITHOUT_IT
    else:
        level = c.levels[-1]
        text = wording.unmet_words(level.index) if c.contradictory else wording.approached_words(level.residual)
        yield "P_f", text + (wording.WITH_IT if c.zero_costate_excluded else "")


def _final(c: Classification) -> Iterator[Line]:
    if c.sparse:
        worst = max(c.levels, key=lambda level: level.missing)
        yield "LEFT OUT", wording.sparse_words(worst.missing, worst.tried)
    if c.stratified:
        yield "strata", wording.strata_words(len(c.strata))
    for i, stratum in enumerate(c.strata):
        prefix = f"[{i}] " if c.stratified else ""
        for name, text in _stratum(c, stratum):
            yield prefix + name, text


def _stratum(c: Classification, s: Stratum) -> Iterator[Line]:
    total, codimension = 2 * c.problem.manifold.dimension, s.codimension
    kernel = total - codimension - s.rank
    seen = f", {plural(s.count, 'point')}" if c.stratified else ""
    if not c.reliable:
        yield (
            "NOT RELIABLE",
            wording.UNRELIABLE
            if any(level.unknown and level.slow == level.consistent for level in c.levels)
            else wording.UNDECIDED,
        )
    yield "P_f", wording.final_words(total - codimension, total, s.equations.names) + seen
    if c.irregular and c.reliable and not s.flat:
        yield "pieces", wording.CURVED_PIECES
    if c.stratified:
        yield "point", f"q = {_point(s.q)}, p = {_point(s.p)}"
    yield "k_f", wording.stop_words(s.k_f, s.k_f_base)
    yield "omega_f", wording.form_words(s.rank, kernel)
    for i in range(kernel):
        yield (
            "kernel",
            f"({_vector(s.kernel[0], i)}; {_vector(s.kernel[1], i)}) at q = {_point(s.q)}, p = {_point(s.p)}",
        )
    yield "constraints", wording.class_words(codimension, kernel)
    yield (
        "controls",
        _controls(c.problem.controls, s) + wording.chart_words(c.problem.controls, _point(s.feedback.center)),
    )


def _controls(controls: Manifold, s: Stratum) -> str:
    free, names = s.free_controls, [wording.component_words(controls, a) for a in range(len(s.determined_at))]
    levels = zip(names, s.determined_at, strict=True)
    known = ", ".join(f"{name} by level {level}" for name, level in levels if level is not None)
    determined = f"{len(s.determined_at) - free} determined" + (f" ({known})" if known else "")
    if not free:
        return f"{determined}, none free"
    components = ", ".join(names[a] for a in s.feedback.pivots.free)
    return f"{determined}, {free} free (gauge; parametrised by {components})"


def _values(values: np.ndarray) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def _vector(frame: object, index: int) -> str:
    return ", ".join(_array(leaf[index], 1.0) for leaf in jax.tree.leaves(frame))


def _point(x: object) -> str:
    return ", ".join(_array(leaf, float(np.max(np.abs(leaf), initial=0.0))) for leaf in jax.tree.leaves(x))


def _array(a: object, size: float) -> str:
    """Numbers of this size, rounding among them as zeros."""
    values = np.asarray(a)
    return np.array2string(np.where(np.abs(values) < SHOWN * size, 0.0, values), precision=4, separator=", ")
