"""Pictures and pages of solutions, trajectories, solves and retractions, each in one call.

Pictures use your axes if you give ``ax``.

Matplotlib is imported when a picture is drawn. Names and units are those of the problem (``labels`` and ``units``). A
picture of one panel returns its axes, and one of several the array of them; ``ax.figure.savefig(path)`` writes it.
"""

from .conditions import conserved, multipliers, optimality, switching
from .geometry import body_axes, path
from .histories import attitude, controls, histories, state
from .page import to_html
from .slopes import slopes
from .solves import convergence, sparsity
from .trajectories import energy, phase_portrait

__all__ = [
    "attitude",
    "body_axes",
    "conserved",
    "controls",
    "convergence",
    "energy",
    "histories",
    "multipliers",
    "optimality",
    "path",
    "phase_portrait",
    "slopes",
    "sparsity",
    "state",
    "switching",
    "to_html",
]
