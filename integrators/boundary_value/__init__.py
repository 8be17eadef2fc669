"""Boundary-value problems: stages assembled into a KKT system, its linear algebra, Newton's method, solution and report."""

from .guess import Guess, interpolate
from .solution import Checks, Solution, Statistics, load_solution
from .solve import solve

__all__ = ["Checks", "Guess", "Solution", "Statistics", "interpolate", "load_solution", "solve"]
