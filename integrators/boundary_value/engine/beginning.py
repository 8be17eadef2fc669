"""The first iterates: units from the guesses, and the slacks of their inequalities."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..transcription.iterate import Iterate, Slacks
from .barrier import FITS, FOLLOWED, LEVELS, Barrier
from .batches import merged
from .first_units import first_units
from .kkt_system import Assembled
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


def started(conditions: "Conditions", first: Iterate, assembled: Assembled, firm: float | None = None) -> Iterate:
    """The first iterate with the slacks of its inequalities, if it has any, none of which is known.

    ``firm``: see ``Barrier``; None keeps that of the barrier before.
    """
    if first.slacks is None:
        return first
    known = 1.0 if conditions.barrier is None else conditions.barrier.firm
    held, rate = assembled.blocks.inequalities, conditions.measured.cost / conditions.mean_step
    sizes = conditions.transcription.sizes(conditions.measured)
    conditions.barrier = Barrier.of(held, sizes, rate, conditions.transcription.kept, known if firm is None else firm)
    return first._replace(slacks=conditions.barrier.first(held))


def warmed(conditions: Any, guess: Any, iterate: Any, systems: Sequence[Assembled]) -> tuple[Any, np.ndarray]:
    """The first iterate with slacks and multipliers near to those that the guess knows; and where these fit, or none
    are known.

    Newton's step from them tells which inequalities will hold, and which will pull: where it makes a slack or a
    multiplier negative, the barrier has to begin as high as the square of a share of that, in their units, else as low
    as it was for the step. A low one holds what it begins with, a higher one lets go of it: the one that has to begin
    lowest counts.
    """
    places = [k for k, part in enumerate(_parts(guess)) if part.slacks is not None and np.any(part.slacks.multipliers)]
    parts, phases = list(_parts(iterate)), getattr(conditions, "phases", (conditions,))
    fits = np.ones(len(parts[0].costates), bool)
    if not places:
        return iterate, fits
    known = [_parts(guess)[k].slacks.multipliers for k in places]
    held, own = [systems[k].blocks.inequalities for k in places], [phases[k].barrier for k in places]

    def at(slacks: Iterable[tuple[np.ndarray, np.ndarray]], barrier: np.ndarray) -> Any:
        """The iterate where these slacks and multipliers, in the phases that know some, are near to a barrier."""
        there = list(parts)
        for k, unit, of, both in zip(places, own, held, slacks, strict=True):
            there[k] = parts[k]._replace(slacks=unit.near(of, *both, barrier))
        return iterate._replace(parts=tuple(there)) if conditions.joint else there[0]

    asked = [(-of.values, multipliers) for of, multipliers in zip(held, known, strict=True)]
    least, ahead = np.full(len(fits), np.inf), asked
    for level in LEVELS:
        if np.all(least <= level):
            break
        finite, led = _followed(conditions, at(asked, np.full(len(fits), level)), places)
        lacks = np.max([unit.lacks(of, *both) for unit, of, both in zip(own, held, led, strict=True)], axis=0)
        needed = np.where(finite & np.isfinite(lacks), np.maximum((FOLLOWED * lacks) ** 2, level), np.inf)
        ahead = merged(needed < least, led, ahead)
        least = np.minimum(needed, least)
    known_of = np.any([np.any(multipliers, axis=(1, 2, 3)) for multipliers in known], axis=0)
    fits = least < FITS
    return merged(known_of & fits, at(ahead, np.minimum(least, FITS)), iterate), fits | ~known_of


def _parts(whole: Any) -> tuple[Any, ...]:
    """The parts of what belongs to phases, or it alone."""
    return getattr(whole, "parts", (whole,))


def _followed(conditions: Any, there: Any, places: list[int]) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
    """Whether there is a step of Newton's from an iterate, and the slacks and multipliers of some phases after the
    whole of it."""
    step = conditions.eliminate(there, conditions.assemble(there), np.zeros(len(_parts(there)[0].costates)))[0]
    both = [(_parts(there)[k].slacks, _parts(step)[k].turn) for k in places]
    return step.finite, [(at.slacks + turn.slacks, at.multipliers + turn.multipliers) for at, turn in both]


def forgotten(conditions: "Conditions", iterate: Iterate) -> Iterate:
    """The iterate without its multipliers."""
    none = iterate.slacks and Slacks.none(iterate.slacks.slacks.shape)
    unknowns = conditions.transcription.scaled(iterate.unknowns, np.zeros(len(iterate.costates)))
    return Iterate(unknowns, np.zeros_like(iterate.costates), none)
