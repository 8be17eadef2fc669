"""The extremals of regular problems by Newton's method, in phases, with coupled ends if they are."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .audit.independence_of_boundary_conditions import dependence_notes, equation_words, require_independent
from .inputs.arguments import Options
from .reformulations.restarts import search_all
from .transcription.core_transcription import extremals_of
from .transcription.discrete_extremals import DiscreteExtremals
from .transcription.discrete_phase import LinkedPhases
from .transcription.iterate import Iterate
from .transcription.linkages import PhaseProblem
from .transcription.member_search import Watch


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
    owns: Sequence[PhaseProblem],
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
        records = [own.with_facts(strict=own.facts.strict and not words) for own, words in pairs]
    multipliers, found, begin = np.stack([own.multipliers for own in records]), list[DiscreteExtremals](), 0
    for j, (phase, part, own) in enumerate(zip(problem.phases, parts, owns, strict=True)):
        boundary = dict[str, np.ndarray]()
        for name, size in own.sizes.items() if problem.coupling is not None else ():
            boundary[name] = multipliers[:, begin : begin + size]
            begin += size
        extremals = extremals_of(phase, part, records, watch.stopped, j)
        found.append(extremals._replace(boundary=boundary or None, notes=notes))
    return found, multipliers
