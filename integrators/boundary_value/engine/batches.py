"""Trees of arrays with a leading axis for the members of a batch."""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np


def merged(mask: np.ndarray, new: Any, old: Any) -> Any:
    """The members of ``new`` where ``mask``, of ``old`` elsewhere."""
    if mask.all() or not mask.any():
        return new if mask[0] else old
    return jax.tree.map(lambda a, b: np.where(mask.reshape(-1, *(1,) * (a.ndim - 1)), a, b), new, old)


def taken(tree: Any, places: np.ndarray) -> Any:
    """Some members of a batch."""
    return jax.tree.map(lambda leaf: leaf[places], tree)


def put(tree: Any, places: np.ndarray, part: Any) -> Any:
    """The batch with some of its members replaced."""

    def replaced(leaf: np.ndarray, new: np.ndarray) -> np.ndarray:
        if len(places) == len(leaf):
            return new
        leaf[places] = new
        return leaf

    return jax.tree.map(replaced, tree, part)


def joined(parts: Sequence[Any]) -> Any:
    """The members of batches one after the other."""
    return parts[0] if len(parts) == 1 else jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)
