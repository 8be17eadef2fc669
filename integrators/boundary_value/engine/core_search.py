"""Searches of the compiled core in the place of ``Descent``, while the engine is still there."""

from collections.abc import Callable
from functools import partial
from threading import local
from typing import Any, final
from weakref import WeakKeyDictionary

import numpy as np

from ....compute.search import Search, SearchResult, SearchStatus
from ....compute.tape_machine import MachineProgram
from ....compute.transcription import FunctionName, Sizes, Trajectory, Transcription
from ....manifolds.numerics.ambient import joined, taken
from ...problem.point_layout import PointLayout
from .acceptance import WIDE
from .aside import aside
from .barrier import Barrier
from .collocation import Collocation, GaussUnknowns
from .conditions import Conditions
from .found import Found, Iteration, stops
from .inequalities import Slacks
from .kkt_system import Assembled, Iterate
from .scaling import Units
from .transcription import Unknowns

KEPT = 4  # transcriptions of one problem and thread, of meshes with other numbers of steps


class _ThreadTranscriptions(local):
    """The transcriptions of a thread, which no other one may use at the same time."""

    def __init__(self) -> None:
        self.of: WeakKeyDictionary[Any, dict[int, Transcription]] = WeakKeyDictionary()


_known = _ThreadTranscriptions()


def is_on_core(conditions: Any) -> bool:
    """Whether the core has all that a search asks for."""
    if conditions.joint:
        return False
    return all(hasattr(own, "tape") for own in _functions(conditions).values())


def _functions(conditions: Conditions) -> dict[FunctionName, Any]:
    """The functions of the problem."""
    steps, nodes, name = conditions.transcription, conditions.at_nodes, FunctionName
    found = {name.ENDS: steps._ends, name.FRAMES: nodes._in_frame, name.MIDDLE: nodes._middle}
    costs = {"first_cost": name.START_COST, "final_cost": name.END_COST}
    found |= {costs[key]: function for key, function in nodes._paid.items()}
    if nodes._directions is not None:
        found[name.CONTROL_FRAMES] = nodes._directions
    if isinstance(steps, Collocation):
        found |= {name.POINTS: steps._point, name.BOTH_ENDS: steps._both, name.MOVE: steps._centre}
        return found | {name.MOVE_CONTROLS: steps._control}
    return found | {name.POINTS: steps._row, name.MOVE: steps._move}


def transcription_of(conditions: Conditions) -> Transcription:
    """The transcription of a problem for the core; the last ones are kept."""
    count = conditions.data.steps.shape[1]
    known = _known.of.setdefault(conditions.transcription, {})
    if count not in known:
        while len(known) >= KEPT:
            del known[next(iter(known))]
        known[count] = made(conditions)
    return known[count]


def made(conditions: Conditions, instruction_set: int | None = None) -> Transcription:
    """The transcription of a problem for the core; ``instruction_set``: the processor's best, or a lesser one."""
    steps, nodes, tableau = conditions.transcription, conditions.at_nodes, (np.ones((1, 1)), np.ones(1))
    if isinstance(steps, Collocation):
        tableau = steps.tableau.matrix, steps.tableau.weights
    sizes = Sizes(
        conditions.data.steps.shape[1], steps.stages, steps.manifold.dimension, steps.state.size,
        steps.controls.dimension, steps.control.size, steps.parameter.size, *_limits(steps),
    )  # fmt: skip
    groups, of_controls = _groups(nodes.layout), None if nodes.flat_controls else _groups(nodes.control)
    bounds = sum(map(len, nodes.problem._limits.bounded.values()))
    programs = {}
    for key, function in _functions(conditions).items():
        p = function.tape.program
        own = p.codes, p.registers, p.values, p.inputs, p.outputs, p.size
        programs[key] = MachineProgram(*own, instruction_set)
    return Transcription(
        sizes, tableau, groups, of_controls, steps.kept.astype(float), bounds, programs, instruction_set
    )


def _groups(layout: PointLayout) -> tuple[np.ndarray, np.ndarray]:
    """The column and the array of each entry of a point."""
    return layout.columns.astype(np.intp), layout.arrays.astype(np.intp)


def _limits(steps: Any) -> tuple[int, int]:
    """Numbers of inequalities of a point, and of the ends of a collocation step."""
    return (steps.own, steps.at_nodes) if isinstance(steps, Collocation) else (steps.inequalities, 0)


