"""Long integrations outside of JAX's transformations: pieces of one loop, between which Ctrl-C is heard."""

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import jax
import numpy as np

from ...manifolds.numerics import ambient as vec
from ...progress import Advance, progress

FIRST_PIECE = 8  # steps, before it is known how long one takes
PIECE_SECONDS = 0.1  # what a piece should take: two hundred times its call, and too short to wait for
LEAST_SECONDS = 1e-9  # of a piece, for which a clock may show none
MOST_GROWTH = 16  # of the number of steps from one piece to the next: the time of a short piece says little
PIECE_NODES, PIECE_BYTES = 4096, 2**22  # the nodes that a piece can keep, fewer if they need more memory than this


class Steps(ABC):
    """The steps of trajectories that begin together, a state that goes on with them, and what is kept of it."""

    evaluator: str

    @abstractmethod
    def kept_values(self) -> Any:
        """The kept values of the present state, a pytree of NumPy arrays."""

    @abstractmethod
    def piece(self, done: int, count: int, phase: int, every: int, size: int) -> tuple[Any, np.ndarray, float]:
        """Run ``count`` more steps, or until a step fails, after ``done`` steps, of which ``phase`` begin a block.

        Returns the kept values of the last state of each block of ``every`` steps, in rows along the leading axis of
        every array: at least the rows that the piece reached, at most ``size``. Returns also, for every trajectory, -1
        or the step at which the trajectory stopped, and the seconds of the steps themselves.
        """


class Outcome(NamedTuple):
    """The result of a run: the kept nodes, the start first, the failed steps or -1, and the cause of an
    interruption."""

    nodes: Any
    failed_step: np.ndarray
    interrupt: KeyboardInterrupt | None


def run(steps: Steps, saves: int, every: int, verbose: bool = False) -> Outcome:
    """Integrate over ``saves`` blocks of ``every`` steps, piece after piece. If interrupted, the nodes are those
    reached.

    ``verbose``: the progress is shown.
    """
    with progress("integrate", saves * every, "steps", verbose) as advance:
        return _run(steps, saves, every, advance)


def _run(steps: Steps, saves: int, every: int, advance: Advance) -> Outcome:
    first = steps.kept_values()
    nodes = jax.tree.map(lambda a: np.empty((saves + 1, *a.shape), a.dtype), first)
    _put(nodes, 0, first)
    size = min(PIECE_NODES, max(1, PIECE_BYTES // max(1, sum(leaf.nbytes for leaf in jax.tree.leaves(first)))))
    done, count, total = 0, FIRST_PIECE, saves * every
    failed = np.asarray(-1)
    try:
        while done < total:
            row, phase = divmod(done, every)
            count = min(count, total - done, size * every - phase)
            rows, failed, seconds = steps.piece(done, count, phase, every, size)
            stopped = bool(np.all(failed >= 0))
            last = int(np.max(failed)) - done if stopped else count - 1
            known = 1 + (phase + last) // every
            _put(nodes, slice(row + 1, row + 1 + known), vec.taken(rows, slice(known)))
            if stopped:
                _put(nodes, slice(row + 1 + known, None), steps.kept_values())
                return Outcome(nodes, failed, None)
            done += count
            advance(count)
            count = 1 + int(count * min(MOST_GROWTH, PIECE_SECONDS / max(seconds, LEAST_SECONDS)))
    except KeyboardInterrupt as interrupt:
        reached = done // every
        return Outcome(vec.taken(nodes, slice(reached + 1)), failed, interrupt)
    return Outcome(nodes, failed, None)


def _put(arrays: Any, where: int | slice, values: Any) -> None:
    """Write values into a part of NumPy arrays."""
    for array, value in zip(jax.tree.leaves(arrays), jax.tree.leaves(values), strict=True):
        array[where] = value
