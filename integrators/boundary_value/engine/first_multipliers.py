"""First multipliers, where the cost alone does not say which way to go.

Without multipliers the Hessian of the Lagrangian is that of the cost. Where it is flat in a direction that the
constraints leave free, as in every problem of least time, Newton's step has no length of its own: how the constraints
bend is what bounds it, and that the multipliers weigh. So they are taken first, alone, from a step in which all moves
cost about what their sizes make natural.
"""

from typing import Any

import numpy as np

from .batches import merged

SHIFT = 1.0  # of the Hessian: a move by the unit of a coordinate costs as much as the unit of the cost
NEGATIVE = 1e-9  # of the largest eigenvalue of a block: one that is below zero by less is none


def with_first_multipliers(conditions: Any, iterate: Any, assembled: Any, flat: np.ndarray) -> Any:
    """The iterate with multipliers where those of the members that are ``flat`` are zero; itself where none is.

    Not where the cost is curved downward: the shift that makes up for that bounds the step.
    """
    parts = getattr(iterate, "parts", (iterate,))
    flat = flat & ~np.any([np.any(part.costates, axis=(1, 2)) for part in parts], axis=0)
    if flat.any():
        flat &= np.all([_is_convex(part.blocks.hessian) for part in getattr(assembled, "parts", (assembled,))], axis=0)
    if not flat.any():
        return iterate
    step, _, _ = conditions.eliminate(iterate, assembled, np.full(len(flat), SHIFT))
    moved = conditions.move(iterate, assembled, step.of_multipliers, np.ones(len(flat)))
    return merged(flat & step.finite, moved, iterate)


def has_flat_controls(assembled: Any) -> np.ndarray:
    """Whether the Hessian has no curvature at all in a control, shape (B,).

    Where it has some and the system is singular all the same, constraints depend on each other.
    """
    parts = getattr(assembled, "parts", (assembled,))
    return np.any([np.any(p.extent.curvature[:, p.gap.shape[2] :] == 0, axis=1) for p in parts], axis=0)


def _is_convex(hessian: np.ndarray) -> np.ndarray:
    """Whether no block, of which the upper triangle counts, has a negative eigenvalue beyond rounding, shape (B,)."""
    values = np.linalg.eigvalsh(np.where(np.isfinite(hessian), hessian, 0.0), UPLO="U")
    return np.all(values[..., 0] >= -NEGATIVE * np.abs(values).max(axis=-1), axis=-1)
