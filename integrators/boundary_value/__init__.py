"""Boundary-value problems: stages assembled into a KKT system, its linear algebra, Newton's method, solution and
report."""

from .audit.discretization_error import DiscretizationError, discretization_error
from .audit.singular_arcs import ClassifiedArc, find_singular_arcs
from .audit.step_errors import StepErrors, step_errors
from .audit.switching_structure import SwitchingStructure, switching_structure
from .drivers.continuation import Continuation, continuation
from .drivers.multistart import multistart
from .drivers.phase_transcription import PhaseEnds
from .drivers.phases import Phase, solve_phases
from .guess import Guess, default_guess
from .solution.batch import Solutions, load_solutions
from .solution.covariance import Covariance
from .solution.diagnostics import Checks, RegularChecks, SingularArc, SingularChecks, Statistics
from .solution.differentiable_solution import DifferentiableSolution
from .solution.feedback import Feedback
from .solution.multiphase_solution import PhasedSolution
from .solution.record import Solution, load_solution
from .solution.sensitivity import Derivative, Sensitivity
from .solve import solve
from .solver import Solver

__all__ = [
    "Checks",
    "ClassifiedArc",
    "Continuation",
    "Covariance",
    "Derivative",
    "DifferentiableSolution",
    "DiscretizationError",
    "Feedback",
    "Guess",
    "Phase",
    "PhaseEnds",
    "PhasedSolution",
    "RegularChecks",
    "Sensitivity",
    "SingularArc",
    "SingularChecks",
    "Solution",
    "Solutions",
    "Solver",
    "Statistics",
    "StepErrors",
    "SwitchingStructure",
    "continuation",
    "default_guess",
    "discretization_error",
    "find_singular_arcs",
    "load_solution",
    "load_solutions",
    "multistart",
    "solve",
    "solve_phases",
    "step_errors",
    "switching_structure",
]
