"""The fields of a solution, with the axes along which their arrays go."""

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from ...problem.quantities import Quantities
from ...reporting.records import Along, Values, write_protect
from .diagnostics import RegularChecks, SingularArc, SingularChecks, Statistics
from .interpolation import Interpolant


@dataclass(frozen=True, eq=False, repr=False)
class SolutionFields:
    """The fields of ``Solution``, whose docstring describes them; arrays are read-only."""

    times: Annotated[np.ndarray, Along("nodes", ndim=1)]
    states: Annotated[np.ndarray | Any, Along("nodes")]
    costates: Annotated[np.ndarray | Any, Along("nodes", like="states")]
    stage_times: Annotated[np.ndarray, Along("stages", ndim=1)]
    stage_states: Annotated[np.ndarray | Any, Along("stages", like="states")]
    stage_costates: Annotated[np.ndarray | Any, Along("stages", like="states")]
    controls: Annotated[np.ndarray | Any, Along("stages")]
    hamiltonians: Annotated[np.ndarray, Along("stages", ndim=1)]
    momenta: Annotated[dict[str, np.ndarray], Along("nodes", ndim=2)]
    body_costates: Annotated[dict[str, np.ndarray], Along("nodes")]
    spatial_costates: Annotated[dict[str, np.ndarray], Along("nodes")]
    cost: float
    success: bool
    result: str
    checks: RegularChecks | SingularChecks
    statistics: Statistics
    singular: SingularArc | None = None
    multipliers: Annotated[dict[str, np.ndarray], Along("stages", ndim=2)] = field(default_factory=dict)
    node_multipliers: Annotated[dict[str, np.ndarray], Along("nodes", ndim=2)] = field(default_factory=dict)
    parameters: Annotated[Any, Values()] = None
    interpolant: Interpolant | None = field(default=None, repr=False)
    quantities: Quantities | Any = None

    def __post_init__(self) -> None:
        write_protect(vars(self))


def at_stages(multipliers: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The multipliers of the inequalities, shape ``(N s, k)``, without boundary constraints."""
    return {name: rows for name, rows in multipliers.items() if rows.ndim > 1}
