"""The record of a known problem, and the library of problems by name."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from ..integrators import Guess, OptimalControlProblem, Solution, solve
from ..integrators.boundary_value.inputs.arguments import Method, step_fractions
from ..integrators.stages.explicit_runge_kutta import mesh_times
from ..manifolds import InvalidInputError
from ..retractions import Gauss, default_retraction

Path = Callable[[np.ndarray], tuple[Any, Any]]


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class KnownProblem:
    """An optimal control problem with its data, its source and its known optimum.

    Attributes
    ----------
    name, title : str
        The name in ``get``, and a title.
    equations : tuple of str
        The problem in LaTeX, line by line: the cost, the dynamics, limits and constants.
    problem : OptimalControlProblem
        The problem.
    start, end, horizon
        The arguments of ``solve``.
    states, controls : dict of str to str
        The entries by symbol, with units and frames.
    source : str
        The publication.
    optimum : float
        The lowest known cost.
    digits : int
        The number of verified significant digits of the optimum.
    origin : str
        The method of the verification, with formulas in LaTeX between dollar signs.
    formula : str
        The optimum in closed form, in LaTeX, if there is one.
    time, cost : str
        The units of time and cost.
    steps, method
        The arguments of ``solve``; ``method`` is None for ``Gauss(3, default_retraction(manifold))``.
    path : callable or None
        States and controls of the default guess at an array of fractions of the horizon, with points along the leading
        axis; None for the guess of ``solve``.
    accuracy : float or None
        The accuracy for ``solve``, if the steps have to be refined.
    error : float
        Relative distance from the optimum with these steps, absolute if the optimum is zero.
    """

    name: str
    title: str
    equations: tuple[str, ...]
    problem: OptimalControlProblem
    start: Any
    end: Any
    horizon: Any
    states: dict[str, str]
    controls: dict[str, str]
    source: str
    optimum: float
    digits: int
    origin: str
    formula: str = ""
    time: str = "1"
    cost: str = "1"
    steps: Any = 20
    method: Method | None = None
    path: Path | None = None
    accuracy: float | None = None
    error: float = 1e-8

    @property
    def discretization(self) -> Method:
        """The method of the record, or ``Gauss`` of order 6 in the default retraction."""
        return self.method or Gauss(3, default_retraction(self.problem.manifold))

    @property
    def guess(self) -> Guess | None:
        """The default guess at the stages of the steps; None for the guess of ``solve``."""
        if self.path is None:
            return None
        return Guess(*self.path(mesh_times(step_fractions(self.steps), self.discretization.nodes)[1]))

    def solve(self, steps: Any = None, method: Method | None = None, **options: Any) -> Solution:
        """The solution from the default guess.

        Parameters
        ----------
        steps, method, options
            Arguments of ``retrax.solve``, which replace the arguments of the record.
        """
        posed = replace(self, steps=self.steps if steps is None else steps, method=method or self.method)
        given = {"guess": posed.guess, "accuracy": self.accuracy, **options}
        given = {"method": posed.discretization, "steps": posed.steps, **given}
        return solve(self.problem, self.start, self.end, self.horizon, **given)

    def distance(self, cost: float) -> float:
        """The relative distance of a cost from the optimum, absolute if the optimum is zero; negative for a lower
        cost.

        Parameters
        ----------
        cost : float
            The cost.
        """
        return (cost - self.optimum) / (abs(self.optimum) or 1.0)

    def __repr__(self) -> str:
        return f"KnownProblem({self.name!r}: {self.title}; optimum {self.optimum:.{max(self.digits, 1)}g})"


_LIBRARY: dict[str, Callable[[], KnownProblem]] = {}


def register(make: Callable[[], KnownProblem]) -> Callable[[], KnownProblem]:
    """Add a function that makes a problem to the library, by its name with hyphens."""
    _LIBRARY[make.__name__.replace("_", "-")] = make
    return make


def get(name: str) -> KnownProblem:
    """The problem with a name.

    Parameters
    ----------
    name : str
        One of ``names()``; ``InvalidInputError`` for another name.

    Returns
    -------
    KnownProblem
        The problem.
    """
    if name not in _LIBRARY:
        raise InvalidInputError(f"no problem has the name {name!r}; the names are {', '.join(sorted(_LIBRARY))}")
    return _LIBRARY[name]()


def names() -> tuple[str, ...]:
    """The names of all problems, by subject.

    Returns
    -------
    tuple of str
        The names.
    """
    return tuple(_LIBRARY)


def all() -> tuple[KnownProblem, ...]:
    """The problems of the library, by subject.

    Returns
    -------
    tuple of KnownProblem
        The problems.
    """
    return tuple(make() for make in _LIBRARY.values())
