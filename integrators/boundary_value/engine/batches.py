"""Trees of arrays with a leading axis for the members of a batch."""

from typing import Any

import jax
import numpy as np


def merged(mask: np.ndarray, new: Any, old: Any) -> Any:
    """The members of ``new`` where ``mask``, of ``old`` elsewhere."""
    if mask.all() or not mask.any():
        return new if mask[0] else old
    return jax.tree.map(lambda a, b: np.where(mask.reshape(-1, *(1,) * (a.ndim - 1)), a, b), new, old)


def put(tree: Any, places: np.ndarray, part: Any) -> Any:
    """The batch with some of its members replaced."""

    def replaced(leaf: np.ndarray, new: np.ndarray) -> np.ndarray:
        if len(places) == len(leaf):
            return new
        leaf[places] = new
        return leaf

    return jax.tree.map(replaced, tree, part)
