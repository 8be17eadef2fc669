"""The data of an optimal control problem, as its constructor keeps them."""

from collections.abc import Callable
from typing import Any

import equinox as eqx

from ...manifolds import Euclidean, Manifold
from ...module import Module
from .boundary_conditions import BoundaryConditions
from .path_constraints import Inequalities
from .quantities import Quantities
from .sampling import Sampling

# Any arguments: each takes the time and the parameters too where it wants them; ``require_arguments`` checks how many.
Dynamics = RunningCost = TerminalCost = Callable[..., Any]


class ProblemStatement(Module):
    """The manifolds, functions, inequalities and boundary conditions of a problem, and the names of its quantities."""

    manifold: Manifold
    dynamics: Dynamics
    running_cost: RunningCost
    controls: Manifold
    terminal_cost: TerminalCost | None
    abnormal: bool = eqx.field(static=True)
    initial_cost: TerminalCost | None
    _limits: Inequalities
    _boundary: BoundaryConditions
    time_dependent: bool = eqx.field(static=True)
    quantities: Quantities = eqx.field(static=True)
    node_cost: Callable[..., Any] | None
    takes_parameters: bool = eqx.field(static=True)
    sampling: Sampling | None

    @property
    def _shape(self) -> tuple[int, ...]:
        return self.controls.shape if isinstance(self.controls, Euclidean) else ()

    @property
    def _inequality_names(self) -> tuple[str, ...]:
        """A name for each of the inequalities, such as ``cone[1]``, of a problem without parameters."""
        return self._limits.words(self._inequality_sizes, self._shape)

    @property
    def _inequality_sizes(self) -> dict[str, int | None]:
        """The number of entries of each constraint; None for a number."""
        return self._limits.sizes(self.manifold.ambient, self.controls.ambient)

    @property
    def _node_sizes(self) -> dict[str, int | None]:
        """The number of entries of each node constraint; None for a number."""
        return self._limits.node_sizes(self.manifold.ambient)
