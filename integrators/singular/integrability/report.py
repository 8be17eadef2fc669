"""The printed report of a classification."""

from collections.abc import Iterator

import jax
import numpy as np

from .classification import Classification, Stratum
from .levels import Level

Line = tuple[str, str]


def report_text(classification: Classification) -> str:
    """What a reader of a paper wants to know, a line each."""
    lines = [*_problem(classification), *_morse(classification), *_levels(classification)]
    lines += _empty(classification) if classification.empty else _final(classification)
    lines.append(("time", f"{classification.seconds:.2f} s"))
    width = max(len(name) for name, _ in lines)
    return "\n".join(f"{name:<{width}}  {text}" for name, text in lines)


def _problem(c: Classification) -> Iterator[Line]:
    problem = c.problem
    kind = "abnormal (p_0 = 0)" if problem.abnormal else "normal (p_0 = 1)"
    yield "problem", f"{kind} extremals on T*Q, Q = {problem.manifold}, controls in {problem.controls}"
    if c.zero_costate_excluded:
        yield "costate", "p = 0 is excluded" + (f": {c.excluded} of the points found had it" if c.excluded else "")


def _morse(c: Classification) -> Iterator[Line]:
    if c.morse is None:
        return
    family = "is a Morse family" if c.morse.family else "is not a Morse family: the controls are redundant or dH/du degenerates"
    where = f"{_many(c.morse.points, 'point')} with dH/du = 0"
    yield "H", f"{family} (smallest singular values {_values(c.morse.family_singular_values)} at {where})"
    kind = "regular" if c.morse.regular else "singular"
    yield (
        "kind",
        f"{kind}: d2H/du2 has singular values {_values(c.morse.hessian_singular_values)}; smallest gap {c.morse.gap:.0e}",
    )


def _levels(c: Classification) -> Iterator[Line]:
    for level in c.levels:
        yield f"P^{level.index}", _level(level)


def _level(level: Level) -> str:
    if level.empty:
        return f"no consistent point from {level.tried} starts, smallest residual {level.residual:.1e} (relative)"
    strata = "; ".join(
        f"codimension {s.codimension}, free controls {s.free_controls}, rank of omega {s.form_rank}"
        + (f" ({_many(count, 'point')})" if len(level.strata) > 1 else "")
        for s, count in level.strata.items()
    )
    slow = ", Gauss-Newton only linear: irregular equations, ranks not reliable" if level.slow else ""
    gap = "none" if np.isinf(level.gap) else f"{level.gap:.0e}"
    return f"{strata} [{level.consistent} of {level.tried} points, smallest gap {gap}{slow}]"


def _empty(c: Classification) -> Iterator[Line]:
    if c.excluded:
        yield "P_f", "empty once p = 0 is excluded: every extremal found has a vanishing costate"
    else:
        yield "P_f", f"empty: the conditions up to level {c.levels[-1].index} contradict each other at every point tried"


def _final(c: Classification) -> Iterator[Line]:
    if c.stratified:
        yield "strata", f"{len(c.strata)}: P_f is not one manifold; largest dimension first"
    for i, stratum in enumerate(c.strata):
        prefix = f"({i + 1}) " if c.stratified else ""
        for name, text in _stratum(c, stratum):
            yield prefix + name, text


def _stratum(c: Classification, s: Stratum) -> Iterator[Line]:
    total, signature = 2 * c.problem.manifold.dimension, s.signature
    dimension = total - signature.codimension
    kernel = dimension - signature.form_rank
    seen = f", {_many(s.count, 'point')}" if c.stratified else ""
    yield "P_f", f"dimension {dimension} in T*Q of dimension {total}: {_equations(s)}{seen}"
    yield "k_f", f"{s.k_f} (S stops changing; P at {s.k_f_base})"
    yield "omega_f", f"rank {signature.form_rank}, kernel of dimension {kernel}" + (" (symplectic)" if not kernel else "")
    for i in range(kernel):
        yield "kernel", f"({_vector(s.kernel[0], i)}; {_vector(s.kernel[1], i)}) at q = {_point(s.q)}, p = {_point(s.p)}"
    yield "constraints", f"{kernel} first class, {signature.codimension - kernel} second class"
    yield "controls", _controls(s)


def _equations(s: Stratum) -> str:
    names = s.equations.names
    kinds = list(dict.fromkeys(names))
    return ", ".join(f"{names.count(kind)} {kind}" for kind in kinds) + " equations" if names else "no equations"


def _controls(s: Stratum) -> str:
    free = s.signature.free_controls
    known = ", ".join(f"u[{a}] by level {level}" for a, level in enumerate(s.determined_at) if level is not None)
    words = f"{len(s.determined_at) - free} determined" + (f" ({known})" if known else "")
    if not free:
        return f"{words}, none free"
    components = ", ".join(f"u[{a}]" for a in s.feedback.pivots.free)
    return f"{words}, {free} free (gauge; parametrised by {components})"


def _many(count: int, noun: str) -> str:
    return f"{count} {noun}" + ("" if count == 1 else "s")


def _values(values: np.ndarray) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def _vector(frame: object, index: int) -> str:
    return ", ".join(np.array2string(_clean(leaf[index]), precision=4, separator=", ") for leaf in jax.tree.leaves(frame))


def _point(x: object) -> str:
    return ", ".join(np.array2string(np.asarray(leaf), precision=4, separator=", ") for leaf in jax.tree.leaves(x))


def _clean(a: object) -> np.ndarray:
    return np.where(np.abs(np.asarray(a)) < 1e-9, 0.0, np.asarray(a))
