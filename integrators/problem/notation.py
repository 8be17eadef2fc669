"""A problem in mathematical notation."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from .boundary_conditions import identity
from .problem_statement import ProblemStatement
from .user_functions import BoundFunction


def problem_notation(problem: ProblemStatement) -> str:
    """The statement of the problem in a few lines: minimised costs and conditions, with the names of the functions."""
    t, p = (", t" if problem.time_dependent else ""), (", p" if problem.takes_parameters else "")
    rate = "" if problem.abnormal else f"int_0^T {_name(problem.running_cost)}(q, u{t}{p}) dt"
    ends = ("q(0)", problem.initial_cost, ""), ("q(T)", problem.terminal_cost, ", T" if t else "")
    first, last = (f"{_name(cost)}({q}{time}{p})" if cost is not None else "" for q, cost, time in ends)
    nodes = "" if problem.node_cost is None else f"sum_k {_name(problem.node_cost)}(q_k, k{p})"
    terms = " + ".join(term for term in (first, rate, last, nodes) if term)
    lines = [
        f"minimise    {terms or '0, an abnormal problem'}",
        f"subject to  q' = {_name(problem.dynamics)}(q, u{t}{p}),  q in {problem.manifold},  u in {problem.controls}",
    ]
    lines += [f"            {text}" for text in _bounds(problem._limits.bounds(problem._shape))]
    lines += [f"            {name}(q, u{t}{p}) <= 0" for name in problem._limits.names]
    lines += [f"            {name}(q{t}{p}) <= 0 at the nodes" for name in problem._limits.node_names]
    if problem.sampling is not None:
        lines.append(f"            each control held for {problem.sampling.time:g}")
    last = ", T" if t else ""
    lines += [f"            {name}(q(0), q(T){last}{p}) = 0" for name in problem._boundary.names]
    turn = problem._boundary.turn
    if turn is not None:
        lines.append("            q(T) = q(0)" if turn is identity else f"            q(T) = {_name(turn)}(q(0){p})")
    lines += [f"{'where' if not place else '':12}{text}" for place, text in enumerate(problem.quantities.lines)]
    return "\n".join(lines)


def _bounds(bounds: tuple[np.ndarray, np.ndarray] | None) -> list[str]:
    """The bounds of the controls: one line where all entries have the same."""
    if bounds is None:
        return []
    lower, upper = bounds
    pairs = [(float(a), float(b)) for a, b in zip(lower.ravel(), upper.ravel(), strict=True)]
    if len(set(pairs)) == 1:
        return [text for text in [_between("u", *pairs[0])] if text]
    texts = [
        _between(f"u[{', '.join(map(str, place))}]", *pair)
        for place, pair in zip(np.ndindex(lower.shape), pairs, strict=True)
    ]
    return [", ".join(text for text in texts if text)]


def _between(name: str, lower: float, upper: float) -> str:
    below, above = (f"{lower:g} <= " if np.isfinite(lower) else ""), (f" <= {upper:g}" if np.isfinite(upper) else "")
    return f"{below}{name}{above}" if below or above else ""


def _name(function: Callable[..., Any] | Any) -> str:
    """The name of a function."""
    while isinstance(function, partial | BoundFunction):
        function = function.func if isinstance(function, partial) else function.function
    name = getattr(function, "__name__", type(function).__name__)
    return "(lambda)" if name == "<lambda>" else name
