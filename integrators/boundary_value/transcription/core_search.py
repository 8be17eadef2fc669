"""Searches of the compiled core: one for each member of a batch, side by side."""

from collections.abc import Sequence
from functools import partial
from threading import local
from typing import Any, NamedTuple, final
from weakref import WeakKeyDictionary

import numpy as np

from ....compute.binding.problem_functions import CallbackFunction
from ....compute.binding.search import Search, SearchResult, SearchStatus
from ....compute.binding.tape_machine import MachineProgram
from ....compute.binding.transcription import FunctionName, IterateNumbers, Sizes, Trajectory, Transcription
from ....compute.threads import each_in_threads
from ....manifolds.numerics.ambient import joined, taken
from ...problem.point_layout import PointLayout
from ..engine.collocation import Collocation
from ..engine.conditions import Conditions
from .discrete_extremals import AtStages, DiscreteExtremals, Inequalities, Residuals
from .iterate import CollocationUnknowns, Iterate, Slacks, Unknowns
from .iteration import Iteration, stops
from .kkt_system import KKTSystem

LARGEST = 8  # place of the largest residual
KEPT = 4  # transcriptions of one problem and thread, of meshes with other numbers of steps


class _ThreadTranscriptions(local):
    """The transcriptions of a thread, which no other one may use at the same time."""

    def __init__(self) -> None:
        self.of: WeakKeyDictionary[Any, dict[int, Transcription]] = WeakKeyDictionary()


_known = _ThreadTranscriptions()


def is_on_core(conditions: Any) -> bool:
    """Whether the core has all that a search asks for."""
    return not conditions.joint


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
    """The transcription of a problem for the core; the last transcriptions are kept."""
    count = conditions.data.steps.shape[1]
    known = _known.of.setdefault(conditions.transcription, {})
    if count not in known:
        while len(known) >= KEPT:
            del known[next(iter(known))]
        known[count] = made(conditions)
    return known[count]


def made(conditions: Conditions, instruction_set: int | None = None) -> Transcription:
    """The transcription of a problem for the core, by the processor's best instruction set or a lesser one."""
    steps, nodes, tableau = conditions.transcription, conditions.at_nodes, (np.ones((1, 1)), np.ones(1))
    if isinstance(steps, Collocation):
        tableau = steps.tableau.matrix, steps.tableau.weights
    sizes = Sizes(
        conditions.data.steps.shape[1], steps.stages, steps.manifold.dimension, steps.state.size,
        steps.controls.dimension, steps.control.size, steps.parameter.size, *_limits(steps),
    )  # fmt: skip
    groups, of_controls = _groups(nodes.layout), None if nodes.flat_controls else _groups(nodes.control)
    bounds = sum(map(len, nodes.problem._limits.bounded.values()))
    functions = {name: _function(own, instruction_set) for name, own in _functions(conditions).items()}
    return Transcription(
        sizes, tableau, groups, of_controls, steps.kept.astype(float), bounds, functions, instruction_set
    )


def _function(function: Any, instruction_set: int | None) -> MachineProgram | CallbackFunction:
    """A function of a problem for the core: a tape, or a callback to what its evaluator has compiled."""
    if not hasattr(function, "tape"):
        return CallbackFunction(function, *function.sizes)
    p = function.tape.program
    return MachineProgram(p.codes, p.registers, p.values, p.inputs, p.outputs, p.size, instruction_set)


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
    """An array of inequalities of so many steps, shape ``(1, N, r, c)``, from the order of the core.

    ``unasked``: the number where there is none.
    """
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
    if isinstance(iterate.unknowns, CollocationUnknowns):
        given |= {"VELOCITIES": iterate.unknowns.velocities[k], "POINT_COSTATES": iterate.unknowns.costates[k]}
    if conditions.transcription.inequalities:
        weights = conditions.transcription.weights(data)
        given["LIMIT_WEIGHTS"] = flat_limits(conditions.transcription, weights[k if len(weights) > 1 else 0])
        given["LIMIT_MULTIPLIERS"] = np.zeros(len(to["LIMIT_MULTIPLIERS"]))
        if iterate.slacks is not None:
            known = iterate.slacks.multipliers[k]
            given["LIMIT_MULTIPLIERS"] = flat_limits(conditions.transcription, known)
    for name, array in given.items():
        to[name] = array.ravel()


