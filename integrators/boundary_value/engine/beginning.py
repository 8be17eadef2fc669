"""The first iterates: units from the guesses, and the slacks of their inequalities."""

from typing import TYPE_CHECKING, cast

import numpy as np

from .barrier import CLOSEST, FIRST, KNOWN, LOWEST, Barrier
from .batches import merged
from .first_units import first_units
from .inequalities import Held, Slacks
from .kkt_system import Assembled, Iterate
from .transcription import Paid

if TYPE_CHECKING:
    from .conditions import Conditions


def in_units(conditions: "Conditions", guess: Iterate, paid: Paid | None = None) -> tuple[Iterate, Assembled]:
    """The guess, with inequalities that do not pull yet, and its system, from which the units are taken."""
    resting = guess
    if conditions.transcription.inequalities:
        shape = *conditions.data.steps.shape, conditions.transcription.places, conditions.transcription.inequalities
        resting = guess._replace(slacks=Slacks.none(shape))
    assembled = conditions.assemble(resting, paid)
    conditions.units, conditions.wider = first_units(conditions, resting, assembled), None
    return (resting if guess.slacks is None else guess), assembled


def started(
    conditions: "Conditions", first: Iterate, assembled: Assembled, paid: Paid | None = None
) -> tuple[Iterate, Assembled]:
    """The first iterate with the slacks of its inequalities, and its system."""
    if first.slacks is None:
        return first, assembled
    held, rate = assembled.blocks.inequalities, conditions.measured.cost / conditions.mean_step
    sizes = conditions.transcription.sizes(conditions.measured)
    conditions.barrier = Barrier.of(held, sizes, rate, conditions.transcription.kept)
    slacks = conditions.barrier.first(held)
    if np.any(first.slacks.multipliers):
        slacks = _nearer(conditions, first, held, slacks, paid)
    first = first._replace(slacks=slacks)
    return first, conditions.assemble(first, paid)


def _nearer(conditions: "Conditions", first: Iterate, held: Held, far: Slacks, paid: Paid | None) -> Slacks:
    """The slacks of members whose multipliers are known and fit: with a barrier of what they leave unsolved."""
    barrier, multipliers = cast(Barrier, conditions.barrier), cast(Slacks, first.slacks).multipliers
    least = np.full(len(far.barrier), CLOSEST)
    there = first._replace(slacks=barrier.near(held, multipliers, least))
    unsolved = conditions.residuals(there, conditions.assemble(there, paid)).largest
    near = barrier.near(held, multipliers, np.maximum(unsolved * np.minimum(unsolved, KNOWN), LOWEST))
    return merged((unsolved < FIRST) & np.any(multipliers, axis=(1, 2, 3)), near, far)
