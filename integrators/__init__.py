"""Integrators of Hamilton's equations and of optimal control problems, built on cotangent lifts."""

if __package__ != "retrax.integrators":
    raise ImportError(
        f"import this package as retrax.integrators (pip install .), not as {__package__}: "
        "a second copy of its classes would not match the first"
    )

from typing import TYPE_CHECKING

from .boundary_value import (
    Checks,
    Continuation,
    ControlStructure,
    Derivative,
    DiscretizationError,
    Extremal,
    Guess,
    Phase,
    PhasedSolution,
    PhaseEnds,
    RegularChecks,
    Sensitivity,
    SingularArc,
    SingularChecks,
    Solution,
    Solutions,
    Solver,
    Statistics,
    StepErrors,
    continuation,
    control_structure,
    default_guess,
    discretization_error,
    load_solution,
    load_solutions,
    multistart,
    solve,
    solve_phases,
    step_errors,
)
from .dirac import DiracIntegrator, DiracSystem
from .free import Free
from .initial_value import (
    KAHAN_LI_6,
    KAHAN_LI_8,
    SUZUKI,
    TRIPLE_JUMP,
    YOSHIDA_6,
    Composition,
    Flow,
    GeodesicRetraction,
    Integrator,
    LiftedIntegrator,
    PresymplecticIntegrator,
    SymplecticIntegrator,
    Trajectory,
    form_defect,
    integrate,
    integrate_many,
    load_trajectory,
)
from .problem import OptimalControlProblem
from .quantities import Quantities, Quantity
from .results import Result
from .singular import (
    L_H,
    S_H,
    Choice,
    Classification,
    MorseTest,
    SingularIntegrator,
    Stratum,
    classify,
    singular_integrator,
)
from .stages import ControlStage, GaussStage, HamiltonianStage, Stage

if TYPE_CHECKING:
    from .singular.symbolic import SymbolicClassification as SymbolicClassification

__all__ = [
    "KAHAN_LI_6",
    "KAHAN_LI_8",
    "L_H",
    "SUZUKI",
    "S_H",
    "TRIPLE_JUMP",
    "YOSHIDA_6",
    "Checks",
    "Choice",
    "Classification",
    "Composition",
    "Continuation",
    "ControlStage",
    "ControlStructure",
    "Derivative",
    "DiracIntegrator",
    "DiracSystem",
    "DiscretizationError",
    "Extremal",
    "Flow",
    "Free",
    "GaussStage",
    "GeodesicRetraction",
    "Guess",
    "HamiltonianStage",
    "Integrator",
    "LiftedIntegrator",
    "MorseTest",
    "OptimalControlProblem",
    "Phase",
    "PhaseEnds",
    "PhasedSolution",
    "PresymplecticIntegrator",
    "Quantities",
    "Quantity",
    "RegularChecks",
    "Result",
    "Sensitivity",
    "SingularArc",
    "SingularChecks",
    "SingularIntegrator",
    "Solution",
    "Solutions",
    "Solver",
    "Stage",
    "Statistics",
    "StepErrors",
    "Stratum",
    "SymplecticIntegrator",
    "Trajectory",
    "classify",
    "continuation",
    "control_structure",
    "default_guess",
    "discretization_error",
    "form_defect",
    "integrate",
    "integrate_many",
    "load_solution",
    "load_solutions",
    "load_trajectory",
    "multistart",
    "singular_integrator",
    "solve",
    "solve_phases",
    "step_errors",
]


def __getattr__(name: str) -> type:
    """``SymbolicClassification``, which needs SymPy, when it is asked for."""
    if name == "SymbolicClassification":
        from .singular.symbolic import SymbolicClassification

        return SymbolicClassification
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
