"""The printed report of a classification."""

from collections.abc import Iterator

import jax
import numpy as np

from ....manifolds import Manifold
from ...reporting.text import Line, counted, table
from .. import wording
from .algorithm_stages import Level
from .classification import Classification, Stratum

SHOWN = 1e-9  # of the size of numbers: smaller ones are shown as zeros


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
    where = f"{counted(c.morse.count, 'point')} with dH/du = 0"
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
        wording.level_words(*signature) + (f" ({counted(count, 'point')})" if len(level.strata) > 1 else "")
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
    seen = f", {counted(s.count, 'point')}" if c.stratified else ""
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
