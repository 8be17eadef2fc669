"""Rules whose derivatives hold numbers fixed, and agree with JAX at zero, at ties and at limits."""

import math
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from ..jaxpr_tools import name_of
from .arrays import Complex, Entries, broadcast, column, is_complex, is_known, move_entries, parts, scalars
from .choice import select
from .complex_rules import complex_power
from .elementwise import larger, smaller, square_root
from .graph import Graph
from .linear import LINEAR


def _extreme(graph: Graph, eqn: Any, x: Any) -> Entries:
    """The largest or the smallest entry, of whose derivative all that are equal to it have the same share."""
    value: Any = LINEAR[name_of(eqn)](eqn.params, x)
    if x.size <= 2 * value.size:  # of two each has a half
        return value
    best, axes = graph.constant(value.values), eqn.params["axes"]
    rows = tuple(1 if axis in axes else size for axis, size in enumerate(x.shape))
    level = column(move_entries(scalars(best, rows), lambda a: np.broadcast_to(a, x.shape)))
    equal = ca.logic_and(column(x) == level, ca.fabs(level) < np.inf)
    total: Any = LINEAR["reduce_sum"]
    beside, count = (
        column(total(eqn.params, scalars(part, x.shape))) for part in (select(equal, column(x) - level, 0.0), equal)
    )
    return scalars(best + beside / ca.fmax(count, 1), value.shape)


def _power(graph: Graph, eqn: Any, x: Any, y: Any) -> Entries:
    """``x**y``, without a derivative by ``y`` where ``x`` is zero, and without one by ``x`` where ``y`` is."""
    if is_complex(x) or is_complex(y):
        alike, shape = broadcast(*parts(x), *parts(y))
        a, b, c, d = map(column, alike)
        return Complex(*(scalars(part, shape) for part in complex_power((a, b), (c, d))))
    alike, shape = broadcast(x, y)
    count = math.prod(shape)
    base, exponent = (a if a.shape[0] == count else ca.repmat(a, count, 1) for a in map(column, alike))
    if is_known(y):
        halves = np.flatnonzero(np.broadcast_to(y, shape) == 0.5).tolist()
        value = base**exponent
        for k in halves:
            value[k] = square_root(base[k])
        return scalars(value, shape)
    fixed, none = graph.constant(exponent), base == 0
    at_zero = select(fixed == 0, 1.0, select(none, base, 1.0) ** select(fixed == 0, 1.0, fixed))
    return scalars(select(none, at_zero, select(none, 1.0, base) ** exponent), shape)


def _clamp(graph: Graph, eqn: Any, low: Any, x: Any, high: Any) -> Entries:
    """An entry between two limits, without a derivative at a limit."""
    alike, shape = broadcast(low, x, high)
    least, value, most = map(column, alike)
    raised, lowered = ca.logic_and(least > value, least < most), ca.logic_and(most < value, least <= np.inf)
    beside = select(lowered, most, graph.constant(smaller(larger(value, least), most)))
    inside = ca.logic_and(least < value, value < most)
    return scalars(select(inside, value, select(raised, least, beside)), shape)


BY_MARKS: dict[str, Callable[..., Entries]] = {
    "clamp": _clamp,
    "pow": _power,
    "reduce_max": _extreme,
    "reduce_min": _extreme,
}
