"""Gauss-Newton on the conditions of multiple shooting: many of them repeat each other on ``P_f``, and some may
contradict."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ....compute.jit_cache import compile_function
from ....manifolds.numerics import ambient as vec
from ....manifolds.numerics.ambient import Frame
from ....manifolds.numerics.levenberg import RELATIVE_DAMPING
from ...reporting.result_sentences import Result
from ..iteration_reports import Iteration, say, tell
from .end_conditions import EndConditions, EndValues
from .least_squares import shortest_step
from .segments import Iterate, Linearisation, Shooting

MATCHING = 100.0  # weight of the gaps: what cannot be met shows in the boundary conditions
FREEDOM = 10.0  # weight of the states beside the gauge controls, whose norm is to be least
STATIONARY_RESIDUAL, NEARLY_STATIONARY = (
    1e-8,
    1e-4,
)  # largest derivative of the residual's square, relative to its parts
DECREASE = 1e-6  # of the conditions: what a step takes away at least
SHOOTING_PATIENCE, PROGRESS = 20, 0.1  # iterations in which the conditions have to come nearer by this fraction
SETTLED_GAUGE = 1e-9  # last change of the gauge controls, relative to 1 + size
SHOOTING_TITLES = f"{'iteration':>9} {'conditions':>10} {'defect':>9} {'damping':>8}"


class ShootingResult(NamedTuple):
    """The last iterate with its conditions, and how the iteration ended. ``independent``: rank of the boundary
    conditions."""

    iterate: Iterate
    at: Linearisation
    ends: EndValues
    iterations: int
    independent: int
    result: Result


class _State(NamedTuple):
    """An iterate, the bases of ``T P_f`` at its points, and the conditions there."""

    iterate: Iterate
    frames: Frame
    at: Linearisation
    ends: EndValues

    @property
    def rows(self) -> np.ndarray:
        """The conditions: gaps, start, end."""
        return np.concatenate([MATCHING * self.at.gaps.reshape(-1), self.ends.start, self.ends.end])

    @property
    def size(self) -> float:
        """Norm of the conditions; infinite where they are not known."""
        with np.errstate(over="ignore"):  # of conditions far beyond the last ones: they are not taken
            size = np.linalg.norm(self.rows)
        return float(size) if self.at.solved and np.isfinite(size) else np.inf

    def meets(self, tolerance: float) -> bool:
        """Whether the trajectory has no gaps and meets the conditions at both ends."""
        missed = [float(self.at.distance), *(float(value) for value in self.ends.violations.values())]
        return bool(self.at.solved) and bool(np.all(np.asarray(missed) <= tolerance))


def meet_conditions(
    shooting: Shooting,
    conditions: EndConditions,
    guess: Iterate,
    tolerance: float,
    max_iterations: int,
    callback: Callable[[Iteration], Any] | None,
) -> ShootingResult:
    """Close the gaps and meet the boundary conditions from a guess, with gauge controls of least norm.

    Damped Gauss-Newton with steps of least norm. It ends with ``Result.no_extremal`` where the residual is stationary
    and does not vanish: the conditions contradict each other there; with ``Result.stopped`` where the callback
    returns something true, and at an interrupt.
    """
    search = _Search(shooting, conditions, guess)
    say(callback, SHOOTING_TITLES)
    try:
        search.run(tolerance, max_iterations, callback)
    except KeyboardInterrupt:
        search.result = Result.stopped
    return search.last_iterate()


class _Search:
    """The iteration from a guess: where it is, and how it ended."""

    def __init__(self, shooting: Shooting, conditions: EndConditions, guess: Iterate) -> None:
        self.shooting, self.conditions = shooting, conditions
        still = jax.tree.map(
            lambda leaf: jnp.zeros((len(leaf), shooting.final.dimension, *leaf.shape[1:])), guess.points
        )
        self.weights, self.controlled = _weights(shooting, guess), bool(guess.gauge.size)
        self.state = _evaluate(shooting, conditions, guess, still, np.zeros_like(self.weights))
        self.rank, self.count, self.result = 0, 0, Result.too_many_iterations

    def run(self, tolerance: float, max_iterations: int, callback: Callable[[Iteration], Any] | None) -> None:
        """Iterate to the end."""
        weights, damping, better, sizes = self.weights, RELATIVE_DAMPING.first, True, list[float]()
        for self.count in range(max_iterations + 1):
            state = self.state
            if _is_last(callback, self.count, state, damping, better):
                self.result = Result.stopped
                return
            if not np.isfinite(state.size):
                self.rank, self.result = 0, Result.step_not_solved
                return
            matrix, excess = _matrix(state), _excess(self.shooting, state.iterate)
            d, self.rank = shortest_step(matrix * weights.reshape(-1), state.rows, excess, damping)
            slope = _slope(matrix, state.rows)
            sizes.append(state.size)
            exhausted = damping > RELATIVE_DAMPING.largest or (
                self.count >= SHOOTING_PATIENCE and sizes[-1] > (1 - PROGRESS) * sizes[-1 - SHOOTING_PATIENCE]
            )
            change = np.max(np.abs(d)) if self.controlled else 0.0
            self.result = _result(state, tolerance, slope, change, exhausted)
            if self.result != Result.too_many_iterations or self.count == max_iterations:
                return
            step = weights * d.reshape(weights.shape)
            tried = _evaluate(self.shooting, self.conditions, state.iterate, state.frames, step)
            better = tried.meets(tolerance) or tried.size < (1 - DECREASE) * state.size
            self.state, damping = tried if better else state, RELATIVE_DAMPING.after(damping, better)

    def last_iterate(self) -> ShootingResult:
        """The last iterate that was taken."""
        state, independent = self.state, max(self.rank - self.state.at.gaps.size, 0)
        return ShootingResult(state.iterate, state.at, state.ends, self.count, independent, self.result)


def _is_last(
    callback: Callable[[Iteration], Any] | None, count: int, state: _State, damping: float, accepted: bool
) -> bool:
    """Show the state to the callback, and whether that stops the iteration.

    The conditions are all that is known of it: the cost is computed once, at the end.
    """
    gap = float(state.at.distance)
    unknown, none, one = np.array([np.nan]), np.zeros(1), np.ones(1)
    sizes = np.array([gap]), np.array([state.size]), np.array([damping]), one, np.array([accepted])
    seen = Iteration(count, np.arange(1), unknown, *sizes, none, none)
    return tell(callback, seen, f"{count:>9} {state.size:>10.1e} {gap:>9.1e} {damping:>8.0e}")


def _result(state: _State, tolerance: float, slope: float, change: float, exhausted: bool) -> Result:
    """Whether the iteration ends here, and how; ``too_many_iterations`` while it has to go on."""
    if state.meets(tolerance):
        settled = change <= SETTLED_GAUGE * (1 + np.max(np.abs(np.asarray(state.iterate.gauge)), initial=0.0))
        return Result.successful if settled else Result.too_many_iterations
    if slope <= (NEARLY_STATIONARY if exhausted else STATIONARY_RESIDUAL):
        return Result.no_extremal
    return Result.no_improvement if exhausted else Result.too_many_iterations


@lru_cache
def _kernels() -> tuple[Callable[..., Any], ...]:
    """The kernels that place points on ``P_f``, run the segments from these points, and evaluate the boundary
    conditions."""
    methods = Shooting.place, Shooting.linearise, EndConditions.at
    return tuple(compile_function(lambda *arguments, f=f: f(*arguments)) for f in methods)


def _evaluate(shooting: Shooting, conditions: EndConditions, iterate: Iterate, frames: Frame, d: np.ndarray) -> _State:
    """The state at the iterate moved by coordinates in frames."""
    place, linearise, at_ends = _kernels()
    moved, frames = place(shooting, iterate, frames, jnp.asarray(d))
    first = vec.entries((moved.points, frames), 0)
    at = linearise(shooting, moved, frames)
    ends = at_ends(conditions, *first, at.end, at.end_moves)
    return _State(moved, frames, *jax.device_get((at, ends)))


def _matrix(state: _State) -> np.ndarray:
    """Derivatives of the conditions by all coordinates of all segments."""
    at, ends = state.at, state.ends
    segments, size, dimension = len(at.pushes) + 1, ends.by_last.shape[1], ends.by_first.shape[1]
    matching = np.zeros((segments - 1, dimension, segments, size))
    for j, push in enumerate(at.pushes):
        matching[j, :, j] = push
        matching[j, :, j + 1, :dimension] = -np.eye(dimension)
    boundary = np.zeros((2, len(ends.start), segments, size))
    boundary[0, :, 0, :dimension], boundary[1, :, -1] = ends.by_first, ends.by_last
    count, columns = len(ends.start) + len(ends.end), segments * size
    return np.concatenate([MATCHING * matching.reshape(at.gaps.size, columns), boundary.reshape(count, columns)])


def _slope(matrix: np.ndarray, rows: np.ndarray) -> float:
    """Largest derivative of ``|rows|^2 / 2`` relative to its parts: zero at a stationary point."""
    parts = np.max(np.abs(matrix).T @ np.abs(rows), initial=0.0)
    return float(np.max(np.abs(matrix.T @ rows)) / parts) if parts else 0.0


def _weights(shooting: Shooting, iterate: Iterate) -> np.ndarray:
    """Weights of the coordinates, ``(M, d + L g)``: the gauge controls are made small before their changes are."""
    states = np.full((shooting.segments, shooting.final.dimension), FREEDOM)
    return np.concatenate([states, np.ones((shooting.segments, iterate.gauge[0].size))], axis=1)


def _excess(shooting: Shooting, iterate: Iterate) -> np.ndarray:
    """The origin of the norm of a step: the gauge controls themselves, without more weight than the steps of the
    states."""
    gauge = np.asarray(iterate.gauge).reshape(shooting.segments, iterate.gauge[0].size)
    return np.concatenate([np.zeros((shooting.segments, shooting.final.dimension)), gauge], axis=1).reshape(-1)
