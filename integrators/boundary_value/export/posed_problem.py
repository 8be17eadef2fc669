"""A problem with its data, a guess and a solution, in the arrays of the core."""

from dataclasses import dataclass
from typing import final

import numpy as np

from ....compute.binding.transcription import Trajectory, Transcription


@final
@dataclass(frozen=True, eq=False)
class PosedProblem:
    """A transcribed problem, its data and default guess, and the solution.

    ``given``: a trajectory with the data and the guess; ``given_numbers``: numbers of a state of the user, without what
    a reformulation adds; ``shares``, ``limit_steps``: weights of the inequalities relative to their steps, and these
    steps; ``horizon_entry``: the entry of the states that is the logarithm of the free horizon over its guess, plus
    ``at_guess``, or None; ``gains``: whether outputs have gains; ``columns``: names of entries; ``words``: texts of the
    header.
    """

    transcription: Transcription
    given: Trajectory
    given_numbers: int
    fractions: np.ndarray
    horizon: float
    shares: np.ndarray
    limit_steps: np.ndarray
    horizon_entry: int | None
    at_guess: float
    states: np.ndarray  # (N + 1, E)
    cost: float
    duration: float
    tolerance: float
    max_iterations: int
    gains: bool
    columns: dict[str, list[str]]
    words: dict[str, str]
