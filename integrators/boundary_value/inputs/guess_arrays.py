"""Guesses that are given for trajectories, checked, in flat arrays."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple, final

import numpy as np

from ....compute.at_points import violations_at
from ....manifolds import InvalidInputError, Manifold
from ....manifolds.numerics.precision import default_tolerance
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.path_constraints import HORIZON_LOWER, HORIZON_UPPER, PARAMETERS_LOWER, PARAMETERS_UPPER
from ...problem.point_layout import PointLayout
from ...reporting.text import brief
from ..guess import Guess, check_arrays


class FlatGuess(NamedTuple):
    """The parts of guesses, each of shape (B, ...) with the stages or nodes along the second axis; B = 1 for all
    members.

    The last two arrays are None where they are not known of every guess. ``multipliers`` of the inequalities at the
    stages, and those at the nodes, by their names, of each guess, as far as they are known.
    """

    states: np.ndarray
    controls: np.ndarray
    costates: np.ndarray
    nodes: np.ndarray | None
    stage_costates: np.ndarray | None
    multipliers: tuple[dict[str, np.ndarray], ...]
    node_multipliers: tuple[dict[str, np.ndarray], ...]

    @property
    def arrays(self) -> tuple[np.ndarray | None, ...]:
        """All but the multipliers."""
        return self[:-2]

    def of(self, count: int) -> "FlatGuess":
        """The guesses of so many members; arrays that are repeated for them are not to be written to."""
        if len(self.states) == count:
            return self
        parts: Any = (None if a is None else np.broadcast_to(a, (count, *a.shape[1:])) for a in self.arrays)
        return FlatGuess(*parts, multipliers=self.multipliers, node_multipliers=self.node_multipliers)

    def states_to_check(self, size: int) -> np.ndarray:
        """All states, at stages and nodes, in a row."""
        return np.concatenate([rows.reshape(-1, size) for rows in (self.states, self.nodes) if rows is not None])


class _GuessPart(NamedTuple):
    """A part of a guess: points or covectors of a manifold, so many of them."""

    name: str
    manifold: Manifold
    length: int
    layout: PointLayout


@final
class GuessReader:
    """Reads guesses with some steps and stages in each."""

    def __init__(self, problem: OptimalControlProblem, steps: int, stages: int) -> None:
        spaces = (
            (problem.manifold, PointLayout.of(problem.manifold)),
            (problem.controls, PointLayout.of(problem.controls)),
        )
        at_stages, at_nodes = steps * stages, steps + 1
        places = (0, at_stages), (1, at_stages), (0, at_nodes), (0, at_nodes), (0, at_stages)
        self._parts = [
            _GuessPart(name, spaces[of][0], length, spaces[of][1])
            for name, (of, length) in zip(Guess._fields[: len(places)], places, strict=True)
        ]
        limits, added = problem._limits, (HORIZON_LOWER, HORIZON_UPPER, PARAMETERS_LOWER, PARAMETERS_UPPER)
        self._names = {*(name for name, side in limits.bounded.items() if side), *limits.names, *added}
        self._node_names = set(limits.node_names)
        self._stages, self._nodes = at_stages, at_nodes

    def flat(self, guesses: Sequence[Any]) -> FlatGuess:
        """The guesses as flat arrays, costates that are not given being zero; raises where something is wrong."""
        for guess in guesses:
            if not isinstance(guess, Guess):
                raise InvalidInputError(
                    f"guess must be a Guess or a Solution, got {brief(guess)}; try Guess(states, controls)"
                )
            if (guess.nodes is None) != (guess.stage_costates is None):
                raise InvalidInputError(
                    "guess: nodes and stage_costates come together, and one of them is None; give both or neither"
                )
        stacked: list[Any] = []
        for part in self._parts:
            rows = [_rows(getattr(guess, part.name), part) for guess in guesses]
            known = [row for row in rows if row is not None]
            stacked.append(np.stack(known) if len(known) == len(rows) else None)
        stacked += [tuple(map(self._at_stages, guesses)), tuple(map(self._at_nodes, guesses))]
        return FlatGuess(*stacked)

    def _at_stages(self, guess: Guess) -> dict[str, np.ndarray]:
        return _multipliers("multipliers", guess.multipliers or {}, self._names, (self._stages, "stage"))

    def _at_nodes(self, guess: Guess) -> dict[str, np.ndarray]:
        return _multipliers("node_multipliers", guess.node_multipliers or {}, self._node_names, (self._nodes, "node"))

    def keep_multipliers(self, guess: Guess) -> Guess:
        """A guess with the multipliers of inequalities that the problem has, as far as their names tell."""
        known = {name: rows for name, rows in (guess.multipliers or {}).items() if name in self._names}
        at_nodes = {name: rows for name, rows in (guess.node_multipliers or {}).items() if name in self._node_names}
        return guess._replace(multipliers=known, node_multipliers=at_nodes)

    def one(self, guess: Any) -> Guess:
        """A guess as arrays with its costates filled in; raises where something is wrong."""
        flat = self.flat([guess])
        self.require_on_manifold(flat, np.full(len(flat.states_to_check(self._parts[0].layout.size)), np.inf))
        return self.guess(flat, 0)

    def guess(self, flat: FlatGuess, k: int) -> Guess:
        """The guess of a member, in arrays like a point's."""
        parts = (_points(rows, k, part) for rows, part in zip(flat.arrays, self._parts, strict=True))
        both = (every[min(k, len(every) - 1)] for every in (flat.multipliers, flat.node_multipliers))
        return Guess(*parts, *both)

    def require_on_manifold(self, flat: FlatGuess, violations: np.ndarray) -> None:
        """Raise if states are off the manifold, by at least ``violations``, a number for each of
        ``states_to_check``."""
        begin, size, manifold = 0, self._parts[0].layout.size, self._parts[0].manifold
        tolerance = default_tolerance()
        for name in ("states", "nodes"):
            rows = getattr(flat, name)
            if rows is None:
                continue
            points = rows.reshape(-1, size)
            far = ~(violations[begin : begin + len(points)] <= tolerance)
            begin += len(points)
            if np.any(far):
                found = violations_at(manifold, self._parts[0].layout.points(points[far]))
                for equation, values in found.items():
                    if not np.max(values) <= tolerance:
                        worst = f"{equation} reaches {np.max(values):.3g}"
                        raise InvalidInputError(f"guess: {name} are not on {manifold}: {worst}, expected 0")


