"""The guard that traced functions of a user have not changed since the first trace."""

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from typing import Any, final

import jax
import numpy as np

from ..errors import FAILURES
from ..manifolds import InvalidInputError
from ..tracing import one_tracing


@final
class ClosureGuard:
    """The functions of a ``holder`` as they were first read.

    ``digest``: of what they compute now, or None where that cannot be told, for arguments of one structure; ``hint``:
    what else to try than a new holder.
    """

    def __init__(self, holder: str, digest: Callable[..., bytes | None], hint: str = "") -> None:
        self._holder, self._digest, self._hint = holder, digest, hint
        self._first: dict[Hashable, bytes | None] = {}
        self._changed = False

    @contextmanager
    def guard(self, *given: Any) -> Iterator[None]:
        """A time in which functions may be traced; raises ``InvalidInputError`` if a traced function has changed.

        After a change it raises ever after, because the holder keeps both traces.
        """
        with one_tracing() as reading:
            self._require()
            before = reading.traces
            try:
                yield
            finally:
                if reading.traces > before:
                    self._read(given)
                    self._require()

    def _read(self, given: tuple[Any, ...]) -> None:
        leaves, structure = jax.tree.flatten(given)
        try:
            now = self._digest(*jax.tree.map(lambda leaf: np.zeros(np.shape(leaf)), given))
        except FAILURES:  # of functions that fail, of which the call has told
            return
        self._changed = self._first.setdefault((structure, *map(np.shape, leaves)), now) != now

    def _require(self) -> None:
        if self._changed:
            raise InvalidInputError(
                f"the functions compute other values than when the {self._holder.lower()} was made, and this call, or "
                f"one before, needs something that was not traced then; make a new {self._holder} after a change"
                f"{self._hint}"
            )
