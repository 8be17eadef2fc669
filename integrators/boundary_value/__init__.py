"""Boundary-value problems: stages assembled into a KKT system, its linear algebra, Newton's method, solution and
report."""

from .batch_file import load_solutions
from .checks import Checks, RegularChecks, SingularChecks
from .continuation import Continuation, continuation
from .differentiable import DifferentiableSolution
from .guess import Guess, default_guess
from .multistart import multistart
from .phased_solution import PhasedSolution
from .phases import Phase, solve_phases
from .posed_phase import PhaseEnds
from .propagation import DiscretizationError, discretization_error
from .sensitivity import Derivative, Sensitivity
from .singular_arcs import ClassifiedArc, find_singular_arcs
from .solution import SingularArc, Solution, Statistics, load_solution
from .solutions import Solutions
from .solve import solve
from .solver import Solver
from .step_errors import StepErrors, step_errors
from .structure import SwitchingStructure, switching_structure

__all__ = [
    "Checks",
    "ClassifiedArc",
    "Continuation",
    "Derivative",
    "DifferentiableSolution",
    "DiscretizationError",
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