def _multipliers(
    kind: str, given: Mapping[str, Any], names: Collection[str], places: tuple[int, str]
) -> dict[str, np.ndarray]:
    """Multipliers as arrays, checked but for how many there are at a place, of which there are so many, of some
    kind."""
    found, (length, place) = {name: np.asarray(rows) for name, rows in given.items()}, places
    for name, rows in found.items():
        if name not in names:
            raise InvalidInputError(
                f"guess: {kind} belong to {name!r}, expected names of inequalities, {sorted(names)}"
            )
        if rows.ndim != 2 or len(rows) != length or rows.dtype.kind not in "fiu":
            raise InvalidInputError(
                f"guess: {kind} of {name!r} must be real numbers of shape ({length}, k), a row for each {place}, got "
                f"{rows.dtype} of shape {rows.shape}"
            )
        if not np.all(np.isfinite(rows) & (rows >= 0)):
            raise InvalidInputError(f"guess: {kind} of {name!r} must be finite and not negative")
    return found


def _rows(given: Any, part: _GuessPart) -> np.ndarray | None:
    """Flat arrays of a part, checked; None of what is not known."""
    if given is None and part.name == "costates":
        return np.zeros((part.length, part.layout.size))
    if given is None and part.name in ("nodes", "stage_costates"):
        return None
    rows = part.layout.finite_rows(given, 1)
    if rows is None or len(rows) != part.length:
        check_arrays(part.name, given, part.manifold, part.length)
        rows = part.layout.rows(given, 1)
    return rows


def _points(rows: np.ndarray | None, k: int, part: _GuessPart) -> Any:
    """The part of member ``k`` in arrays like a point's."""
    return None if rows is None else part.layout.point_arrays(rows[min(k, len(rows) - 1)])
