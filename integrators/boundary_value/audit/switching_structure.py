"""The structure of controls along a solution: where each of them stays at a bound, and where it jumps."""

from itertools import pairwise
from typing import NamedTuple, final

import numpy as np

from ....manifolds import InvalidInputError
from ....manifolds.numerics.tolerances import EPS
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.path_constraints import LOWER, UPPER
from ...reporting.text import brief
from ..solution.record import Solution
from .linear_controls import ControlCurvature

CONTROL_AT_BOUND = EPS**0.25  # of the range of a control: the barrier leaves a control at its bound nearer than that
CONTROL_JUMP = 0.1  # of the range of a control: a control that leaves its bound by more between two stages jumps
VANISHED_ARC = 1e-6  # of the horizon: an arc that is shorter has vanished
WEAK_PULL = 1e-2  # of the Hamiltonian: larger switching functions, times the range of their control, do not vanish
WEAK_SHARE = 0.9  # of the stages of an arc: a switching function that vanishes at so many vanishes along the arc
SIDE_NAMES = {-1: "lower", 0: "free", 1: "upper"}


class _Run(NamedTuple):
    """Stages ``begin`` to ``end`` along which an entry of the control is on one side."""

    begin: int
    end: int
    side: int


@final
class SwitchingStructure(NamedTuple):
    """The K arcs of a solution along which controls stay at bounds.

    Attributes
    ----------
    times : array of shape (K + 1,)
        The ends of the arcs.
    sides : array of shape (K, m)
        For each arc and entry of the control -1 at the lower bound, 1 at the upper bound, and 0 otherwise.
    singular : array of shape (K, m), or None
        Whether each entry is singular along the arc: the Hamiltonian is linear in the entry, its switching function
        vanishes there, and no constraint determines it. Its discrete values may chatter between the bounds.
    """

    times: np.ndarray
    sides: np.ndarray
    singular: np.ndarray | None = None

    @property
    def arcs(self) -> int:
        """Number of arcs K."""
        return len(self.sides)

    @property
    def jumps(self) -> bool:
        """Whether a control leaves a bound by a jump."""
        return self.arcs > 1

    def without_vanished(self) -> "SwitchingStructure":
        """The structure without arcs of zero duration; equal neighbours become one arc."""
        lasting = np.diff(self.times) > VANISHED_ARC * (self.times[-1] - self.times[0])
        times, sides = self.times[:-1][lasting], self.sides[lasting]
        changes = np.concatenate([[True], np.any(sides[1:] != sides[:-1], axis=1)])
        begins = times[changes]
        begins[0] = self.times[0]
        return SwitchingStructure(np.append(begins, self.times[-1]), sides[changes])

    def __str__(self) -> str:
        """A line for each arc."""
        names = np.vectorize(SIDE_NAMES.get, otypes=[object])(self.sides)
        names = names if self.singular is None else np.where(self.singular, "singular", names)
        rows = zip(pairwise(self.times), names, strict=True)
        return "\n".join(f"{a:.10g} to {b:.10g}: {', '.join(row)}" for (a, b), row in rows)


def switching_structure(problem: OptimalControlProblem, solution: Solution) -> SwitchingStructure:
    """The arcs along which entries of the control stay at their bounds, as far as the mesh shows them.

    Parameters
    ----------
    problem : OptimalControlProblem
        A problem with control bounds; ``InvalidInputError`` for another one.
    solution : Solution
        A solution of the problem.

    Returns
    -------
    SwitchingStructure
        The arcs, each longer than one step.

    Notes
    -----
    An arc ends where an entry leaves a bound by a jump. An entry that leaves its bound continuously counts as free on
    both sides. An entry along a singular arc is printed as ``singular``.
    """
    if not isinstance(solution, Solution):
        raise InvalidInputError(f"switching_structure takes a Solution, got {brief(solution)}; try what solve returns")
    if not any(problem._limits.bounded.values()):
        raise InvalidInputError(
            f"the structure is that of bounded controls, got a problem without control_bounds, {problem!r}"
        )
    linear = ControlCurvature(problem, solution.parameters)(solution, solution.parameters) == 0
    return singular_structure(problem, solution, linear)


def singular_structure(problem: OptimalControlProblem, solution: Solution, linear: np.ndarray) -> SwitchingStructure:
    """The arcs of the controls with the singular arcs among them.

    An arc at a bound beside a singular arc is part of the singular arc if the switching function vanishes there too:
    the discrete control chatters. ``linear``: at which stages the Hamiltonian is linear in each entry, ``(N s, m)``.
    """
    times, sides, _ = control_arcs(problem, solution, np.asarray(linear.all(axis=0)))
    weak = switching_sizes(problem, solution) <= WEAK_PULL * solution.checks.hamiltonian_size
    weak |= stage_sides(problem, solution)[0] == 0
    weak &= linear & ~solution.held_by(problem._limits.every_name)[:, None]
    arcs, weak_stages = np.searchsorted(times[1:-1], solution.stage_times), np.zeros(sides.shape)
    np.add.at(weak_stages, arcs, weak)
    vanishes = weak_stages >= WEAK_SHARE * np.bincount(arcs, minlength=len(sides))[:, None]
    singular = vanishes & (sides == 0)
    for _ in sides:
        beside = np.zeros_like(singular)
        beside[1:] |= singular[:-1]
        beside[:-1] |= singular[1:]
        singular |= vanishes & beside
    sides = np.where(singular, 0, sides)
    changes = np.any((sides[1:] != sides[:-1]) | (singular[1:] != singular[:-1]), axis=1)
    begins = np.concatenate([[True], changes])
    return SwitchingStructure(np.append(times[:-1][begins], times[-1]), sides[begins], singular[begins])


