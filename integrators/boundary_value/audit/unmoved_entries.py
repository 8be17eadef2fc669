"""Entries of a prescribed end that no control moves, or that controls move only together."""

import numpy as np

from ....manifolds.numerics.tolerances import EPS, HALF
from ..transcription.kkt_system import KKTSystem
from .independence_of_boundary_conditions import independent_rows

COORDINATE_ROUNDING = EPS**HALF  # of the coordinate that is moved farthest, in units: less is rounding


def unmoved_words(system: KKTSystem, names: list[str]) -> str:
    """Words on an extremal where entries of its end depend on the other entries; else nothing."""
    moved = _end_derivatives(system)
    if not moved.size or not np.all(np.isfinite(moved)):
        return ""
    sizes = np.linalg.norm(moved, axis=1)
    if sizes.max() <= COORDINATE_ROUNDING:  # units of a search that has run away: rounding decides what depends on what
        return ""
    moved[sizes <= COORDINATE_ROUNDING * sizes.max()] = 0.0
    prescribed = np.flatnonzero(system.fixed[1])
    left = np.setdiff1d(np.arange(len(prescribed)), independent_rows(moved))
    if not left.size:
        return ""
    entries = np.abs(system.frames[-1, prescribed[left]]).argmax(axis=1)
    named = ", ".join(dict.fromkeys(names[e] for e in entries))
    return (
        f" To first order no control moves {named} of the end without the others: expected an end whose "
        "entries are independent; try to leave those free that follow (end=(..., None) in a product), or to prescribe "
        "the others alone as boundary_constraints."
    )


def _end_derivatives(system: KKTSystem) -> np.ndarray:
    """The derivatives of the prescribed coordinates of an end by the controls and the free start, in units, by rows."""
    unknowns, nodes, _ = system.scale
    step_unknowns, n = unknowns / nodes[:, None], len(nodes)
    moved = np.diag(1.0 - system.fixed[0])
    for left, right in zip(system.left * step_unknowns, system.right * step_unknowns, strict=True):
        try:
            back = np.linalg.solve(left[:, :n], np.hstack([moved, -left[:, n:]]))
        except np.linalg.LinAlgError:
            return np.zeros((0, 0))
        columns = right[:, :n] @ back
        columns[:, moved.shape[1] :] += right[:, n:]
        moved = np.linalg.qr(columns.T)[1].T  # as far as before, in no more than n directions
    return moved[system.fixed[1] > 0]
