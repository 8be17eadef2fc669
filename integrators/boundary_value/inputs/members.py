"""Members of a batch: their number, and what belongs to one of them."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import numpy as np

from ....manifolds import InvalidInputError
from ...problem.free_quantities import is_free
from ..guess import Guess
from .arguments import BoundaryData
from .boundary_data import BoundaryDataReader


def are_several(guesses: Any) -> bool:
    return isinstance(guesses, Sequence) and not isinstance(guesses, Guess)


def count_members(ends: BoundaryDataReader, known: BoundaryData, guesses: Any) -> int:
    """The number of members of a batch."""
    given = {
        "starts": ends.lengths(known.start),
        "ends": ends.lengths(known.end),
        "horizons": [np.shape(known.horizon)] if np.ndim(known.horizon) else [],
        "start times": [np.shape(known.start_time)] if np.ndim(known.start_time) else [],
        "parameters": [np.shape(leaf)[:1] for leaf in jax.tree.leaves(known.parameters)],
        "guesses": [(len(guesses),)] if are_several(guesses) else [],
    }
    lengths = {length for found in given.values() for length in found}
    if len(lengths) != 1 or lengths & {(), (0,)}:
        raise InvalidInputError(_words_on_lengths(given))
    ((count,),) = lengths
    return count


def _words_on_lengths(given: dict[str, Sequence[tuple[int, ...]]]) -> str:
    """Words on what has which leading axis, where a batch has none or several lengths."""
    found = [
        f"{name} {' and '.join(str(length[0]) if length else 'none' for length in sorted(set(lengths)))}"
        for name, lengths in given.items()
        if lengths
    ]
    hint = "for a single trajectory call solve"
    if any((0,) in lengths for lengths in given.values()):
        hint = "a batch has one member or more"
    elif given["parameters"]:
        hint = "parameters have one too: try np.broadcast_to for those that are the same for all"
    got = ", ".join(found) or "none"
    return f"a batch has one more axis in front, of one length B, wherever something varies, got {got}; {hint}"


def member_of(ends: BoundaryDataReader, given: BoundaryData, k: int) -> BoundaryData:
    """The data of member ``k`` of a batch."""
    start, end = ends.member(given.start, k), ends.member(given.end, k)
    shared = given.horizon, given.parameters, given.start_time
    return BoundaryData(start, end, *jax.tree.map(partial(entry_of, k=k), shared))


def entry_of(leaf: Any, k: int) -> Any:
    """Entry ``k`` of a horizon, a parameter or a start time, or the same for all members."""
    if is_free(leaf):
        return leaf.member(k)
    return leaf if np.ndim(leaf) == 0 else np.asarray(leaf)[k]


def repeat_for_all(rows: np.ndarray, count: int) -> np.ndarray:
    """Rows for so many members, of which there may be one for all."""
    return rows if len(rows) == count else np.broadcast_to(rows, (count, *rows.shape[1:]))


def row_of(rows: np.ndarray, k: int) -> np.ndarray:
    """Row ``k`` of rows of which there may be one for all."""
    return rows[min(k, len(rows) - 1)]
