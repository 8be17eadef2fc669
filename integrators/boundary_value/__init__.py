"""Boundary-value problems: stages assembled into a KKT system, its linear algebra, Newton's method, solution and report."""

from .guess import Guess, default_guess
from .solution import Checks, SingularArc, Solution, Statistics, load_solution
from .solve import solve

__all__ = ["Checks", "Guess", "SingularArc", "Solution", "Statistics", "default_guess", "load_solution", "solve"]