def switching_sizes(problem: OptimalControlProblem, solution: Solution) -> np.ndarray:
    """Sizes of the switching functions of bounded controls at the stages, times the ranges of the controls, ``(N s,
    m)``."""
    limits, u = problem._limits, np.asarray(solution.controls).reshape(len(solution.stage_times), -1)
    ranges, pull = np.ptp(u, axis=0), np.zeros(u.shape)
    if limits.lower:
        wide = np.array(limits.upper) - np.array(limits.lower)
        ranges = np.where(np.isfinite(wide), wide, ranges)
    for name in (LOWER, UPPER):
        pull += solution.stage_multipliers.get(name, 0.0)
    return pull * ranges


def control_arcs(
    problem: OptimalControlProblem, solution: Solution, linear: np.ndarray | None = None
) -> SwitchingStructure:
    """The arcs along which entries of the control stay at their bounds, without their singular arcs.

    ``linear``: the entries whose arcs at a bound need not begin and end by a jump, shape ``(m,)``; by default none.
    """
    sides, shares = stage_sides(problem, solution)
    stages = len(sides) // solution.steps
    jumping = np.ones(sides.shape[1], bool) if linear is None else ~linear
    runs = [_runs(*entry, stages) for entry in zip(sides.T, shares.T, jumping, strict=True)]
    switches = [[_between(solution, a.end - 1, b.begin) for a, b in pairwise(entry_runs)] for entry_runs in runs]
    first, last = solution.times[[0, -1]]
    times = np.unique(np.concatenate([[first, last], *map(np.array, switches)]))
    middles = (times[1:] + times[:-1]) / 2
    sides_of_arcs = [
        np.array([run.side for run in entry_runs])[np.searchsorted(at, middles)]
        for entry_runs, at in zip(runs, switches, strict=True)
    ]
    return SwitchingStructure(times, np.stack(sides_of_arcs, axis=1))


def stage_sides(problem: OptimalControlProblem, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Bounds that hold the control entries at the stages, and the entries relative to their ranges, both ``(N s, m)``.

    A bound is -1 for the lower bound, 1 for the upper bound, and 0 for none.
    """
    lower, upper = (np.array(side) for side in (problem._limits.lower, problem._limits.upper))
    u = np.asarray(solution.controls).reshape(len(solution.stage_times), -1)
    ranges, spread = upper - lower, np.ptp(u, axis=0)
    ranges = np.where(np.isfinite(ranges), ranges, np.where(spread > 0, spread, 1.0))
    near = CONTROL_AT_BOUND * ranges
    return np.where(u - lower < near, -1, np.where(upper - u < near, 1, 0)), u / ranges


def _between(solution: Solution, before: int, after: int) -> float:
    """A time between two stages: the node if there is one, else the middle."""
    begin, end = solution.stage_times[[before, after]]
    nodes = solution.times[(solution.times > begin) & (solution.times < end)]
    return float(nodes[0]) if len(nodes) == 1 else float(begin + end) / 2


def _runs(sides: np.ndarray, u: np.ndarray, jumping: bool, stages: int) -> list[_Run]:
    """The runs of one entry; if ``jumping``, a run at a bound begins and ends by a jump, or at an end."""
    cuts = [0, *(np.flatnonzero(np.diff(sides)) + 1), len(sides)]
    every = [_Run(int(a), int(b), int(sides[a])) for a, b in pairwise(cuts)]
    runs = _merge([run for run in every if run.end - run.begin > stages] or every[:1])
    if not jumping:
        return runs
    jumps = [True, *(a.side * b.side != 0 or _is_jump(u, a, b) for a, b in pairwise(runs)), True]
    held = [run.side if before and after else 0 for run, before, after in zip(runs, jumps[:-1], jumps[1:], strict=True)]
    return _merge([run._replace(side=side) for run, side in zip(runs, held, strict=True)])


def _is_jump(u: np.ndarray, a: _Run, b: _Run) -> bool:
    """Whether the control jumps between two runs, or in the step between them."""
    return bool(abs(u[b.begin] - u[a.end - 1]) > CONTROL_JUMP)


def _merge(runs: list[_Run]) -> list[_Run]:
    """Runs of which neighbours on one side are one."""
    merged = runs[:1]
    for run in runs[1:]:
        if run.side == merged[-1].side:
            merged[-1] = merged[-1]._replace(end=run.end)
        else:
            merged.append(run)
    return merged
