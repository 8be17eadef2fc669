"""Entries of a prescribed end that no control moves, that controls move only together, or by less than rounding."""

import numpy as np

from ....manifolds.numerics.precision import working_precision
from ....manifolds.numerics.tolerances import EPS, HALF
from ..transcription.kkt_system import KKTSystem
from .independence_of_boundary_conditions import independent_rows

COORDINATE_ROUNDING = EPS**HALF  # of the coordinate that is moved farthest, in units: less is rounding


def unmoved_words(system: KKTSystem, names: list[str]) -> str:
    """Words on an extremal where entries of its end depend on the other entries; else nothing."""
    moved, _ = _linearized_end(system)
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


def rounding_of_controls(system: KKTSystem, controls: np.ndarray) -> float:
    """The error of controls, shape (S, ...), that rounding and defects of the prescribed end cause.

    It is relative to the largest control, or to the scaling of the controls where all are smaller. The rounding of an
    entry of the end is relative to its largest size along the trajectory. Entries that follow from the others are left
    out: the defects show whether these entries agree.
    """
    prescribed, nodes = system.fixed[1] > 0, system.scale.nodes
    moved, defects = _linearized_end(system)
    if not controls.size or not moved.size or not np.all(np.isfinite(moved)):
        return 0.0
    sizes = ((np.abs(system.frames[-1]) @ np.abs(system.nodes).max(axis=0)) / nodes)[prescribed]
    reached = [k for k in independent_rows(moved) if sizes[k] > 0]
    left, shares, _ = np.linalg.svd(moved[reached] / sizes[reached, None], full_matrices=False)
    if not shares.size:
        return 0.0
    precision = np.finfo(working_precision()).eps
    with np.errstate(all="ignore"):
        missed = np.linalg.norm((left.T @ (defects[reached] / sizes[reached])) / shares)
        error = precision / shares[-1] + missed
    used = np.max(np.abs(controls)) / np.max(system.scale.unknowns[len(nodes) :])
    return float(error / max(used, 1.0))


def _linearized_end(system: KKTSystem) -> tuple[np.ndarray, np.ndarray]:
    """The derivatives of the prescribed coordinates of an end, and the changes of these coordinates that remove all
    defects; in units.

    The derivatives by the controls and the free start are in rows.
    """
    unknowns, nodes, _ = system.scale
    step_unknowns, n = unknowns / nodes[:, None], len(nodes)
    moved, (change, *defects) = np.diag(1.0 - system.fixed[0]), -system.defects[..., None] / nodes[:, None]
    for left, right, defect in zip(system.left * step_unknowns, system.right * step_unknowns, defects, strict=True):
        try:
            back = np.linalg.solve(left[:, :n], np.hstack([change, moved, -left[:, n:]]))
        except np.linalg.LinAlgError:
            return np.zeros((0, 0)), np.zeros(0)
        columns = right[:, :n] @ back
        change, columns = columns[:, :1] + defect, columns[:, 1:]
        columns[:, moved.shape[1] :] += right[:, n:]
        moved = np.linalg.qr(columns.T)[1].T  # as far as before, in no more than n directions
    prescribed = system.fixed[1] > 0
    return moved[prescribed], change[prescribed, 0]
