"""The results of a sweep until now, read from its folder."""

from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np

from ..manifolds import InvalidInputError
from .store import Store, existing


class Work(NamedTuple):
    """The record of a worker: its members, and the seconds on the clock and of the processor."""

    members: int
    seconds: float
    cpu_seconds: float


@final
class Sweep:
    """The finished members of a sweep, read from its folder on demand; ``sweep`` and ``load_sweep`` return it.

    Parameters
    ----------
    store : Store
        The files of the sweep.
    parts : sequence of int, optional
        The chunks; by default all finished chunks.

    Notes
    -----
    Arrays have the M finished members along the leading axis, in the order of their numbers. A member that the solver
    rejects has NaN as its cost and as its kept values, no success, and the reason as its result.
    """

    def __init__(self, store: Store, parts: Sequence[int] | None = None) -> None:
        self._store, self._parts = store, store.finished_chunks() if parts is None else list(parts)

    @property
    def folder(self) -> Path:
        """The folder of the sweep."""
        return self._store.folder

    @property
    def count(self) -> int:
        """The number of all members, finished or not."""
        return self._store.count

    def __len__(self) -> int:
        """How many are finished."""
        return sum(len(self._store.members(part)) for part in self._parts)

    @property
    def complete(self) -> bool:
        """Whether all members are finished."""
        return len(self._parts) == self._store.parts

    def chunks(self) -> Iterator["Sweep"]:
        """The record chunk by chunk, for sweeps that do not fit into memory."""
        for part in self._parts:
            yield Sweep(self._store, [part])

    @cached_property
    def _read(self) -> list[dict[str, Any]]:
        return [self._store.read(part) for part in self._parts]

    def _join(self, name: str, kind: Any) -> np.ndarray:
        return np.concatenate([np.zeros(0, kind), *(found[name] for found in self._read)])

    @property
    def members(self) -> np.ndarray:
        """The numbers of the finished members, shape ``(M,)``."""
        return np.concatenate([np.zeros(0, int), *(self._store.members(part) for part in self._parts)])

    @cached_property
    def cost(self) -> np.ndarray:
        """The costs, shape ``(M,)``; without success, the cost of the best iterate."""
        return self._join("cost", float)

    @cached_property
    def success(self) -> np.ndarray:
        """Whether the first-order conditions of each member hold, shape ``(M,)``."""
        return self._join("success", bool)

    @cached_property
    def result(self) -> list[str]:
        """A sentence on the end of each member."""
        return [str(words) for found in self._read for words in found["result"]]

    @cached_property
    def kept(self) -> dict[str, np.ndarray]:
        """The arrays that the study keeps, by name, shape ``(M, ...)``; ``InvalidInputError`` if chunks differ."""
        known: dict[str, Any] | None = None
        for found in self._read:
            if not found["has"].any():
                continue
            own = {name: array.shape[1:] for name, array in found["kept"].items()}
            known = own if known is None else known
            if own != known:
                raise InvalidInputError(
                    f"chunks of {self.folder} keep different arrays: {own} beside {known}, expected the same; sweep "
                    "into a new folder"
                )
        return {
            name: np.concatenate([_rows(found, name, shape) for found in self._read])
            for name, shape in (known or {}).items()
        }

    @property
    def converged(self) -> int:
        """The number of members whose first-order conditions hold."""
        return int(np.sum(self.success))

    @property
    def reasons(self) -> dict[str, np.ndarray]:
        """The members without success, by the words of their results."""
        words, members = np.array(self.result, dtype=str)[~self.success], self.members[~self.success]
        return {str(reason): members[words == reason] for reason in np.unique(words)}

    @property
    def workers(self) -> dict[str, Work]:
        """The work of each worker, by its name ``host:process``."""
        found: dict[str, Work] = {}
        for part in self._read:
            name, (seconds, cpu_seconds) = str(part["worker"]), part["seconds"].tolist()
            before = found.get(name, Work(0, 0.0, 0.0))
            members = before.members + len(part["cost"])
            found[name] = Work(members, before.seconds + seconds, before.cpu_seconds + cpu_seconds)
        return found

    def __repr__(self) -> str:
        """The essential numbers, and the reasons of failures, the most frequent first."""
        costs = self.cost[self.success]
        span = f", costs {costs.min():.9g} to {costs.max():.9g}" if len(costs) else ""
        lines = [f"Sweep({len(self)} of {self.count} members finished, {self.converged} of them converged{span})"]
        for reason, members in sorted(self.reasons.items(), key=lambda item: -len(item[1])):
            lines.append(f"  {len(members)} as member {members[0]}: {reason}")
        return "\n".join(lines)


def _rows(found: dict[str, Any], name: str, shape: tuple[int, ...]) -> np.ndarray:
    """The kept rows of a chunk, NaN for members that have no solution."""
    rows = np.full((len(found["has"]), *shape), np.nan)
    if found["has"].any():
        rows[found["has"]] = found["kept"][name]
    return rows


def load_sweep(folder: str | Path) -> Sweep:
    """The finished members of a sweep in a folder, also during the sweep; nothing in its files is executed.

    Parameters
    ----------
    folder : str or Path
        The folder.

    Returns
    -------
    Sweep
        The members.

    Raises
    ------
    InvalidInputError
        If there is no sweep in the folder. If a file is something else, damaged or incomplete, when its arrays are
        read.
    """
    return Sweep(existing(Path(folder).absolute()))
