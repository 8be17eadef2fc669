"""Searches of the compiled core for phases, and for ends that are coupled, in the place of ``Descent``."""

from collections.abc import Callable
from functools import partial
from threading import local
from typing import Any, final
from weakref import WeakKeyDictionary

import numpy as np

from ....compute.binding.multiphase import CoupledEnds, Multiphase
from ....compute.binding.search import Search, SearchResult, SearchStatus
from ....compute.binding.tape_machine import MachineProgram
from ....compute.binding.transcription import Transcription
from ....manifolds.numerics.ambient import joined
from ..transcription.core_search import Watch, iterate_of, made, put
from ..transcription.iteration import Iteration
from .acceptance import WIDE
from .barrier import Barrier
from .core_restarts import _units
from .coupling import Coupling
from .found import Found
from .joint import JointConditions
from .joint_system import JointAssembled, JointIterate, JointUnits


class _ThreadTranscriptions(local):
    """The transcriptions of phases of a thread, which no other one may use at the same time."""

    def __init__(self) -> None:
        self.of: WeakKeyDictionary[Any, dict[int, Transcription]] = WeakKeyDictionary()


_known = _ThreadTranscriptions()


def is_on_core(conditions: JointConditions) -> bool:
    """Whether the core has all that a search asks for."""
    return hasattr(conditions.coupling._function, "tape")


def _transcription_of(phase: Any) -> Transcription:
    """The transcription of a phase; phases with the same one share it."""
    known, count = _known.of.setdefault(phase.transcription, {}), phase.data.steps.shape[1]
    if count not in known:
        known.clear()  # of meshes that phases do not have any more
        known[count] = made(phase)
    return known[count]


def _coupled_ends(coupling: Coupling) -> CoupledEnds:
    """What couples the ends."""
    tape: Any = coupling._function
    p = tape.tape.program
    program = MachineProgram(p.codes, p.registers, p.values, p.inputs, p.outputs, p.size, None)
    sizes = zip(coupling.links, coupling.sizes[1:], strict=True)
    return CoupledEnds(program, coupling.count, [(own.target, own.manifold.dimension, size) for own, size in sizes])


@final
class CorePhases:
    """Searches of the members of a batch, one after the other; see ``Descent``."""

    def __init__(
        self,
        conditions: JointConditions,
        tolerance: float,
        max_iterations: int,
        callback: Callable[[Iteration], Any] | None,
        as_it_is: bool = False,
        width: float = WIDE,
        firm: float = 1.0,
    ) -> None:
        self.conditions, self.tolerance, self.max_iterations = conditions, tolerance, max_iterations
        self.callback, self.width, self.firm, self._watch = callback, width, firm, Watch(callback)
        self.lost = np.zeros(0, bool)  # no guess is moved aside

    def ended(self, guess: JointIterate) -> Found:
        """The result of the searches from the guesses, which an interrupt ends."""
        joint, count = self.conditions, len(guess.multipliers)
        self.lost = np.zeros(count, bool)
        problem = Multiphase([_transcription_of(phase) for phase in joint.phases], _coupled_ends(joint.coupling))
        found = [self._searched(problem, guess, k) for k in range(count)]
        told = [results[0] for results, *_ in found]
        self._take_units([results for results, *_ in found])
        iterate, self._first = (joined([own[k] for own in found]) for k in (1, 2))
        return self._found(iterate, told)

    def _searched(
        self, problem: Multiphase, guess: JointIterate, k: int
    ) -> tuple[list[SearchResult], JointIterate, JointIterate]:
        """The results of a member for all phases, its last iterate and its first one."""
        own = self.tolerance, self.max_iterations, self.width, self.firm
        search = Search(problem, *own, looks=False, report=partial(self._watch.told, k))
        search.multipliers()[...] = guess.multipliers[k]
        for j, (phase, part) in enumerate(zip(self.conditions.phases, guess.parts, strict=True)):
            put(search.phase(j), phase, part, k)
        try:
            status = search.run()
        except KeyboardInterrupt:
            status = SearchStatus.STOPPED
        results = [search.read(j) for j in range(len(guess.parts))]
        if status is SearchStatus.STOPPED or results[0].stopped:
            self._watch.stop()
        both = []
        for name in ("trajectory", "first"):
            arrays = [getattr(own, name) for own in results]
            own = zip(arrays, guess.parts, self.conditions.phases, strict=True)
            parts = tuple(iterate_of(at.iterate, part, phase.transcription) for at, part, phase in own)
            both.append(JointIterate(parts, search.multipliers(name == "first")[None].copy()))
        results = [
            own._replace(trajectory=None, first=None, limits=own.limits.copy(), equations=own.equations.copy())
            for own in results
        ]
        scales = [(own.judging.copy, own.steps.copy) for own in results]
        results = [own._replace(judging=a, steps=b) for own, (a, b) in zip(results, scales, strict=True)]
        return results, *both

    def _take_units(self, members: list[list[SearchResult]]) -> None:
        """Let the conditions have the natural sizes of the searches."""
        joint, firm = self.conditions, np.array([self.firm])
        for j, phase in enumerate(joint.phases):
            own = [results[j] for results in members]
            phase.units, phase.wider = joined([_units(one.judging) for one in own]), None
            steps = phase.transcription
            if steps.inequalities:
                barriers = [Barrier(np.array([one.rate]), one.limits[None], steps.kept[None], firm) for one in own]
                phase.barrier = joined(barriers)
        rows = np.stack([results[0].equations for results in members])
        nodes = np.concatenate([*(phase.judging.nodes for phase in joint.phases), rows], axis=1)
        joint.units = JointUnits(nodes, joint.phases[0].judging.cost)

    @property
    def stopped(self) -> bool:
        """Whether the callback, or an interrupt, has asked for an end."""
        return self._watch.stopped

    def first(self) -> tuple[JointIterate, JointAssembled]:
        """The guesses with their first multipliers and slacks, and their systems."""
        return self._first, self.conditions.assemble(self._first)

    def failed(self, found: Found) -> np.ndarray:
        """Which members begin anew from guesses that are moved aside: none."""
        return np.zeros_like(found.claimed)

    def _found(self, iterate: Any, told: list[SearchResult]) -> Found:
        conditions: Any = self.conditions
        assembled = conditions.assemble(iterate)
        residuals = conditions.residuals(iterate, assembled)
        names = "claimed", "strict", "solvable", "infeasible", "falls", "iterations", "limited"
        own = {name: np.array([getattr(one, name) for one in told]) for name in names}
        missing = assembled.extent.lacking / conditions.judging.nodes
        ended = (own[name] for name in ("strict", "iterations", "limited", "claimed", "solvable"))
        facts = self.stopped, missing, own["infeasible"], conditions.judging.cost, own["falls"]
        return Found(iterate, assembled, residuals, *ended, *facts)
