"""Guesses with the states to which their controls lead."""

import numpy as np

from ...stages.explicit_runge_kutta import control_spans
from .discrete_phase import DiscretePhase
from .iterate import Iterate


def rollout(conditions: DiscretePhase, guess: Iterate) -> Iterate | None:
    """The guess of one member with the states to which its controls lead from its start; None unless all are finite."""
    transcription, data, controls = conditions.transcription, conditions.data, guess.unknowns.controls
    start = conditions.end_nodes(guess)[0][0]
    held = control_spans(transcription.method, data.steps[0])
    rows = controls[0].reshape(len(held[0]), -1)
    states = conditions.at_nodes.roll_out.states(start, rows, held, data.parameters[0])
    if not np.all(np.isfinite(states)):
        return None
    costates = np.zeros_like(guess.costates)
    with np.errstate(all="ignore"):
        unknowns = transcription.begin(states.reshape(*controls.shape[:3], -1), controls, costates, data)
    return Iterate(unknowns, costates)