class SearchOptions(NamedTuple):
    """Options of a search; see ``Search``."""

    tolerance: float
    max_iterations: int
    width: float = 1.0
    firm: float = 1.0
    looks: bool = True


class Member(NamedTuple):
    """The result of the search of a member, in arrays of its own; ``retrax_core.h`` explains them."""

    nodes: np.ndarray
    costates: np.ndarray
    residuals: np.ndarray
    totals: np.ndarray
    missing: np.ndarray  # largest defects of the nodes, in natural sizes
    limits: np.ndarray
    iterate: IterateNumbers
    first: IterateNumbers | None  # the guess with first multipliers and slacks, where no minimum was found
    perturbed: bool  # whether the guess was degenerate and was moved aside
    result: SearchResult  # without its trajectories


ARRAYS, FLAGS = slice(5), slice(SearchResult._fields.index("iterations"), None)


@final
class Watch:
    """The callback of searches, and whether that, or an interrupt, has asked for an end."""

    def __init__(self, callback: Any) -> None:
        self.callback, self.stopped = callback, False

    def stop(self) -> None:
        """All searches are to end with their iterates."""
        self.stopped = True

    def told(self, k: int, iteration: Any) -> bool:
        """Show an iteration of a member to the callback; whether the search is to end."""
        if self.stopped or self.callback is None:
            return self.stopped
        names = "cost", "defect", "stationarity", "shift", "fraction", "descends", "violation", "barrier"
        seen = (np.array([getattr(iteration, name)]) for name in names)
        return stops(self.callback(Iteration(iteration.number, np.array([k]), *seen)))


def search_all(conditions: Conditions, guess: Iterate, options: SearchOptions, watch: Watch) -> list[Member]:
    """The results of the searches of all members, side by side unless a callback watches them."""

    def run(k: int) -> Member:
        return search(conditions, guess, k, options, watch, k)

    count = len(guess.costates)
    if count == 1 or watch.callback is not None:
        return [run(k) for k in range(count)]
    return each_in_threads(run, count, watch.stop)


def search(conditions: Conditions, guess: Iterate, k: int, options: SearchOptions, watch: Watch, number: int) -> Member:
    """The result of the search of a member from its guess, or from beside a degenerate one.

    ``number``: of the member for the callback.
    """
    own = Search(transcription_of(conditions), *options, report=partial(watch.told, number))
    put(own.trajectory, conditions, guess, k)
    perturbed = False
    try:
        status = own.run()
        if perturbed := status is SearchStatus.DEGENERATE:
            own.perturb()
            status = own.run()
    except KeyboardInterrupt:
        status = SearchStatus.STOPPED
    found = own.read()
    if status is SearchStatus.STOPPED or found.stopped:
        watch.stop()
    at, judging, steps = found.trajectory, found.judging.copy, found.steps.copy
    kept: Any = SearchResult(None, None, judging, steps, found.limits.copy(), *found[5:])  # pyright: ignore[reportArgumentType]
    return Member(
        at["NODES"].copy(),
        at["NODE_COSTATES"].copy(),
        at["RESIDUALS"].copy(),
        at["TOTALS"].copy(),
        at["LACKING"] / judging.nodes,
        at["LIMITS"].copy(),
        at.iterate,
        None if found.claimed and found.strict else found.first.iterate,
        perturbed,
        kept,
    )


def perturbed(conditions: Conditions, guess: Iterate, firsts: list[IterateNumbers]) -> tuple[Iterate, np.ndarray]:
    """The guesses of members moved aside, from the first iterates of searches; and whether that hardly moves something,
    shape (B,). ``guess``: a batch of iterates."""
    steps, moved, held = conditions.transcription, list[Iterate](), list[bool]()
    for first in firsts:
        own = Search(transcription_of(conditions), 1.0, 1)
        own.trajectory.set_iterate(first)
        held.append(own.perturb())
        moved.append(iterate_of(own.trajectory.iterate, guess, steps))
    return joined(moved).bare, np.array(held)


