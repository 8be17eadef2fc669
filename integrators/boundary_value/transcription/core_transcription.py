"""Transcribed problems for the compiled core, and the results of its searches as discrete extremals."""

from collections.abc import Sequence
from functools import partial
from threading import local
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ....compute.binding.multiphase import CoupledEnds
from ....compute.binding.problem_functions import CallbackFunction
from ....compute.binding.search import SearchFacts
from ....compute.binding.structs import Residual
from ....compute.binding.tape_machine import MachineProgram
from ....compute.binding.transcription import IterateNumbers, Sizes, Transcription
from ...problem.point_layout import PointLayout
from .discrete_extremals import DiscreteExtremals, Inequalities, Residuals
from .discrete_phase import DiscretePhase
from .functions.linked_ends import LinkageFunctions
from .iterate import CollocationUnknowns, Iterate, Slacks, Unknowns
from .kkt_system import KKTSystem
from .search_record import PhaseRecord, SearchRecord

JUDGED = [
    Residual.DEFECT,
    Residual.STATIONARITY,
    Residual.VIOLATION,
    Residual.EXCESS,
    Residual.COMPLEMENTARITY,
    Residual.BARRIER_ERROR,
]  # the fields of Residuals
KEPT_MESHES = 4  # transcriptions of one problem and thread, of meshes with other numbers of steps


class _ThreadTranscriptions(local):
    """The transcriptions of a thread, which no other one may use at the same time."""

    def __init__(self) -> None:
        self.of: WeakKeyDictionary[Any, dict[int, Transcription]] = WeakKeyDictionary()


_kept = _ThreadTranscriptions()


def transcription_of(conditions: DiscretePhase) -> Transcription:
    """The transcription of a problem for the core; the last transcriptions are kept."""
    count = conditions.data.steps.shape[1]
    known = _kept.of.setdefault(conditions.transcription, {})
    if count not in known:
        while len(known) >= KEPT_MESHES:
            del known[next(iter(known))]
        known[count] = make_transcription(conditions)
    return known[count]


def make_transcription(conditions: DiscretePhase, instruction_set: int | None = None) -> Transcription:
    """The transcription of a problem for the core, by the processor's best instruction set or a lesser one."""
    steps, nodes = conditions.transcription, conditions.at_nodes
    sizes = Sizes(
        conditions.data.steps.shape[1], steps.stages, steps.manifold.dimension, steps.state.size,
        steps.controls.dimension, steps.control.size, steps.parameter.size, *steps.limit_sizes,
        steps.node_costs,
    )  # fmt: skip
    groups, of_controls = _groups(nodes.layout), None if nodes.flat_controls else _groups(nodes.control)
    bounds = sum(map(len, nodes.problem._limits.bounded.values()))
    traced = steps.functions | nodes.functions
    functions = {name: _function(function, instruction_set) for name, function in traced.items()}
    return Transcription(
        sizes, steps.tableau, groups, of_controls, steps.kept.astype(float), bounds, functions, instruction_set
    )


def _function(function: Any, instruction_set: int | None) -> MachineProgram | CallbackFunction:
    """A function of a problem for the core: a tape, or a callback to what its evaluator has compiled."""
    if not hasattr(function, "tape"):
        return CallbackFunction(function, *function.sizes)
    return function.tape.program.on_core(instruction_set)


def coupled_ends(coupling: LinkageFunctions) -> CoupledEnds:
    """The coupling of ends for the core."""
    sizes = zip(coupling.links, coupling.sizes[1:], strict=True)
    links = [(link.target, link.manifold.dimension, size) for link, size in sizes]
    return CoupledEnds(_function(coupling.function, None), coupling.count, links)


def _groups(layout: PointLayout) -> tuple[np.ndarray, np.ndarray]:
    """The column and the array of each entry of a point."""
    return layout.columns.astype(np.intp), layout.arrays.astype(np.intp)


def flat_limits(steps: Any, array: np.ndarray) -> np.ndarray:
    """The core's order of an array of inequalities, shape ``(N, r, c)``."""
    at_points, at_nodes = steps.limit_sizes
    if not at_nodes:
        return array.ravel()
    return np.concatenate([array[:, : steps.stages, :at_points].ravel(), array[:, steps.stages, at_points:].ravel()])


def whole_limits(steps: Any, flat: np.ndarray, count: int, unasked: float) -> np.ndarray:
    """Arrays of inequalities of so many steps, shape ``(B, N, r, c)``, from rows in the order of the core.

    ``unasked``: the number where there is none.
    """
    (at_points, at_nodes), members = steps.limit_sizes, len(flat)
    shape = members, count, steps.places, steps.inequalities
    if not at_nodes:
        return flat.reshape(shape)
    whole, of_points = np.full(shape, unasked), count * steps.stages * at_points
    whole[:, :, : steps.stages, :at_points] = flat[:, :of_points].reshape(members, count, steps.stages, at_points)
    whole[:, :, steps.stages, at_points:] = flat[:, of_points:].reshape(members, count, at_nodes)
    return whole


def numbers_of(conditions: DiscretePhase, iterate: Iterate, k: int) -> IterateNumbers:
    """The data of a member and the unknowns of its iterate, in the order of the core."""
    of = transcription_of(conditions)
    numbers = IterateNumbers(np.zeros(of.iterate_numbers), of.parts)
    for name, array in arrays_of_member(conditions, iterate, k).items():
        numbers.array(name)[...] = array.ravel()
    return numbers