def flat_limits(steps: Any, array: np.ndarray) -> np.ndarray:
    """The core's order of an array of inequalities, shape ``(N, r, c)``."""
    own, at_nodes = _limits(steps)
    if not at_nodes:
        return array.ravel()
    return np.concatenate([array[:, : steps.stages, :own].ravel(), array[:, steps.stages, own:].ravel()])


def whole_limits(steps: Any, flat: np.ndarray, count: int, unasked: float) -> np.ndarray:
    """An array of inequalities of so many steps, shape ``(1, N, r, c)``, from the order of the core; ``unasked``: what
    stands where there is none."""
    own, at_nodes = _limits(steps)
    if not at_nodes:
        return flat.reshape(1, count, steps.places, steps.inequalities).copy()
    found, of_points = np.full((1, count, steps.places, steps.inequalities), unasked), count * steps.stages * own
    found[0, :, : steps.stages, :own] = flat[:of_points].reshape(count, steps.stages, own)
    found[0, :, steps.stages, own:] = flat[of_points:].reshape(count, at_nodes)
    return found


def put(to: Trajectory, conditions: Conditions, iterate: Iterate, k: int) -> None:
    """Write what is given of a member and the unknowns of its iterate."""
    data, ends = conditions.data, conditions.ends
    given = {
        "STEP_SIZE": data.steps[k], "PARAMETERS": data.parameters[k], "START": ends.start[k], "END": ends.end[k],
        "START_ENTRIES": ends.start_entries, "END_ENTRIES": ends.end_entries, "FIXED": conditions.fixed[k],
        "CENTRES": iterate.unknowns.centres[k], "CONTROLS": iterate.unknowns.controls[k],
        "COSTATES": iterate.costates[k],
    }  # fmt: skip
    if isinstance(iterate.unknowns, GaussUnknowns):
        given |= {"VELOCITIES": iterate.unknowns.velocities[k], "POINT_COSTATES": iterate.unknowns.costates[k]}
    if conditions.transcription.inequalities:
        weights = conditions.transcription.weights(data)
        given["LIMIT_WEIGHTS"] = flat_limits(conditions.transcription, weights[k if len(weights) > 1 else 0])
        given["LIMIT_MULTIPLIERS"] = np.zeros(len(to["LIMIT_MULTIPLIERS"]))
        if iterate.slacks is not None:
            known = iterate.slacks.multipliers[k]
            given["LIMIT_MULTIPLIERS"] = flat_limits(conditions.transcription, known)
    for name, array in given.items():
        to[name][...] = np.ravel(array)


def iterate_of(at: Trajectory, like: Iterate, steps: Any) -> Iterate:
    """The iterate of one member; ``like``: a batch of iterates."""

    def array(name: str, own: np.ndarray) -> np.ndarray:
        return at[name].reshape(1, *own.shape[1:]).copy()

    own, count = like.unknowns, len(like.costates[0]) - 1
    if isinstance(own, GaussUnknowns):
        names = "CENTRES", "VELOCITIES", "CONTROLS", "POINT_COSTATES"
        unknowns: Any = GaussUnknowns(*map(array, names, own))
    else:
        unknowns = Unknowns(array("CENTRES", own.centres), array("CONTROLS", own.controls))
    slacks = None
    if steps.inequalities:
        none = {"SLACKS": 1.0, "LIMIT_MULTIPLIERS": 0.0, "EXCESSES": 0.0, "PENALTIES": np.inf}
        s, nu, t, rho = (whole_limits(steps, at[name], count, unasked) for name, unasked in none.items())
        slacks = Slacks(s, nu, t, rho, at["BARRIER"].copy())
    return Iterate(unknowns, array("COSTATES", like.costates), slacks)


