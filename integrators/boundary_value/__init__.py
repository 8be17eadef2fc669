"""Boundary-value problems: stages assembled into a KKT system, its linear algebra, Newton's method, solution and
report."""

from .batch_file import load_solutions
from .checks import Checks, RegularChecks, SingularChecks
from .continuation import Continuation, continuation
from .differentiable import Extremal
from .guess import Guess, default_guess
from .multistart import multistart
from .phased_solution import PhasedSolution
from .phases import Phase, solve_phases
from .posed_phase import PhaseEnds
from .propagation import DiscretizationError, discretization_error
from .sensitivity import Derivative, Sensitivity
from .singular_arcs import ClassifiedArc, singular_arcs
from .solution import SingularArc, Solution, Statistics, load_solution
from .solutions import Solutions
from .solve import solve
from .solver import Solver
from .step_errors import StepErrors, step_errors
from .structure import ControlStructure, control_structure

__all__ = [
    "Checks",
    "ClassifiedArc",
    "Continuation",
    "ControlStructure",
    "Derivative",
    "DiscretizationError",
    "Extremal",
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
    "continuation",
    "control_structure",
    "default_guess",
    "discretization_error",
    "load_solution",
    "load_solutions",
    "multistart",
    "singular_arcs",
    "solve",
    "solve_phases",
    "step_errors",
]
