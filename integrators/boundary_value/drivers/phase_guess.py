"""First guesses of phases: from the ends that are known, along the links, on the way between them."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import jax
import numpy as np

from ....manifolds import InvalidInputError
from ...problem.free_quantities import guess_of
from ...problem.point_layout import PointLayout
from ...reporting.text import brief
from ..guess import Guess, default_guess
from ..inputs.boundary_data import BoundaryDataReader
from ..inputs.connecting_curve import ConnectingCurve
from ..solution.record import Solution
from .phase_transcription import PHASE_ERRORS


def guess_phases(phases: Sequence[Any], links: Sequence[Any]) -> list[Any]:
    """The phases with guesses, by default on the way between the known parts of their ends and of linked ends."""
    if all(phase.guess is not None for phase in phases):
        return list(phases)
    read, before = [_KnownPoints.of(k, phase) for k, phase in enumerate(phases)], None
    firsts = [0, *(k + 1 for k, link in enumerate(links[: len(phases) - 1]) if link is not True)]
    for first, following in zip(firsts, [*firsts[1:], len(phases)], strict=True):
        turn = links[first - 1] if first and callable(links[first - 1]) else None
        image = None if turn is None or before is None else _image(phases[first], turn, phases[first - 1], before)
        run = phases[first:following]
        nodes = _way(first, run, read[first:following], image)
        before = nodes[-1]
        for k in range(len(run)):
            read[first + k].ends = nodes[k], nodes[k + 1]
    return [
        phase if phase.guess is not None else _with_guess(k, phase, *own.ends)
        for k, (phase, own) in enumerate(zip(phases, read, strict=True))
    ]


class _KnownPoints:
    """Flat ends of a phase, and which of their entries are known."""

    def __init__(self, ends: tuple[np.ndarray, np.ndarray], known: tuple[np.ndarray, np.ndarray]) -> None:
        self.ends, self.known = ends, known

    @classmethod
    def of(cls, number: int, phase: Any) -> "_KnownPoints":
        """The known parts of the ends of a phase, from the phase itself or from its guess."""
        reader, layout = BoundaryDataReader.of(phase.problem), PointLayout.of(phase.problem.manifold)
        try:
            first, last = reader.ends(phase.start, None, False), reader.ends(None, phase.end, False)
        except PHASE_ERRORS as error:
            raise type(error)(f"phase {number}: {error}") from error
        ends, known = (first.start[0], last.end[0]), (first.prescribed[0].known, last.prescribed[1].known)
        if phase.guess is None:
            return cls(ends, known)
        guess = phase.guess
        if not isinstance(guess, Guess | Solution):
            raise InvalidInputError(
                f"phase {number}: guess must be a Guess or a Solution, got {brief(guess)}; try Guess(states, controls)"
            )
        states = layout.rows(guess.states if isinstance(guess, Guess) else guess.stage_states, 1)
        filled = (np.where(k, row, state) for k, row, state in zip(known, ends, (states[0], states[-1]), strict=True))
        a, b = filled
        return cls((a, b), (np.ones_like(known[0]), np.ones_like(known[1])))


def _image(phase: Any, turn: Any, earlier: Any, row: np.ndarray) -> np.ndarray:
    """The flat start of a phase to which a link leads from an end."""
    image = turn(PointLayout.of(earlier.problem.manifold).points(row))
    return PointLayout.of(phase.problem.manifold).rows(jax.tree.map(np.asarray, image), 0)


def _way(number: int, run: Sequence[Any], read: list[_KnownPoints], image: np.ndarray | None) -> list[np.ndarray]:
    """Flat nodes between phases that are continuous, through what is known of them."""
    pairs = [(read[0].ends[0], read[0].known[0])]
    for one, other in zip(read, [*read[1:], None], strict=True):
        row, known = one.ends[1], one.known[1]
        if other is not None:
            row, known = np.where(known, row, other.ends[0]), known | other.known[0]
        pairs.append((row, known))
    if image is not None:
        row, known = pairs[0]
        pairs[0] = np.where(known, row, image), np.ones_like(known)
    for order in (range(len(pairs)), range(len(pairs) - 1, -1, -1)):  # the ends are as what is known next to them
        ahead = [pairs[k] for k in order]
        row, known = ahead[0]
        for other, also in ahead[1:]:
            row, known = np.where(known, row, other), known | also
        pairs[order[0]] = row, known
    if not np.all(pairs[0][1]):
        raise InvalidInputError(
            f"phase {number} has a start that is free, and nothing that is linked to it says where it may be; expected "
            "a guess; try start=Free(point), or guess=Guess(states, controls)"
        )
    times = np.cumsum([0.0, *(float(guess_of(phase.duration)) for phase in run)])
    return _between(run[0], pairs, times)


def _between(phase: Any, pairs: list[tuple[np.ndarray, np.ndarray]], times: np.ndarray) -> list[np.ndarray]:
    """The nodes, with partly known nodes on the way between known nodes."""
    anchors = [k for k, (_, known) in enumerate(pairs) if np.all(known)]
    start, nodes = ConnectingCurve(phase.problem.manifold, phase.method.retraction), [row for row, _ in pairs]
    for a, b in pairwise(anchors):
        if b - a > 1:
            places = (times[a + 1 : b] - times[a]) / (times[b] - times[a])
            states = start.states(nodes[a][None], nodes[b][None], places)[0]
            for k, state in zip(range(a + 1, b), states, strict=True):
                nodes[k] = np.where(pairs[k][1], pairs[k][0], state)
    return nodes


def _with_guess(number: int, phase: Any, first: np.ndarray, last: np.ndarray) -> Any:
    """The phase with the default guess between two flat points."""
    layout = PointLayout.of(phase.problem.manifold)
    begin, end = (jax.tree.map(np.asarray, layout.points(row)) for row in (first, last))
    try:
        return phase._replace(guess=default_guess(phase.problem, phase.method, begin, end, phase.steps))
    except PHASE_ERRORS as error:
        raise type(error)(f"phase {number}: {error}") from error
