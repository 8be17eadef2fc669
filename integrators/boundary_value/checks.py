"""What a user checks on a solution."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, Self, final

import numpy as np

from ...former_names import former_field
from ...manifolds.numerics.precision import default_tolerance
from .engine.diagnosis import Diagnostics

TOO_COARSE = 0.1


def _spread(values: np.ndarray) -> float:
    """The largest maximum minus minimum along the leading axis; along the last one NumPy takes a third of the time."""
    columns = np.ascontiguousarray(values.T)
    return float((columns.max(axis=-1) - columns.min(axis=-1)).max())


@dataclass(frozen=True)
class Checks(ABC):
    """What a user checks on a solution, regular or singular. Spreads are maximum minus minimum.

    ``defect``: largest distance, in the ambient space, between the end of a step and the start of the next, boundary
    included, entry by entry relative to the spread of the trajectory in the entry. ``stationarity``: by how much the
    other conditions of optimality are violated, relative. ``violations``: of each equation of the manifold, the largest
    at the nodes (for a rotation, the orthogonality error). ``hamiltonian``: value at the first stage, spread over the
    stages, and size, the largest of its parts ``<p, X>`` and ``F``, no less than their rounding. ``momentum_spreads``:
    for each factor on which a group acts, largest spread of a component of its momentum over the nodes; ``conserved``:
    how many of its components are constant along this extremal, whose brackets ``{J, H}`` vanish there.
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
        """The checks from the diagnostics of a trajectory, in NumPy arrays, and what its solver knows."""
        hamiltonians, tolerance = diagnostics.hamiltonians, default_tolerance()
        return cls(
            defect=defect,
            stationarity=stationarity,
            violations={name: float(value) for name, value in diagnostics.violations.items()},
            hamiltonian=float(hamiltonians[0]),
            hamiltonian_spread=_spread(hamiltonians),
            hamiltonian_size=float(diagnostics.hamiltonian_size),
            momentum_spreads={name: _spread(j) for name, j in diagnostics.momenta.items()},
            conserved={name: int((rates <= tolerance).sum()) for name, rates in diagnostics.brackets.items()},
            **more,
        )

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
        """Whether the Hamiltonian, constant along an exact extremal, varies by more than a tenth of its parts."""
        return self.hamiltonian_spread > TOO_COARSE * self.hamiltonian_size


@final
@dataclass(frozen=True)
class RegularChecks(Checks):
    """The checks of a regular extremal.

    ``stationarity``: largest derivative of the Lagrangian relative to its parts. ``conserved`` counts what is constant
    along the extremal, for which a symmetry of the problem may be the reason; with ``constraints``, which may break it,
    nothing is claimed. ``strict_minimum``: whether the Hessian is positive definite on the null space of the
    constraints. ``violation`` of the inequalities and ``complementarity``: largest product of a multiplier and its
    inequality, both at the stages and nodes, and relative. ``active``: at how many stages, or nodes, inequalities of
    each name hold the trajectory. If an accuracy was asked for: ``error``, the sum of the relative errors of the steps,
    and the largest violations ``between`` these, by the names of the inequalities.
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
    """The checks of a singular extremal.

    ``stationarity``: largest violation of the equations of ``P_f`` at the nodes, relative. ``conserved`` counts what is
    constant along the extremal, for which ``P_f`` may be the reason.
    """

    @property
    def strict_minimum(self) -> bool:
        """Not claimed: read ``singular.second_order``."""
        return False

    @property
    def error(self) -> float | Any:
        """None: the steps of a singular extremal are not refined to an accuracy."""
        return None
