"""Sizes that the functions of all discretizations of a problem have in common."""

from typing import NamedTuple

import numpy as np

from ....problem.optimal_control_problem import OptimalControlProblem
from ....problem.path_constraints import entry_words

AtStages = tuple[np.ndarray, np.ndarray, np.ndarray]  # states, controls and costates


class Tableau(NamedTuple):
    """A tableau about the middle of a step: ``matrix = A - 1 b' / 2``, and ``weights = b``."""

    matrix: np.ndarray  # (s, s)
    weights: np.ndarray  # (s,)


def count_inequalities(problem: OptimalControlProblem) -> tuple[int, int]:
    """Numbers of inequalities of a step at a point, and at its end and its beginning."""
    return len(problem._inequality_names), 2 * len(entry_words(problem._node_sizes))


def kept_bounds(problem: OptimalControlProblem) -> np.ndarray:
    """The mask of the inequalities of a step that are bounds of free quantities: no iterate violates these."""
    once = problem._limits.once(problem._inequality_sizes)
    return np.append(once, np.zeros(sum(count_inequalities(problem)) - len(once), bool))