def iterate_of(found: IterateNumbers, like: Iterate, steps: Any) -> Iterate:
    """The iterate of one member, in arrays of the shapes of a batch of iterates."""

    def array(name: str, own: np.ndarray) -> np.ndarray:
        return found.array(name).reshape(1, *own.shape[1:])

    own, count = like.unknowns, len(like.costates[0]) - 1
    if isinstance(own, CollocationUnknowns):
        names = "CENTRES", "VELOCITIES", "CONTROLS", "POINT_COSTATES"
        unknowns: Any = CollocationUnknowns(*map(array, names, own))
    else:
        unknowns = Unknowns(array("CENTRES", own.centres), array("CONTROLS", own.controls))
    return Iterate(unknowns, array("COSTATES", like.costates), _slacks(found, steps, count))


def _slacks(found: IterateNumbers, steps: Any, count: int) -> Slacks | None:
    """The slacks and multipliers of the inequalities of one member, if there are any."""
    if not steps.inequalities:
        return None
    none = {"SLACKS": 1.0, "LIMIT_MULTIPLIERS": 0.0, "EXCESSES": 0.0, "PENALTIES": np.inf}
    arrays = (whole_limits(steps, found.array(name), count, unasked) for name, unasked in none.items())
    return Slacks(*arrays, barrier=found.array("BARRIER"))


def extremals_of(conditions: Conditions, guess: Iterate, members: list[Member], stopped: bool) -> DiscreteExtremals:
    """The results of the members of a batch together."""
    steps, shape = conditions.transcription, guess.costates.shape
    iterate = joined([iterate_of(member.iterate, guess, steps) for member in members])

    def at_stages(costates: np.ndarray) -> AtStages:
        return steps.at_stages(iterate.unknowns, costates, conditions.data, iterate.slacks)

    def system(k: int) -> KKTSystem:
        return KKTSystem(transcription_of(conditions), members[k].iterate, members[k].result.steps)

    flags = [np.array(own) for own in zip(*(member.result[FLAGS] for member in members), strict=True)]
    iterations, limited, claimed, strict, convex, solvable, infeasible, falling, _ = flags
    nodes, costates, residuals, totals, missing = map(_rows, zip(*(member[ARRAYS] for member in members), strict=True))
    return DiscreteExtremals(
        nodes.reshape(shape),
        costates.reshape(shape),
        totals[:, 0],
        Residuals(*residuals.T[[*range(5), LARGEST]]),
        missing,
        _inequalities(conditions, iterate.slacks, members),
        strict,
        convex,
        iterations,
        limited,
        claimed,
        solvable,
        infeasible,
        falling,
        at_stages,
        system,
        stopped,
    )


def _rows(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Arrays of the same shape along a new leading axis."""
    return arrays[0][None] if len(arrays) == 1 else np.stack(arrays)


def _inequalities(conditions: Conditions, slacks: Slacks | None, members: list[Member]) -> Inequalities | None:
    """The inequalities along all members, if there are any."""
    if slacks is None:
        return None
    steps, count = conditions.transcription, conditions.data.steps.shape[1]
    values = np.concatenate([whole_limits(steps, member.limits, count, 0.0) for member in members])
    sizes = np.stack([member.result.limits for member in members])[:, None, None]
    rate = np.array([member.result.rate for member in members])
    return Inequalities(values, steps.weights(conditions.data), slacks.slacks, slacks.multipliers, sizes, rate)


def find_on_core(conditions: Conditions, guess: Iterate, options: Any) -> DiscreteExtremals:
    """The extremals of a batch; from where a search found no minimum, other searches follow."""
    watch = Watch(options.callback)
    members = search_all(conditions, guess, SearchOptions(options.tolerance, options.max_iterations), watch)
    if all(own.result.strict and not own.perturbed for own in members):
        return extremals_of(conditions, guess, members, watch.stopped)
    from ..engine.core_restarts import restarted

    # Without controls there is one feasible trajectory, and only a minimum fits best.
    controlled = conditions.transcription.controls.dimension > 0
    settled = np.array([own.result.claimed if controlled else own.result.strict for own in members])
    settled &= [not own.perturbed for own in members]  # a degenerate guess is tried as it is too
    if settled.all():
        return extremals_of(conditions, guess, members, watch.stopped)
    ready, rest = np.flatnonzero(settled), np.flatnonzero(~settled)
    found = restarted(conditions.of(rest), taken(guess, rest), [members[k] for k in rest], rest, options, watch)
    if not ready.size:
        return found
    own = conditions.of(ready), taken(guess, ready), [members[k] for k in ready]
    return extremals_of(*own, watch.stopped).joined(found, np.argsort(np.concatenate([ready, rest])))
