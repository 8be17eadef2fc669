"""Roots of small systems, by a loop of Newton's method: what ``find_root`` computes with as many steps as it needs."""

from collections.abc import Callable
from functools import reduce
from typing import Any

import casadi as ca
import numpy as np

from ..newton_constants import MAX_JACOBIANS, PROBE, QUADRATIC_POWER, SMALLEST_PART
from .arrays import Entries, NotTraceableError, column, is_complex, scalars, take
from .choice import select
from .elementwise import larger
from .linear import LARGEST_FACTOR, inverse

PRIMITIVE = "implicit_root"
LONGEST_STEP_PROGRAM = (
    10_000  # instructions, or about so many, of a step of Newton's method for all roots of one equation: of
)
# their derivatives there are many times more
EPS = float(np.finfo(float).eps)
SETTLED_STEP = 64 * EPS  # of the unknowns' sizes: a step that is no longer leaves rounding
LAST_QUADRATIC_STEP = (
    EPS**QUADRATIC_POWER
)  # of the unknowns' sizes: a step that is no longer is the last but for rounding

System = Callable[[Any, list[Any]], ca.Function]
Looped = Callable[[ca.SX, ca.SX, ca.Function, int], ca.SX]


def roots(params: dict[str, Any], arrays: list[Any], system: System, loop: Looped, copies: int = 1) -> list[Entries]:
    """The roots, and whether the iteration converged to them, of an equation with axes of ``vmap``.

    ``system(jaxpr, operands)``: the residual and its Jacobian as a function of the unknowns and of all scalars of the
    operands, one column each; ``loop(first, given, body, rounds)``: what a loop leaves (``graph.Loop``); ``copies``:
    how many such roots there are.
    """
    if any(is_complex(a) for a in arrays):
        raise NotTraceableError(PRIMITIVE, "here of complex numbers")
    if params["axes"]:
        return _batch(params, arrays, system, loop, copies)
    start, operands = arrays[0], arrays[params["begin"] :]
    if params["known"]:
        return [start, np.array(True)]
    count = start.shape[0]
    if count > LARGEST_FACTOR:
        raise NotTraceableError(PRIMITIVE, f"here of {count} unknowns, where a tape has at most {LARGEST_FACTOR}")
    function, at = system(params["jaxpr"], operands), ca.vertcat(ca.SX(0, 1), *(column(a) for a in operands))
    length = copies * (function.n_instructions() + count**3)  # with an elimination
    if length > LONGEST_STEP_PROGRAM:
        raise NotTraceableError(
            PRIMITIVE, f"here of {length} instructions for a step, where a tape has at most {LONGEST_STEP_PROGRAM}"
        )
    root, converged = _root(function, column(start), at, loop)
    return [scalars(root, (count,)), scalars(converged, ())]


def _batch(params: dict[str, Any], arrays: list[Any], system: System, loop: Looped, copies: int) -> list[Entries]:
    """The roots of a batch along the first axis; the outermost level of ``vmap`` is the last entry of the axes."""
    *inner, outer = params["axes"]
    size = next(a.shape[axis] for a, axis in zip(arrays, outer, strict=True) if axis is not None)
    one = {**params, "axes": tuple(inner)}
    found = []
    for k in range(size):
        own = [a if axis is None else _slice(a, axis, k) for a, axis in zip(arrays, outer, strict=True)]
        found.append(roots(one, own, system, loop, copies * size))
    return [
        scalars(ca.vertcat(*(column(each[part]) for each in found)), (size, *found[0][part].shape)) for part in (0, 1)
    ]


def _slice(a: Any, axis: int, k: int) -> Any:
    places = np.arange(int(np.prod(a.shape))).reshape(a.shape)
    return take(a, np.take(places, k, axis))


def _root(system: ca.Function, start: ca.SX, at: ca.SX, loop: Looped) -> tuple[ca.SX, ca.SX]:
    count = start.shape[0]
    state = loop(ca.vertcat(ca.densify(start), np.inf), at, _step(system, count, at.shape[0]), MAX_JACOBIANS)
    c, step = state[:count], state[count]
    inverted = _inverse(system.call([c, at], True, False)[1])
    moves = [ca.mtimes(inverted, system.call([c + moved, at], True, False)[0]) for moved in _patterns(c)]
    changed = SMALLEST_PART * EPS * ca.SX.ones(c.shape[0])
    for move in moves[1:]:
        changed = larger(changed, ca.fabs(move - moves[0]))
    # An unknown may be as small as the rounding of others: its size says nothing of how exactly it can be known.
    rounding = _largest(ca.fabs(moves[0]) / changed) <= PROBE
    return c, select(step <= LAST_QUADRATIC_STEP, 1.0, select(rounding, 1.0, 0.0))


def _step(system: ca.Function, count: int, given: int) -> ca.Function:
    """A step of Newton's method from the unknowns and the size of the step that led to them; none after a step that
    leaves rounding."""
    c, step, at = ca.SX.sym("c", count), ca.SX.sym("step"), ca.SX.sym("at", given)
    residual, jacobian = system.call([c, at], True, False)
    move, settled = ca.densify(ca.mtimes(_inverse(jacobian), residual)), step <= SETTLED_STEP
    after, size = ca.if_else(settled, c, c - move), ca.if_else(settled, step, _largest(move))
    return ca.Function("step", [ca.vertcat(c, step), at], [ca.vertcat(after, size), size <= SETTLED_STEP])


def _patterns(c: ca.SX) -> list[ca.SX]:
    """No move of the unknowns, and moves of some of their roundings."""
    turns = ca.DM(1.0 - 2.0 * (np.arange(c.shape[0]) % 2))
    units = PROBE * EPS * larger(ca.fabs(c), ca.SX.ones(c.shape[0]))
    return [0 * c, turns * units, -turns * units, units]


def _inverse(jacobian: ca.SX) -> ca.SX:
    """Its inverse, with rows in units of their largest entries, which are pivots that compare then."""
    if jacobian.shape[0] == 1:
        return 1 / ca.densify(jacobian)
    rows = [_largest(jacobian[k, :].T) for k in range(jacobian.shape[0])]
    units = ca.vertcat(*(select(row > 0, row, 1.0) for row in rows))
    return ca.mtimes(inverse(jacobian / ca.repmat(units, 1, jacobian.shape[1])), ca.diag(1 / units))


def _largest(vector: ca.SX) -> ca.SX:
    return reduce(larger, ca.vertsplit(ca.fabs(ca.densify(vector))))
