"""The figures of a solution that a user checks."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Self, TypeVar, final

import numpy as np

from ....former_names import former_field
from ....manifolds.numerics.precision import default_tolerance
from ..transcription.diagnosis import Diagnostics

Record = TypeVar("Record", bound=Any)

TOO_COARSE = (
    0.1  # of the largest term of the Hamiltonian: a larger spread along an extremal says that steps are too long
)


FIGURES = "violations", "hamiltonian", "hamiltonian_spread", "hamiltonian_size", "momentum_spreads", "conserved"
LATER = "_later"  # attribute of checks: the function that computes their figures


def _range(values: np.ndarray) -> float:
    """The largest maximum minus minimum along the leading axis; along the last one NumPy takes a third of the time."""
    columns = np.ascontiguousarray(values.T)
    return float((columns.max(axis=-1) - columns.min(axis=-1)).max())


def figures(diagnostics: Diagnostics) -> dict[str, Any]:
    """The figures of one trajectory from its diagnostics, which are NumPy arrays."""
    hamiltonians, tolerance = diagnostics.hamiltonians, default_tolerance()
    values = (
        {name: float(value) for name, value in diagnostics.violations.items()},
        float(hamiltonians[0]),
        _range(hamiltonians),
        float(diagnostics.hamiltonian_size),
        {name: _range(j) for name, j in diagnostics.momenta.items()},
        {name: int((rates <= tolerance).sum()) for name, rates in diagnostics.brackets.items()},
    )
    return dict(zip(FIGURES, values, strict=True))


@dataclass(frozen=True)
class Checks(ABC):
    """The figures that show how good a solution is, for regular and singular extremals; a spread is maximum minus
    minimum.

    Attributes
    ----------
    defect : float
        Largest distance in the ambient space between the end of a step and the start of the next, boundary included. It
        is relative, entry by entry, to the spread of the trajectory.
    stationarity : float
        Relative violation of the other first-order conditions.
    violations : dict of str to float
        Largest violation of each equation of the manifold at the nodes, such as the orthogonality error of a rotation.
    hamiltonian : float
        The Hamiltonian at the first stage.
    hamiltonian_spread : float
        Its spread over the stages.
    hamiltonian_size : float
        The largest of its terms ``<p, X>`` and ``F``, at least their rounding.
    momentum_spreads : dict of str to float
        For each factor on which a group acts, the largest spread of a component of its momentum over the nodes.
    conserved : dict of str to int
        The number of components of the momentum that are constant along this extremal: their brackets ``{J, H}``
        vanish, and so do the derivatives of the inequalities along their generators, if inequalities are active.
    """

    defect: float
    stationarity: float
    violations: dict[str, float]
    hamiltonian: float
    hamiltonian_spread: float
    hamiltonian_size: float
    momentum_spreads: dict[str, float]
    conserved: dict[str, int]

    @classmethod
    def of(cls, diagnostics: Diagnostics, defect: float, stationarity: float, **more: Any) -> Self:
        """The figures from the diagnostics of a trajectory in NumPy arrays.

        Parameters
        ----------
        diagnostics, defect, stationarity : Diagnostics, float, float
            The diagnostics, and the figures of the solver.
        **more
            Further fields.
        """
        return cls(defect=defect, stationarity=stationarity, **figures(diagnostics), **more)

    @classmethod
    def later(cls, make: Callable[[], dict[str, Any]], **known: Any) -> Self:
        """The known figures, and further figures that are computed when one of them is read.

        Parameters
        ----------
        make : callable
            A function that returns the figures of the Hamiltonian and of momenta, and the violations.
        **known
            The remaining fields.
        """
        checks = object.__new__(cls)
        vars(checks).update(known, **{LATER: make})
        return checks

    if not TYPE_CHECKING:  # a checker knows the fields

        def __getattr__(self, name: str) -> Any:
            known = vars(self)
            make = known.get(LATER) if name in FIGURES else None
            if make is not None:
                known.update(make())
                known.pop(LATER, None)  # what it holds is large; another thread may have been here
            if name not in known:
                raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
            return known[name]

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}

    gap = former_field("checks", "gap", "defect")
    constraint = former_field("checks", "constraint", "manifold_violation")

    @property
    @abstractmethod
    def strict_minimum(self) -> bool:
        """Whether the extremal is shown to be a strict local minimum of the discrete problem."""

    @property
    def manifold_violation(self) -> float:
        """Largest violation of the manifold's equations at the nodes."""
        return max(self.violations.values(), default=0.0)

    @property
    def too_coarse(self) -> bool:
        """Whether the Hamiltonian, constant along an exact extremal, varies by a tenth of its largest term or more."""
        return self.hamiltonian_spread > TOO_COARSE * self.hamiltonian_size


