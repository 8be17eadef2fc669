"""The inequalities of the steps of a method in rows, as its equations have them, and under their names."""

from collections.abc import Mapping
from functools import cached_property
from typing import Any, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....manifolds import InvalidInputError
from ...problem.optimal_control_problem import OptimalControlProblem
from ...problem.path_constraints import count, entries_of
from ...problem.point_layout import PointLayout, parameter_layout
from ..inputs.boundary_data import PrescribedEnd

Named = dict[str, np.ndarray]


@final
class InequalityRows:
    """The rows of the inequalities of a problem whose functions take ``parameters`` of some structure.

    A step has rows at r places, c at each place. The s stages have the inequalities at points. The last place, which is
    one more if ``s > 1``, has the inequalities at nodes: at the end of the step, then at its beginning, which only the
    first step uses.
    """

    def __init__(self, problem: OptimalControlProblem, parameters: Any, stages: int) -> None:
        self.problem, self.parameter, self.stages = problem, parameter_layout(parameters), stages
        self.state, bound = PointLayout.of(problem.manifold), problem.with_parameters(parameters)
        self.limits, self.sizes, self.node_sizes = problem._limits, bound._inequality_sizes, bound._node_sizes
        self.own, self.nodes = len(bound._inequality_names), sum(map(count, self.node_sizes.values()))
        self._any = problem._limits.any
        self._once, self._by_name = self.limits.once(self.sizes), self.limits.by_name  # each takes a while to make

    @property
    def places(self) -> int:
        """Where a step has inequalities."""
        return self.stages + (self.nodes > 0 and self.stages > 1)

    def mask(self, steps: int, ends: tuple[PrescribedEnd, PrescribedEnd], repeated: bool = False) -> np.ndarray | None:
        """At which places each of them is asked for, shape ``(steps, r, c)``; None if there are none.

        At an end those are asked for that depend on something free, and at the first of periodic ends those that are
        not at the last one too; at a first node that is ``repeated``, the last one of another phase, none.
        """
        if not self._any:
            return None
        holds = np.zeros((steps, self.places, self.own + 2 * self.nodes), bool)
        holds[:, : self.stages, : self.own] = ~self._once
        holds[0, 0, : self.own] = True
        if not self.nodes:
            return holds
        at_end, at_start = (slice(self.own + k * self.nodes, self.own + (k + 1) * self.nodes) for k in (0, 1))
        first, last = (np.array(end.entries) for end in ends)
        if self.limits.clock:
            last[-1] = first[-1]
        holds[:, -1, at_end] = True
        holds[0, -1, at_start], holds[-1, -1, at_end] = (
            np.any(self._depends[:, ~known], axis=1) for known in (first, last)
        )
        if self.problem._boundary.closed:
            holds[0, -1, at_start] &= self._depends[:, -1] & (self.limits.clock is not None)
        holds[0, -1, at_start] &= not repeated
        return holds

    def at_stages(self, values: np.ndarray) -> Named:
        """The values of the inequalities at points, of shape ``(B, N, r, c)``, under their names, ``(B, N s, k)``."""
        rows = values[:, :, : self.stages, : self.own]
        return self._by_name(rows.reshape(len(rows), rows.shape[1] * self.stages, self.own), self.sizes)

    def at_nodes(self, values: np.ndarray) -> Named:
        """The values of the inequalities at nodes, of shape ``(B, N, r, c)``, under their names, ``(B, N + 1, k)``."""
        rows = values[:, :, -1, self.own :]
        return entries_of(
            np.concatenate([rows[:, :1, self.nodes :], rows[:, :, : self.nodes]], axis=1), self.node_sizes
        )

    def flat(
        self, named: Mapping[str, np.ndarray], at_nodes: Mapping[str, np.ndarray], steps: np.ndarray
    ) -> np.ndarray:
        """Multipliers of one member in rows, shape ``(N, r, c)``, zero for missing names; raises for wrong widths.

        Those ``at_nodes`` are divided by the lengths of the ``steps``, as the rows are weighted by these.
        """
        values = np.zeros((len(steps), self.places, self.own + 2 * self.nodes))
        bounded = ((name, side) for name, side in self.limits.bounded.items() if side)
        own = [_rows(named, name, len(self.limits.lower), "stage")[:, side] for name, side in bounded]
        own += [_rows(named, name, count(size), "stage") for name, size in self.sizes.items()]
        if own:
            whole = [np.broadcast_to(rows, (len(steps) * self.stages, rows.shape[1])) for rows in own]
            values[:, : self.stages, : self.own] = np.concatenate(whole, axis=1).reshape(len(steps), self.stages, -1)
        if self.nodes:
            every = [_rows(at_nodes, name, count(size), "node") for name, size in self.node_sizes.items()]
            rows = np.concatenate([np.broadcast_to(a, (len(steps) + 1, a.shape[1])) for a in every], axis=1)
            values[:, -1, self.own : self.own + self.nodes] = rows[1:] / steps[:, None]
            values[0, -1, self.own + self.nodes :] = rows[0] / steps[0]
        return values

    @cached_property
    def _depends(self) -> np.ndarray:
        """Whether each inequality at a node depends on each entry of the state, ``(c, E)``.

        Functions that are not scalar operations depend on all.
        """

        from ....tape import NotTraceableError, Tape

        def at_node(q: Array, parameters: Array) -> Array:
            return self.problem.with_parameters(self.parameter.point(parameters)).node_inequalities(self.state.point(q))

        given = jnp.zeros(self.state.size), jnp.zeros(self.parameter.size)
        try:
            sparsity = Tape.trace(at_node, *given).to_casadi().jac_sparsity(0, 0)
        except NotTraceableError:
            return np.ones((self.nodes, self.state.size), bool)
        mask = np.zeros((self.nodes, self.state.size), bool)
        mask[sparsity.get_triplet()] = True
        return mask


def _rows(named: Mapping[str, np.ndarray], name: str, width: int, place: str) -> np.ndarray:
    """The multipliers of a name, of this width, or a row of zeros; raises for another width."""
    given = named.get(name, np.zeros((1, width)))
    if given.shape[-1] != width:
        raise InvalidInputError(
            f"guess: multipliers of {name!r} have {given.shape[-1]} entries at a {place}, expected {width}; try "
            "guess._replace(multipliers=None), of a solution solution.guess()._replace(multipliers=None)"
        )
    return given
