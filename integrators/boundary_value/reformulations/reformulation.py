"""The interface of reformulations: an equivalent problem in the place of the problem as it is stated."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from ....manifolds import InvalidInputError

Data = TypeVar("Data")
Posed = TypeVar("Posed")
Found = TypeVar("Found")
Recovered = TypeVar("Recovered")


class Reformulation(ABC, Generic[Data, Posed, Found, Recovered]):
    """Equivalent problem of a form that the solver takes, and the way back [Boyd, Vandenberghe 2004, 4.1.3].

    Two problems are equivalent if a change of variables takes the admissible trajectories of the one to those of the
    other and keeps the cost. Then it takes extremals to extremals, and the adjoint of its derivative takes costates and
    multipliers back. A free horizon becomes a state in this way, switching times become parameters, and phases become
    one trajectory with coupled ends. Four maps describe a reformulation. ``apply`` takes the data of the stated problem
    to the data of the equivalent one. ``guess`` takes a guess there. ``recover`` brings back the extremal that a search
    finds, in the variables, times and names of the stated problem, and ``recover_sensitivity`` its derivatives, by the
    chain rule. ``solve`` composes the maps around a search. A new reformulation is one class with these maps.
    """

    @abstractmethod
    def apply(self, data: Data) -> Posed:
        """The equivalent problem, or its data where the problem itself is the same for all data."""

    @abstractmethod
    def guess(self, data: Data, posed: Posed) -> Any:
        """The guess of the equivalent problem; None if there is none."""

    @abstractmethod
    def recover(self, posed: Posed, found: Found) -> Recovered:
        """The solution of the stated problem from the solution of the equivalent problem."""

    def recover_sensitivity(self, found: Any) -> Any:
        """The derivatives of the recovered solution; by default an error, for solutions that no ``Solver`` keeps."""
        raise InvalidInputError(f"{type(self).__name__} recovers no derivatives; try Solver.sensitivity of a solution")

    def solve(self, data: Data, search: Callable[[Posed, Any], Found]) -> Recovered:
        """The solution of the stated problem, by a search of the equivalent problem from a guess."""
        posed = self.apply(data)
        return self.recover(posed, search(posed, self.guess(data, posed)))
