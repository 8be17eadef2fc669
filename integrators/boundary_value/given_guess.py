"""Guesses that are given for trajectories, checked, in flat arrays."""

from collections.abc import Sequence
from typing import Any, NamedTuple, final

import jax
import numpy as np

from ...manifolds import InvalidInputError, Manifold
from ...manifolds.manifold import default_tolerance
from ..evaluation import at_each
from ..problem import OptimalControlProblem
from .engine.layout import Layout
from .guess import Guess, check_arrays


class FlatGuess(NamedTuple):
    """States and controls at the stages, shape (B, N s, ...), and costates at the nodes, (B, N + 1, E); B = 1 for all members.

    ``nodes`` and ``stage_costates``, if all guesses have them: states at the nodes, and costates at the stages.
    """

    states: np.ndarray
    controls: np.ndarray
    costates: np.ndarray
    nodes: np.ndarray | None = None
    stage_costates: np.ndarray | None = None

    @property
    def on_manifold(self) -> dict[str, np.ndarray]:
        """The parts that are points of the state manifold."""
        return {"states": self.states} | ({} if self.nodes is None else {"nodes": self.nodes})


class _Kind(NamedTuple):
    """Of what manifold a part of a guess has points or vectors, and how many."""

    manifold: Manifold
    length: int
    layout: Layout


@final
class GuessReader:
    """Reads guesses with some steps and stages in each."""

    def __init__(self, problem: OptimalControlProblem, steps: int, stages: int) -> None:
        manifold, count = problem.manifold, steps * stages
        state, control = Layout.of(manifold), Layout.of(problem.controls)
        along_stages, along_nodes = _Kind(manifold, count, state), _Kind(manifold, steps + 1, state)
        controls = _Kind(problem.controls, count, control)
        self._kinds = dict(zip(Guess._fields, (along_stages, controls, along_nodes, along_nodes, along_stages), strict=True))

    def flat(self, guesses: Sequence[Any]) -> FlatGuess:
        """The guesses as flat arrays, costates that are not given being zero; raises where something is wrong."""
        rows: dict[str, list[np.ndarray]] = {name: [] for name in self._kinds}
        for guess in guesses:
            if not isinstance(guess, Guess):
                raise InvalidInputError(f"guess must be a Guess or a Solution, got {guess!r}; try Guess(states, controls)")
            if (guess.nodes is None) != (guess.stage_costates is None):
                raise InvalidInputError(
                    "guess: nodes and stage_costates come together, and one of them is None; give both or neither"
                )
            names = [name for name in self._kinds if guess.nodes is not None or name not in ("nodes", "stage_costates")]
            for name in names:
                rows[name].append(self._rows(name, getattr(guess, name)))
        complete = (np.stack(found) if len(found) == len(guesses) else None for found in rows.values())
        return FlatGuess(*complete)  # pyright: ignore[reportArgumentType]  # only the last two can be None

    def guess(self, flat: FlatGuess, k: int) -> Guess:
        """The guess of a member, in arrays like a point's."""

        def part(name: str, rows: np.ndarray | None) -> Any:
            if rows is None:
                return None
            kind = self._kinds[name]
            points = kind.layout.points(rows[min(k, len(rows) - 1)])
            return jax.tree.map(lambda like, leaf: np.asarray(leaf, like.dtype), kind.manifold.ambient, points)

        return Guess(*(part(name, rows) for name, rows in zip(self._kinds, flat, strict=True)))

    def require_on_manifold(self, flat: FlatGuess, violations: np.ndarray) -> None:
        """Raise if a violation of the manifold's equations is large, of one of the points ``on_manifold`` one after the other."""
        if np.all(violations <= default_tolerance()):
            return
        manifold, _, layout = self._kinds["states"]
        for what, rows in flat.on_manifold.items():
            for name, value in at_each(manifold.violations, layout.points(rows.reshape(-1, layout.size))).items():
                if not np.max(value) <= default_tolerance():
                    worst = f"{name} reaches {np.max(value):.3g}"
                    raise InvalidInputError(f"guess: {what} are not on {manifold}: {worst}, expected 0")

    def _rows(self, name: str, given: Any) -> np.ndarray:
        manifold, length, layout = self._kinds[name]
        if given is None and name == "costates":
            return np.zeros((length, layout.size))
        if not (layout.holds(given, 1) and len(jax.tree.leaves(given)[0]) == length):
            check_arrays(name, given, manifold, length)
        return layout.rows(given, 1)


def checked_guess(problem: OptimalControlProblem, guess: Any, steps: int, stages: int) -> Guess:
    """A guess as arrays with its costates filled in; raises where something is wrong."""
    reader = GuessReader(problem, steps, stages)
    flat = reader.flat([guess])
    reader.require_on_manifold(flat, np.full(1, np.inf))
    return reader.guess(flat, 0)
