"""Guesses moved to the states to which their controls lead."""

from typing import Any

import numpy as np

from ...stages.explicit_runge_kutta import control_spans


def rolled_out(conditions: Any, guess: Any) -> tuple[Any, np.ndarray]:
    """The guesses with the states to which their controls lead from their starts; and where these are finite."""
    if conditions.joint:
        each = [rolled_out(*of) for of in zip(conditions.phases, guess.parts, strict=True)]
        parts, finite = zip(*each, strict=True)
        return guess._replace(parts=parts), np.all(finite, axis=0)
    transcription, data, controls = conditions.transcription, conditions.data, guess.unknowns.controls
    starts, roll_out = conditions.reached(guess)[0], conditions.at_nodes.roll_out
    states = np.empty((*controls.shape[:3], starts.shape[1]))
    for k, start in enumerate(starts):
        held = control_spans(transcription.method, data.steps[k])
        rows = controls[k].reshape(len(held[0]), -1)
        states[k] = roll_out.states(start, rows, held, data.parameters[k]).reshape(states.shape[1:])
    costates = np.zeros_like(guess.costates)
    finite = np.all(np.isfinite(states), axis=(1, 2, 3))
    with np.errstate(all="ignore"):
        unknowns = transcription.begin(states, controls, costates, data)
    return guess._replace(unknowns=unknowns, costates=costates, slacks=None), finite