def arrays_of_member(conditions: DiscretePhase, iterate: Iterate, k: int) -> dict[str, np.ndarray]:
    """The data of a member and the unknowns of its iterate, by the names of the core."""
    data, ends = conditions.data, conditions.ends
    arrays = {
        "STEP_SIZE": data.steps[k], "PARAMETERS": data.parameters[k], "START": ends.start[k], "END": ends.end[k],
        "START_ENTRIES": ends.start_entries, "END_ENTRIES": ends.end_entries, "FIXED": conditions.fixed[k],
        "CENTRES": iterate.unknowns.centres[k], "CONTROLS": iterate.unknowns.controls[k],
        "COSTATES": iterate.costates[k],
    }  # fmt: skip
    if isinstance(iterate.unknowns, CollocationUnknowns):
        arrays |= {"VELOCITIES": iterate.unknowns.velocities[k], "POINT_COSTATES": iterate.unknowns.costates[k]}
    if conditions.transcription.node_costs:
        arrays["NODE_INDICES"] = np.arange(1.0, data.steps.shape[1] + 1)
    if conditions.transcription.inequalities:
        weights = conditions.transcription.weights(data)
        arrays["LIMIT_WEIGHTS"] = flat_limits(conditions.transcription, weights[k if len(weights) > 1 else 0])
        arrays["LIMIT_MULTIPLIERS"] = np.zeros_like(arrays["LIMIT_WEIGHTS"])
        if iterate.slacks is not None:
            multipliers = iterate.slacks.multipliers[k]
            arrays["LIMIT_MULTIPLIERS"] = flat_limits(conditions.transcription, multipliers)
    return arrays


def iterates_of(found: IterateNumbers, like: Iterate, steps: Any) -> Iterate:
    """The iterates of members whose numbers are in rows, in arrays of the shapes of a batch of iterates."""

    def array(name: str, own: np.ndarray) -> np.ndarray:
        return found.array(name).reshape(len(found.numbers), *own.shape[1:])

    unknowns_like, count = like.unknowns, like.costates.shape[1] - 1
    if isinstance(unknowns_like, CollocationUnknowns):
        names = "CENTRES", "VELOCITIES", "CONTROLS", "POINT_COSTATES"
        unknowns: Any = CollocationUnknowns(*map(array, names, unknowns_like))
    else:
        unknowns = Unknowns(array("CENTRES", unknowns_like.centres), array("CONTROLS", unknowns_like.controls))
    return Iterate(unknowns, array("COSTATES", like.costates), _slacks(found, steps, count))


def _slacks(found: IterateNumbers, steps: Any, count: int) -> Slacks | None:
    """The slacks and multipliers of the inequalities of members, if there are any."""
    if not steps.inequalities:
        return None
    none = {"SLACKS": 1.0, "LIMIT_MULTIPLIERS": 0.0, "EXCESSES": 0.0, "PENALTIES": np.inf}
    arrays = (whole_limits(steps, found.array(name), count, unasked) for name, unasked in none.items())
    return Slacks(*arrays, barrier=found.array("BARRIER")[:, 0])


def extremals_of(
    conditions: DiscretePhase, guess: Iterate, records: Sequence[SearchRecord], stopped: bool, phase: int = 0
) -> DiscreteExtremals:
    """The results of a phase for the members of a batch together."""
    steps, shape = conditions.transcription, guess.costates.shape
    members = [record.phases[phase] for record in records]
    fields: Any = zip(*records, strict=True), zip(*members, strict=True)
    each: Any = SearchRecord(*fields[0])  # of all members: a tuple for each field
    own: Any = PhaseRecord(*fields[1])
    numbers = _rows([iterate.numbers for iterate in own.iterate])
    iterate = iterates_of(own.iterate[0]._replace(numbers=numbers), guess, steps)

    def system(k: int) -> KKTSystem:
        return KKTSystem(transcription_of(conditions), members[k].iterate, members[k].steps)

    columns: Any = map(np.array, zip(*each.facts, strict=True))
    facts: Any = SearchFacts(*columns)  # of all members: an array for each
    return DiscreteExtremals(
        nodes=_rows(own.nodes).reshape(shape),
        costates=_rows(own.costates).reshape(shape),
        cost=_rows(own.totals)[:, 0],
        residuals=Residuals(*_rows(each.residuals).T[JUDGED]),
        missing=_rows(each.missing),
        inequalities=_inequalities(conditions, iterate.slacks, own),
        strict_minimum=facts.strict,
        convex=facts.legendre_holds,
        iterations=facts.iterations,
        limited=facts.iteration_limit_reached,
        converged=facts.converged,
        solvable=facts.solvable,
        infeasible=facts.infeasible,
        falling=facts.diverging,
        at_stages=partial(steps.at_stages, iterate.unknowns, data=conditions.data, slacks=iterate.slacks),
        system=system,
        stopped=stopped,
    )


def _rows(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Arrays of the same shape along a new leading axis."""
    return arrays[0][None] if len(arrays) == 1 else np.stack(arrays)


def _inequalities(conditions: DiscretePhase, slacks: Slacks | None, members: Any) -> Inequalities | None:
    """The inequalities along all members, if there are any, from the fields of the records of a phase."""
    if slacks is None:
        return None
    steps, count = conditions.transcription, conditions.data.steps.shape[1]
    values, sizes = whole_limits(steps, _rows(members.limits), count, 0.0), _rows(members.limit_sizes)[:, None, None]
    weights, rate = steps.weights(conditions.data), np.array(members.rate)
    return Inequalities(values, weights, slacks.slacks, slacks.multipliers, sizes, rate)
