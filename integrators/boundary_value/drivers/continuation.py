"""From an easy problem to a hard one: the extremals along a path of parameters, ends and horizons."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import jax
import numpy as np
from jaxtyping import Array

from ....compute.automatic import AutomaticEvaluator
from ....manifolds import ConvergenceError, InvalidInputError
from ....manifolds.numerics.ambient import is_finite_number
from ....retractions import default_retraction
from ...problem.argument_errors import require_known_options
from ...problem.free_quantities import guess_of, is_free
from ...problem.point_layout import PointLayout
from ...reporting.result_sentences import Result
from ...reporting.text import brief
from ..guess import Guess
from ..inputs.arguments import BoundaryData
from ..iteration_reports import stops
from ..solution.batch import Solutions
from ..solution.differentiable_solution import push_forward
from ..solution.record import Solution
from ..solver import Solver

FIRST_STEP = 0.1  # of the path
# Largest and smallest ratio of successive steps; a failed step shrinks by the smallest.
STEP_GROWTH, STEP_SHRINKING = 2.0, 0.3
CORRECTED = 0.4  # of the predicted change: a correction by that much leaves a step as long as it is
NO_MINIMA = "The extremals there are not strict minima any more, as behind a conjugate point."
SMALL_CORRECTION = (
    0.1  # of the size of the trajectory: a correction by less leads to no other extremal, however small the change
)


@final
@dataclass(frozen=True, eq=False)
class Continuation:
    """The extremals along a path of problems, up to the last place that was reached.

    Attributes
    ----------
    places : array of shape (K,)
        Numbers in [0, 1].
    solutions : Solutions
        The solution at each place.
    success : bool
        Whether the last place is the end of the path, 1.
    result : str
        A sentence on the reason otherwise.
    """

    places: np.ndarray
    solutions: Solutions
    success: bool
    result: str

    @property
    def solution(self) -> Solution:
        """The solution at the last place."""
        return self.solutions[-1]

    def __repr__(self) -> str:
        reached = (
            f"reached {self.places[-1]:.6g} of the path by {len(self.places) - 1} steps, cost {self.solution.cost:.9g}"
        )
        return f"Continuation({reached}, result={self.result!r})"


class _Trial(NamedTuple):
    """A solution further along the path, its correction relative to what is allowed, and why it is not taken, if it is
    not."""

    solution: Solution
    correction: float
    refusal: str


@require_known_options
def continuation(
    solver: Solver,
    path: Callable[[float], dict[str, Any]],
    guess: Guess | Solution | None = None,
    smallest_step: float = 1e-4,
    tolerance: float | None = None,
    max_iterations: int = 20,
    callback: Callable[[float, Solution], Any] | None = None,
) -> Continuation:
    """The solution at the end of a path of problems, followed from its beginning.

    Parameters
    ----------
    solver : Solver
        The solver of a regular problem.
    path : callable
        A continuous function of a number in [0, 1]. It returns the arguments ``start``, ``end``, ``horizon`` and
        ``parameters`` of ``solver.solve`` in a dictionary. The problem at 0 is easy, the problem at 1 is the one to
        solve.
    guess : Guess or Solution, optional
        The guess at 0.
    smallest_step : float
        The step in [0, 1] below which the continuation stops, for example at a fold.
    tolerance : float, optional
        As in ``solve``.
    max_iterations : int
        The most iterations of one correction.
    callback : callable, optional
        A function of each place and solution; the continuation stops if it returns True.

    Returns
    -------
    Continuation
        The solutions, and the reason if the end was not reached.

    Raises
    ------
    InvalidInputError, NotOnManifoldError, DomainError, ConvergenceError
        As ``solver.solve`` at the beginning of the path.

    Notes
    -----
    Each step predicts the next extremal by the tangent, from ``solver.sensitivity``, and corrects it by Newton's
    method. If that fails, for example where a limit becomes active, the last solution is corrected instead. Steps
    become longer if the correction is small compared with the prediction. They become shorter if it is large, leads to
    another extremal or loses the strict minimum. An interrupt ends the continuation.

    References
    ----------
    Allgower, Georg, Numerical Continuation Methods, 1990. den Heijer, Rheinboldt, On steplength algorithms for a class
    of continuation methods, SIAM J. Numer. Anal. 18, 1981.
    """
    if not (isinstance(solver, Solver) and callable(path)):
        raise InvalidInputError(
            f"continuation takes a Solver and a path, a function of a number, got {brief(solver)}, {brief(path)}"
        )
    if not (is_finite_number(smallest_step) and 0 < smallest_step <= 1):
        raise InvalidInputError(f"smallest_step must be a number in (0, 1], got {smallest_step!r}")
    options = {"tolerance": tolerance, "max_iterations": max_iterations}
    first = solver.solve(**problem_at(path, 0.0)._asdict(), guess=guess, tolerance=tolerance)
    predictor, way, step, refusal = Predictor(solver), [(0.0, first)], FIRST_STEP, ""
    with suppress(KeyboardInterrupt):  # what was found until then is there
        stopped = _asks_to_stop(callback, 0.0, first)
        while not (stopped or refusal) and way[-1][0] < 1:
            before, last = way[-1]
            place = min(before + step, 1.0)
            trial = _try_step(predictor, (problem_at(path, before), problem_at(path, place)), last, options)
            if not trial.refusal:
                way.append((place, trial.solution))
                factor = max(STEP_SHRINKING, CORRECTED / max(trial.correction, CORRECTED / STEP_GROWTH))
                step = max(step * factor, smallest_step)
                stopped = _asks_to_stop(callback, place, trial.solution)
            elif trial.solution.statistics.stopped:
                stopped = True
            elif step <= smallest_step:
                refusal = trial.refusal
            else:
                step = max(STEP_SHRINKING * min(step, place - before), smallest_step)
    places, found = map(list, zip(*way, strict=True))
    reached, until = places[-1] == 1, f"{places[-1]:.6g} of the path"
    words = f"No step beyond {until} succeeds: {refusal}" if refusal else f"The way was stopped at {until}."
    words = "The end of the path was reached." if reached else words
    return Continuation(np.array(places), Solutions.of(found), reached, words)


def _asks_to_stop(callback: Callable[[float, Solution], Any] | None, place: float, found: Solution) -> bool:
    """Whether the callback, or an interrupt during the iteration, asks to stop."""
    return (callback is not None and stops(callback(place, found))) or found.statistics.stopped


def problem_at(path: Callable[[float], dict[str, Any]], place: float) -> BoundaryData:
    """The problem at a place of the path; raises unless the path returns one."""
    given = path(place)
    names = {"start", "end", "horizon"}
    if not isinstance(given, dict) or not names <= set(given) <= set(BoundaryData._fields):
        came = sorted(map(str, given)) if isinstance(given, dict) else f"{brief(given)}"
        raise InvalidInputError(
            f"the path returned {came} at {place:.6g}, expected a dictionary with start, end, horizon and, where "
            "functions take them, parameters"
        )
    return BoundaryData(**{"parameters": None, **given})


def _try_step(
    predictor: "Predictor", way: tuple[BoundaryData, BoundaryData], last: Solution, options: dict[str, Any]
) -> _Trial:
    """The solution at the end of a step, corrected from what is predicted."""
    given, predicted = way[1].near(last)._asdict(), predictor(last, *way)
    guess = last if predicted is None else predicted
    found = predictor.solver.solve(**given, guess=guess, throw=False, **options)
    if not (found.success or guess is last or found.statistics.stopped):
        guess = last  # of limits that begin to hold, or cease to, its derivatives tell nothing
        found = predictor.solver.solve(**given, guess=guess, throw=False, **options)
    if not found.success:
        return _Trial(found, np.inf, found.result)
    if last.checks.strict_minimum and not found.checks.strict_minimum:
        why = found.result.removeprefix(Result[Result.successful]).strip()
        return _Trial(found, np.inf, NO_MINIMA if found.result == Result[Result.stationary] else why)
    old, new = _parts(last.guess()), _parts(found.guess())
    expected, correction = old if isinstance(guess, Solution) else _parts(guess), 0.0
    for before, aim, after in zip(old, expected, new, strict=True):
        change, missed, size = (np.max(np.abs(a), initial=0.0) for a in (aim - before, after - aim, after))
        allowed = max(change, SMALL_CORRECTION * size)
        correction = max(correction, missed / allowed if allowed > 0 else 0.0)
    return _Trial(found, correction, "Newton's method leads to another extremal from there." if correction > 1 else "")


def _parts(guess: Guess) -> list[np.ndarray]:
    """The arrays of states and controls of a trajectory."""
    return [np.asarray(leaf) for leaf in jax.tree.leaves((guess.nodes, guess.controls))]


@final
class Predictor:
    """Moves extremals of a solver along their derivatives; its functions are traced once."""

    def __init__(self, solver: Solver) -> None:
        self.solver, self.manifold = solver, solver.problem.manifold
        self.state, self.control = PointLayout.of(self.manifold), PointLayout.of(solver.problem.controls)
        values, e, u = AutomaticEvaluator().values, self.state.size, self.control.size
        self._state_move = values(self._state_move_of, e, e)
        self._costate_projection = values(self._costate_projection_of, e, e)
        self._control_move = values(self._control_move_of, u, u)

    def __call__(self, solution: Solution, before: BoundaryData, after: BoundaryData) -> Guess | None:
        """The extremal of a problem near the extremal of a solution, to first order; None for a solution without
        derivatives."""
        try:
            derivatives = self.solver.sensitivity(solution)
        except ConvergenceError:
            return None
        change = jax.tree.map(_change, before, after)
        along = push_forward(self.manifold, solution, derivatives, change)
        states, costates = self.state.rows(along.states, 1), self.state.rows(along.costates, 1)
        nodes, at_nodes = self._pair(solution.states, states, solution.costates, costates)
        states, costates = (_between(solution, part) for part in (states, costates))
        stages, at_stages = self._pair(solution.stage_states, states, solution.stage_costates, costates)
        turned = self.control.rows(solution.controls, 1), self.control.rows(along.controls, 1)
        (controls,) = self._control_move.at(1, *turned)
        point = self.state.points
        parts = point(stages), self.control.points(controls), point(at_nodes), point(nodes), point(at_stages)
        found = Guess(*parts, solution.stage_multipliers, solution.node_multipliers)
        return found if all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(found)) else None

    def _pair(self, states: Any, moves: np.ndarray, costates: Any, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """States and costates, moved."""
        (moved,) = self._state_move.at(1, self.state.rows(states, 1), moves)
        return moved, self._costate_projection.at(1, moved, self.state.rows(costates, 1) + turns)[0]

    def _state_move_of(self, q: Array, v: Array) -> tuple[Array]:
        point = self.state.point(q)
        return (
            self.state.flat(self.solver.method.retraction(point, self.manifold.projection(point, self.state.point(v)))),
        )

    def _costate_projection_of(self, q: Array, p: Array) -> tuple[Array]:
        return (self.state.flat(self.manifold.projection(self.state.point(q), self.state.point(p))),)

    def _control_move_of(self, u: Array, v: Array) -> tuple[Array]:
        turn = default_retraction(self.solver.problem.controls)
        return (self.control.flat(turn(self.control.point(u), self.control.point(v))),)


def _change(a: Any, b: Any) -> np.ndarray:
    """The difference of two values; of what is free there is none."""
    first, second = (np.asarray(guess_of(value), float) for value in (a, b))
    return np.zeros_like(first) if is_free(a) or is_free(b) else second - first


def _between(solution: Solution, at_nodes: np.ndarray) -> np.ndarray:
    """Vectors at the stages, linear in time between the vectors at the nodes of each step."""
    k = np.repeat(np.arange(solution.steps), len(solution.stage_times) // solution.steps)
    share = ((solution.stage_times - solution.times[k]) / np.diff(solution.times)[k])[:, None]
    return (1 - share) * at_nodes[k] + share * at_nodes[k + 1]