@final
@dataclass(frozen=True)
class RegularChecks(Checks):
    """The figures of a regular extremal: ``Checks`` with inequalities and the error of the steps.

    Attributes
    ----------
    defect, stationarity, violations, hamiltonian, hamiltonian_spread, hamiltonian_size, momentum_spreads, conserved
        As in ``Checks``. ``stationarity`` is the largest derivative of the Lagrangian relative to its parts.
    strict_minimum : bool
        Whether the Hessian is positive definite on the null space of the constraints: the second-order conditions hold.
    violation : float
        Largest relative violation of the inequalities at the stages and nodes.
    complementarity : float
        Largest relative product of a multiplier and its inequality.
    active : dict of str to int
        The number of stages, or nodes, at which inequalities of each name hold the trajectory.
    error : float or None
        Sum of the relative errors of the steps, if an ``accuracy`` was given.
    between : dict of str to float
        Largest violation of each inequality between the stages, if an ``accuracy`` was given.
    """

    strict_minimum: bool = False  # pyright: ignore[reportIncompatibleMethodOverride]  # a field is read as a property is
    violation: float = 0.0
    complementarity: float = 0.0
    active: dict[str, int] = field(default_factory=dict)
    error: float | Any = None
    between: dict[str, float] = field(default_factory=dict)


@final
@dataclass(frozen=True)
class SingularChecks(Checks):
    """The figures of a singular extremal: ``Checks`` with the conditions on the final manifold ``P_f``.

    Attributes
    ----------
    defect, stationarity, violations, hamiltonian, hamiltonian_spread, hamiltonian_size, momentum_spreads, conserved
        As in ``Checks``. ``stationarity`` is the largest relative violation of the equations of ``P_f`` at the nodes.
    """

    @property
    def strict_minimum(self) -> bool:
        """Not claimed: read ``singular.second_order``."""
        return False

    @property
    def error(self) -> float | Any:
        """None: the steps of a singular extremal are not refined to an accuracy."""
        return None


@dataclass(frozen=True)
class Statistics:
    """The effort of a computation: iterations and seconds.

    Attributes
    ----------
    iterations : int
        Trial points of the search that found the result, and of the failed searches before it.
    compile_seconds : float
        Seconds to prepare: to trace and compile, to classify a singular problem, and to check the solution.
    run_seconds : float
        Seconds to run; of a singular problem with compilation.
    stopped : bool
        Whether a callback or an interrupt asked for an end.

    Notes
    -----
    If the search from the guess fails, others follow from moved guesses, each with its own ``max_iterations``.
    A member of a batch has a share of the seconds of the batch: an equal share of the seconds to compile, and a share
    of the seconds to run by its iterations. The shares of all members add up to the batch. Both numbers of seconds of
    ``retrax.solve`` add up to the time of the call.
    """

    iterations: int
    compile_seconds: float
    run_seconds: float
    stopped: bool = False


def add_compile_time(record: Record, seconds: float) -> Record:
    """The record with so many more seconds to prepare; the same object if there are none."""
    if not seconds:
        return record
    spent = record.statistics
    return replace(record, statistics=replace(spent, compile_seconds=spent.compile_seconds + seconds))


def count_call_time(record: Record, began: float) -> Record:
    """The record of a call that began then: all seconds since that did not run were to prepare."""
    spent = record.statistics
    return add_compile_time(record, time.perf_counter() - began - spent.compile_seconds - spent.run_seconds)


@dataclass(frozen=True)
class SingularArc:
    """The particulars of an interior singular extremal, a curve in the final manifold ``P_f``.

    Attributes
    ----------
    dimension : int
        Dimension of ``P_f``.
    kernel : int
        Dimension of the kernel of its form.
    gauge_controls : int
        Number of controls that the equations leave free.
    strategy : str
        The strategy with its reason, or the class of a given integrator.
    presymplectic : bool
        Whether the integrator preserves the form of ``P_f``.
    conditions : dict of str to float
        Violation of each boundary condition, relative to 1 + size.
    independent : int
        Number of boundary conditions that are independent on ``P_f``, to first order.
    second_order : str
        The result of the generalised Legendre-Clebsch condition.
    """

    dimension: int
    kernel: int
    gauge_controls: int
    strategy: str
    presymplectic: bool
    conditions: dict[str, float]
    independent: int
    second_order: str
