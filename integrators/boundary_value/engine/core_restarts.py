"""The linear system of a member that the core has found, in the arrays of the engine."""

from copy import copy
from typing import Any

import numpy as np

from ..transcription.core_search import iterate_of
from ..transcription.iterate import Iterate
from .barrier import Barrier
from .conditions import Conditions
from .kkt_system import Assembled
from .scaling import Units


def system_of(conditions: Conditions, guess: Iterate, member: Any, k: int) -> tuple[Conditions, Iterate, Assembled]:
    """The KKT system of a member at its iterate, with the conditions that have its natural sizes."""
    own = copy(conditions.of(np.array([k])))
    own._survey = own._appraisal = own.ahead = None
    steps = own.transcription
    own.units, own.wider, own.barrier = _units(member.judging), _units(member.steps), None
    if steps.inequalities:
        sizes = np.array([member.rate]), member.limit_sizes[None]
        own.barrier = Barrier(*sizes, steps.kept[None].copy(), np.ones(1))
    iterate = iterate_of(member.iterate, guess, steps)
    return own, iterate, own.assemble(iterate)


def _units(scale: Any) -> Units:
    return Units(scale.unknowns[None], scale.nodes[None], np.array([scale.cost]))
