"""The extremals of regular problems by Newton's method, in phases, with coupled ends if they are."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from ...compute.threads import each_in_threads
from .audit.independence_of_boundary_conditions import dependence_notes, equation_words, require_independent
from .inputs.options import Options
from .reformulations.restarts import search_member
from .transcription.core_transcription import extremals_of
from .transcription.discrete_extremals import DiscreteExtremals
from .transcription.discrete_phase import LinkedPhases
from .transcription.iterate import Iterate, LinkedIterate
from .transcription.linkages import PhaseProblem
from .transcription.member_search import Watch
from .transcription.search_record import SearchRecord


def find_extremals(transcribed: Any, options: Options) -> DiscreteExtremals:
    """The extremals of a batch of trajectories, with coupled ends if they are."""
    traced = transcribed.traced
    problem, names = LinkedPhases((transcribed.conditions,), traced.coupling), list[str]()
    if traced.coupling is not None:
        names = equation_words([traced.own])
    return find_phases(problem, (transcribed.guess,), [traced.own], names, options)[0][0]


def find_phases(
    problem: LinkedPhases,
    parts: tuple[Iterate, ...],
    phase_problems: Sequence[PhaseProblem],
    names: Sequence[str],
    options: Options,
) -> tuple[list[DiscreteExtremals], np.ndarray]:
    """The extremals of a batch for each phase, and the multipliers of what couples the ends, shape (B, M).

    ``parts``: guesses of the phases; ``names`` of the equations between the ends.
    """
    guess, watch = problem.guess(parts), Watch(options.callback)
    if problem.coupling is not None:
        require_independent(problem, guess, names)
    records, notes = search_all(problem, guess, options, watch), None
    if problem.coupling is not None:
        notes = dependence_notes(problem, records, names)
        pairs = zip(records, notes, strict=True)
        records = [record.with_facts(strict=record.facts.strict and not words) for record, words in pairs]
    multipliers, begin = np.stack([record.multipliers for record in records]), 0
    extremals = list[DiscreteExtremals]()
    for j, (phase, part, phase_problem) in enumerate(zip(problem.phases, parts, phase_problems, strict=True)):
        boundary = dict[str, np.ndarray]()
        for name, size in phase_problem.sizes.items() if problem.coupling is not None else ():
            boundary[name] = multipliers[:, begin : begin + size]
            begin += size
        found = extremals_of(phase, part, records, watch.stopped, j)
        extremals.append(found._replace(boundary=boundary or None, notes=notes))
    return extremals, multipliers


def search_all(problem: LinkedPhases, guess: LinkedIterate, options: Options, watch: Watch) -> list[SearchRecord]:
    """The results for all members, in threads side by side, or one after the other where a callback watches them."""
    run, count = partial(search_member, problem, guess, options, watch), len(guess.parts[0].costates)
    if count == 1 or watch.callback is not None:
        return list(map(run, range(count)))
    return each_in_threads(run, count, watch.stop)