@final
class CoreSearch:
    """Searches of the members of a batch, one after the other; see ``Descent``."""

    def __init__(
        self,
        conditions: Conditions,
        tolerance: float,
        max_iterations: int,
        callback: Callable[[Iteration], Any] | None,
        as_it_is: bool = False,
        width: float = WIDE,
        firm: float = 1.0,
    ) -> None:
        self.conditions, self.tolerance, self.max_iterations = conditions, tolerance, max_iterations
        self.callback, self.as_it_is, self.width, self.firm = callback, as_it_is, width, firm
        self.lost, self.stopped = np.zeros(0, bool), False

    def ended(self, guess: Iterate) -> Found:
        """The result of the searches from the guesses, which an interrupt ends."""
        conditions, steps, count = self.conditions, self.conditions.transcription, len(guess.costates)
        self.lost = np.zeros(count, bool)
        told, iterates, firsts, units, wider, barriers = [], [], [], [], [], []
        for k in range(count):
            result = self._searched(guess, k).read()
            iterates.append(iterate_of(result.trajectory, guess, steps))
            firsts.append(iterate_of(result.first, guess, steps))
            units.append(_units(result.judging))
            wider.append(_units(result.steps))
            if steps.inequalities:
                rate, firm = np.array([result.rate]), np.array([self.firm])
                barriers.append(Barrier(rate, result.limits[None].copy(), steps.kept[None].copy(), firm))
            told.append(result._replace(trajectory=None, first=None, judging=None, steps=None, limits=None))
        conditions.units, conditions.wider = joined(units), joined(wider)
        conditions.barrier = joined(barriers) if barriers else None
        iterate, self._first = joined(iterates), joined(firsts)
        return self._found(iterate, told)

    def _searched(self, guess: Iterate, k: int) -> Search:
        """The search of a member, from its guess or from that moved aside."""
        search, status = self._run(self.conditions, guess, (k, k), looks=not self.as_it_is)
        if status is not SearchStatus.DEGENERATE:
            return search
        self.lost[k] = True
        alone, moved = self._aside(guess, k)
        return self._run(alone, moved, (0, k), looks=False)[0]

    def _run(
        self, conditions: Conditions, guess: Iterate, places: tuple[int, int], looks: bool
    ) -> tuple[Search, SearchStatus]:
        """A search and how it has ended; ``places``: of the member in the guess, and in the batch of the search."""
        own = self.tolerance, self.max_iterations, self.width, self.firm
        search = Search(transcription_of(conditions), *own, looks=looks, report=partial(self._report, places[1]))
        put(search.trajectory, conditions, guess, places[0])
        try:
            status = search.run()
        except KeyboardInterrupt:
            status = SearchStatus.STOPPED
        self.stopped |= status is SearchStatus.STOPPED or search.read().stopped
        return search, status

    def _report(self, k: int, iteration: Any) -> bool:
        """Show an iteration to the callback; whether that, or an interrupt before, asks to stop."""
        if self.stopped or self.callback is None:
            return self.stopped
        names = "cost", "defect", "stationarity", "shift", "fraction", "descends", "violation", "barrier"
        seen = (np.array([getattr(iteration, name)]) for name in names)
        return stops(self.callback(Iteration(iteration.number, np.array([k]), *seen)))

    def first(self) -> tuple[Iterate, Assembled]:
        """The guesses with their first multipliers and slacks, and their systems."""
        return self._first, self.conditions.assemble(self._first)

    def failed(self, found: Found) -> np.ndarray:
        """Which members have ended without success from guesses that nothing moved aside."""
        return ~(found.claimed | found.contradictory | self.lost | self.stopped)

    def _aside(self, guess: Iterate, k: int) -> tuple[Conditions, Iterate]:
        """The conditions of a member, and its guess moved aside."""
        alone = self.conditions.of(np.array([k]))
        moved, _ = aside(alone, *alone.begin(taken(guess, np.array([k])), self.firm))
        return alone, moved

    def _found(self, iterate: Iterate, told: list[SearchResult]) -> Found:
        conditions = self.conditions
        assembled = conditions.assemble(iterate)
        residuals = conditions.residuals(iterate, assembled)
        names = "strict", "iterations", "limited", "claimed", "solvable", "infeasible", "falls"
        strict, count, limited, claimed, solvable, infeasible, falls = (
            np.array([getattr(one, name) for one in told]) for name in names
        )
        missing = assembled.extent.lacking / conditions.judging.nodes
        ended = strict, count, limited, claimed, solvable
        return Found(
            iterate,
            assembled,
            residuals,
            *ended,
            self.stopped,
            missing,
            infeasible,
            conditions.judging.cost,
            falls,
        )


def _units(scale: Any) -> Units:
    return Units(scale.unknowns[None].copy(), scale.nodes[None].copy(), np.array([scale.cost]))
