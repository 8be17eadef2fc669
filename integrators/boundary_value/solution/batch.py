"""The solutions of a batch: one after the other, and their arrays together."""

import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Self, final, overload

import jax
import numpy as np

from ....manifolds import InvalidInputError, Manifold
from ....manifolds.numerics import ambient as vec
from ....retractions import Retraction
from ...reporting.presentation import HistoryPlots
from .batch_file import save_batch, unpack_batch
from .record import Solution, load_solution

LISTED = "result", "checks", "statistics", "singular", "interpolant", "quantities"  # fields that are lists
SAME_EXTREMAL = 1e-6  # relative distance within which two extremals are one


@final
class Solutions(HistoryPlots, Sequence[Solution]):
    """The solutions of a batch: a sequence of ``Solution``, and their fields with one more leading axis.

    ``solutions.controls`` has shape ``(B, N s, m)``; ``solutions.cost``, ``solutions.success`` and ``solutions.status``
    have shape ``(B,)``; ``result``, ``checks`` and ``statistics`` are lists. ``solve_many`` and ``multistart`` return
    it.

    Parameters
    ----------
    fields : dict of str to array
        The fields with their leading axis.
    member : callable
        A function of a number that returns the ``Solution`` of this member.
    places : sequence of int
        The numbers of the members.
    """

    def __init__(self, fields: dict[str, Any], member: Callable[[int], Solution], places: Sequence[int]) -> None:
        self._fields, self._member, self._places = fields, member, places
        self._made: dict[int, Solution] = {}  # each when it is asked for, once

    @classmethod
    def of(cls, members: Sequence[Solution]) -> Self:
        """The batch of given solutions.

        Parameters
        ----------
        members : sequence of Solution
            Solutions with arrays of the same shapes.
        """
        names = [field.name for field in fields(Solution) if field.name not in LISTED]
        stacked = vec.stacked([{name: getattr(member, name) for name in names} for member in members])
        return cls(stacked, members.__getitem__, range(len(members)))

    def __reduce__(self) -> Any:
        return Solutions.of, (tuple(self),)

    def __len__(self) -> int:
        return len(self._places)

    @overload
    def __getitem__(self, place: int) -> Solution: ...
    @overload
    def __getitem__(self, place: slice | np.ndarray | Sequence[int]) -> "Solutions": ...
    def __getitem__(self, place: Any) -> "Solution | Solutions":
        """One member, or the batch of some: a slice, their numbers, or which they are, as ``solutions.success``."""
        if isinstance(place, slice):
            return Solutions(self._fields, self._whole, self._places[place])
        if np.ndim(place) == 1:
            chosen = np.asarray(self._places, int)[np.asarray(place, None if len(place) else int)]
            return Solutions(self._fields, self._whole, chosen.tolist())
        return self._whole(self._places[place])

    def _whole(self, k: int) -> Solution:
        """The member that is number ``k`` of the whole batch."""
        if k not in self._made:
            self._made[k] = self._member(k)
        return self._made[k]

    def __getattr__(self, name: str) -> Any:
        if name not in {field.name for field in fields(Solution)}:
            raise AttributeError(f"the solutions of a batch have no attribute {name!r}; try solutions[0].{name}")
        if name in LISTED:  # the results are known before the members are made, which takes longer
            known = self._fields.get(name)
            return (
                [getattr(member, name) for member in self]
                if known is None
                else [known[place] for place in self._places]
            )
        return vec.taken(self._fields[name], list(self._places))

    def save(self, path: str | Path) -> None:
        """A file with all members, which ``load_solutions`` reads.

        Parameters
        ----------
        path : str or Path
            The file; ``InvalidInputError`` as for ``Solution.save``.
        """
        save_batch(self, path)

    @property
    def status(self) -> np.ndarray:
        """The status of each member, ``"minimum"``, ``"stationary"`` or ``"failed"``, shape (B,)."""
        return np.array([member.status for member in self], dtype=str)

    @property
    def converged(self) -> int:
        """The number of members whose first-order conditions hold."""
        return int(np.sum(self.success))

    @property
    def distinct(self) -> int:
        """The number of different extremals among the converged members: states further apart than 1e-6 of their
        extent.
        """
        leaves = [leaf[self.success] for leaf in jax.tree.leaves(self.states)]
        flat = np.concatenate([leaf.reshape(len(leaf), math.prod(leaf.shape[1:])) for leaf in leaves], axis=1)
        found: list[np.ndarray] = []
        for states in flat:
            if all(np.max(np.abs(states - other)) > SAME_EXTREMAL * (1 + np.max(np.abs(states))) for other in found):
                found.append(states)
        return len(found)

    def __repr__(self) -> str:
        costs = self.cost[self.success]
        span = f"costs {costs.min():.9g} to {costs.max():.9g}, " if len(costs) else ""
        counts = f"{len(self)}, {self.converged} of them converged, {self.distinct} distinct"
        return f"Solutions({counts}, {span}{self.times.shape[1] - 1} steps each)"


def load_solutions(
    path: str | Path, retraction: Retraction | None = None, controls: Manifold | None = None
) -> Solutions:
    """The batch in a file that ``Solutions.save`` wrote; nothing in the file is executed.

    Parameters
    ----------
    path : str or Path
        The file.
    retraction, controls
        As in ``load_solution``, for every member.

    Returns
    -------
    Solutions
        The batch.

    Raises
    ------
    InvalidInputError
        If the file is something else, damaged, incomplete, or of another version; if members have different arrays.
    """
    with tempfile.TemporaryDirectory() as folder:
        places = unpack_batch(Path(path), Path(folder))
        try:
            return Solutions.of([load_solution(place, retraction, controls) for place in places])
        except (InvalidInputError, ValueError) as error:
            words = str(error).replace(f"{folder}/", "member ")
            raise InvalidInputError(f"{path} is not a saved batch: {words}") from error
