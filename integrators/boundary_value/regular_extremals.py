"""The extremals of regular problems by Newton's method, with coupled ends if they are."""

from collections.abc import Sequence
from typing import Any

from ...compute.binding.library import PARTS_ON_CORE
from .audit.independence_of_boundary_conditions import check_independence, equation_words, require_independent
from .engine.adaptor import adapted
from .engine.found import Found
from .engine.newton import newton
from .engine.parallel import newton_of_all
from .inputs.arguments import Options
from .transcription.core_search import find_on_core, is_on_core
from .transcription.discrete_extremals import DiscreteExtremals
from .transcription.discrete_phase import LinkedPhases
from .transcription.linkages import PhaseProblem


def find_extremals(transcribed: Any, options: Options) -> DiscreteExtremals:
    """The extremals of a batch of trajectories, with coupled ends if they are."""
    traced = transcribed.traced
    if traced.coupling is None:
        conditions, guess = transcribed.conditions, transcribed.guess
        if "search" in PARTS_ON_CORE and is_on_core(conditions):
            return find_on_core(conditions, guess, options)
        return adapted(conditions, _find(transcribed, conditions, guess, options))
    joint: Any = LinkedPhases((transcribed.conditions,), traced.coupling)
    guess = joint.guess((transcribed.guess,))
    names = equation_words([traced.own])
    require_independent(joint, guess, names)
    found: Any = _find(transcribed, joint, guess, options)
    return phase_of(joint, check_independence(joint, found, names), 0, [traced.own])


def _find(transcribed: Any, conditions: Any, guess: Any, options: Options) -> Found:
    """The result of Newton's method, by parts of the batch if nothing needs the whole batch.

    A callback watches all of it, and XLA, which has threads of its own, would compile for each size of a part.
    """
    if options.callback is not None or transcribed.traced.evaluator.name != "tape":
        return newton(conditions, guess, *options)
    steps, shape = transcribed.traced.steps, transcribed.conditions.data.steps.shape
    return newton_of_all(conditions, guess, (shape[0], shape[1] * steps.stages), *options[:2])


def phase_of(conditions: LinkedPhases, found: Found, k: int, phases: Sequence[PhaseProblem]) -> DiscreteExtremals:
    """The result for a phase, with the multipliers of its boundary constraints by their names."""
    joint: Any = found
    begin, boundary = sum(sum(phase.sizes.values()) for phase in phases[:k]), {}
    for name, size in phases[k].sizes.items():
        boundary[name] = joint.assembled.coupled.multipliers[:, begin : begin + size]
        begin += size
    own = found._replace(iterate=joint.iterate.parts[k], assembled=joint.assembled.parts[k], boundary=boundary)
    return adapted(conditions.phases[k], own)
