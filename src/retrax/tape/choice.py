"""Choices between scalars of a CasADi graph."""

from typing import Any

import casadi as ca
import numpy as np


def select(condition: ca.SX, yes: ca.SX | float, no: ca.SX | float) -> ca.SX:
    """``yes`` where the condition holds, ``no`` elsewhere, entry by entry."""
    yes, no = (a if isinstance(a, ca.SX) else ca.SX(a) for a in (yes, no))
    over, under = _not_finite(yes), _not_finite(no)
    if not (over.any() or under.any()):
        return ca.if_else(condition, yes, no)
    value = ca.if_else(condition, ca.if_else(ca.DM(over != 0), 0, yes), ca.if_else(ca.DM(under != 0), 0, no))
    return value + _zero_if(ca.logic_not(condition), over) + _zero_if(condition, under)


def _not_finite(x: ca.SX) -> np.ndarray:
    """The constants in a matrix that are NaN or infinite, zero elsewhere."""
    elements: list[Any] = x.elements()
    entries = [float(a) if a.is_constant() else 0.0 for a in elements]
    return np.where(np.isfinite(entries), 0.0, entries).reshape(x.shape, order="F")


def _zero_if(holds: ca.SX, numbers: np.ndarray) -> ca.SX:
    """Zero where a condition holds, elsewhere numbers that are NaN, infinite, or zero too.

    By logarithms of 1, 0 and -1. Of "NaN or zero" times x CasADi would make "NaN times x, or zero", whose derivative is
    NaN times false.
    """
    infinite = ca.DM(np.sign(np.nan_to_num(numbers)))
    return ca.DM(np.isnan(numbers) * 1.0) * ca.log(2 * holds - 1) - infinite * ca.log(holds)
