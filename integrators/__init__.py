"""Integrators of Hamilton's equations and of optimal control problems, built on cotangent lifts."""

if __package__ != "retrax.integrators":
    raise ImportError(
        f"import this package as retrax.integrators (pip install .), not as {__package__}: "
        "a second copy of its classes would not match the first"
    )

from typing import TYPE_CHECKING, Any

from ..former_names import former
from ..retractions import Gauss
from . import boundary_value, closed_loop, dirac, initial_value, stages
from .boundary_value import *
from .closed_loop import *
from .dirac import *
from .initial_value import *
from .problem.free_quantities import Free
from .problem.optimal_control_problem import OptimalControlProblem
from .problem.quantities import Quantities, Quantity
from .problem.spline_table import Table, tabulated
from .reporting.result_sentences import Result
from .singular import Classification, SingularIntegrator, classify, singular_integrator
from .stages import *

if TYPE_CHECKING:
    from .singular.symbolic import SymbolicClassification as SymbolicClassification

__all__ = [
    "Classification",
    "Free",
    "Gauss",
    "OptimalControlProblem",
    "Quantities",
    "Quantity",
    "Result",
    "SingularIntegrator",
    "Table",
    "classify",
    "singular_integrator",
    "tabulated",
]
__all__ += boundary_value.__all__
__all__ += closed_loop.__all__
__all__ += dirac.__all__
__all__ += initial_value.__all__
__all__ += stages.__all__


FORMER = {
    "ControlStructure": "SwitchingStructure",
    "Extremal": "DifferentiableSolution",
    "control_structure": "switching_structure",
    "form_defect": "symplecticity_defect",
    "singular_arcs": "find_singular_arcs",
    **{name: f"singular.{name}" for name in ("L_H", "S_H", "Choice", "MorseTest", "Stratum")},
}


def __getattr__(name: str) -> Any:
    """``SymbolicClassification``, which needs SymPy, when it is asked for, and former names."""
    if name == "SymbolicClassification":
        from .singular.symbolic import SymbolicClassification

        return SymbolicClassification
    return former(__name__, FORMER, name)


def __dir__() -> list[str]:
    """The public names."""
    return sorted(__all__)
