"""The common part of numeric and symbolic classifications."""

from dataclasses import dataclass, replace
from typing import Generic, NamedTuple, Protocol, Self, TypeVar

from ...manifolds import InvalidInputError
from ..problem.optimal_control_problem import OptimalControlProblem


class Piece(Protocol):
    """A piece of ``P_f`` of constant ranks."""

    @property
    def k_f(self) -> int: ...
    @property
    def k_f_base(self) -> int: ...
    @property
    def codimension(self) -> int: ...
    @property
    def rank(self) -> int: ...
    @property
    def free_controls(self) -> int: ...


class Signature(NamedTuple):
    """The codimension, the free controls and the rank of a stratum of ``P^k`` at a level."""

    codimension: int
    free_controls: int
    form_rank: int


P = TypeVar("P", bound=Piece)


@dataclass(frozen=True, eq=False)
class IntegrabilityResult(Generic[P]):
    """The result of the integrability algorithm.

    ``strata`` are the pieces of ``P_f``, largest dimension first, none if it is empty; the properties speak of the
    first.
    """

    problem: OptimalControlProblem
    strata: tuple[P, ...]

    @property
    def empty(self) -> bool:
        """Whether no piece of ``P_f`` was found: no extremal that was asked for, with controls in the interior, is
        known."""
        return not self.strata

    @property
    def contradictory(self) -> bool:
        """Whether ``P_f``, of which no piece was found, is empty: its conditions contradict each other."""
        return self.empty

    @property
    def stratified(self) -> bool:
        """Whether the points found lie on several pieces, so that ``P_f`` is not one manifold."""
        return len(self.strata) > 1

    def choose(self, index: int) -> Self:
        """The result with the piece ``strata[index]`` alone, to describe it and to integrate on it.

        Raises ``InvalidInputError`` if there is no such piece.
        """
        if not 0 <= index < len(self.strata):
            raise InvalidInputError(
                f"there is no stratum {index!r}; expected one of {list(range(len(self.strata)))}\n{self}"
            )
        return replace(self, strata=(self.strata[index],))

    @property
    def stratum(self) -> P:
        """The piece of largest dimension. Raises ``InvalidInputError`` if none was found."""
        if self.empty:
            why = "P_f is empty" if self.contradictory else "no point of P_f was found"
            raise InvalidInputError(f"{why}, so it has no dimension, form or controls to tell of\n{self}")
        return self.strata[0]

    @property
    def k_f(self) -> int:
        """Level at which ``S^k`` stops changing."""
        return self.stratum.k_f

    @property
    def k_f_base(self) -> int:
        """Level at which ``P^k`` stops changing; the controls may be determined later."""
        return self.stratum.k_f_base

    @property
    def codimension(self) -> int:
        """Number of independent equations of ``P_f`` in ``T*Q``."""
        return self.stratum.codimension

    @property
    def dimension(self) -> int:
        """Dimension of ``P_f``."""
        return 2 * self.problem.manifold.dimension - self.codimension

    @property
    def rank(self) -> int:
        """Rank of ``omega_f``."""
        return self.stratum.rank

    @property
    def first_class(self) -> int:
        """Number of first-class equations: the dimension of the kernel of ``omega_f``."""
        return self.dimension - self.rank

    @property
    def second_class(self) -> int:
        """Number of second-class equations."""
        return self.codimension - self.first_class

    @property
    def gauge_controls(self) -> int:
        """Number of controls that the necessary conditions leave free."""
        return self.stratum.free_controls

    @property
    def determined_controls(self) -> int:
        """Number of controls that are functions of state and costate."""
        return self.problem.controls.dimension - self.gauge_controls

    def report(self) -> None:
        """Print the classification."""
        print(self)
