"""The equations between the ends of phases: the boundary conditions of each of them, and links."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ....compute.base import Evaluator
from ...problem.optimal_control_problem import OptimalControlProblem
from .functions.linked_ends import Link, LinkageFunctions


class PhaseProblem(NamedTuple):
    """The problem of a phase, and parameters of it."""

    problem: OptimalControlProblem
    parameters: Any

    @property
    def sizes(self) -> dict[str, int]:
        """How many equations each of its boundary constraints has."""
        bound, q = self.problem.with_parameters(self.parameters), self.problem.manifold.ambient
        values = jax.eval_shape(bound._boundary.each, q, q)
        return {name: value.shape[0] for name, value in zip(bound._boundary.names, values, strict=True)}

    def state(self, y: Any) -> Any:
        """The state of the problem that a user gave."""
        return y[0] if self.problem._boundary.factor else y


def linkages_of(
    phases: Sequence[PhaseProblem],
    evaluator: Evaluator,
    links: Sequence[Link] = (),
    equations: Callable[[list[Any], list[Any]], Array] | None = None,
) -> LinkageFunctions:
    """The equations between the ends of phases: the conditions of each of them, more equations, and links."""

    def values(ends: list[Any], given: list[Any]) -> Array:
        pairs = zip(phases, given, ends[::2], ends[1::2], strict=True)
        boundary_values = [phase.problem.with_parameters(its)._boundary.values(a, b) for phase, its, a, b in pairs]
        return jnp.concatenate([*boundary_values, *([] if equations is None else [equations(ends, given)])])

    turns = [_turn(k, phase) for k, phase in enumerate(phases) if phase.problem._boundary.turn is not None]
    given = [phase.parameters for phase in phases]
    return LinkageFunctions([phase.problem for phase in phases], given, values, [*turns, *links], evaluator)


def _turn(k: int, phase: PhaseProblem) -> Link:
    """The link of the end of a phase to its start."""
    problem, manifold = phase.problem, phase.problem.manifold
    own: Any = manifold.factors[0] if problem._boundary.factor else manifold  # pyright: ignore[reportAttributeAccessIssue]
    return Link(own, 2 * k, 2 * k + 1, lambda y, given: problem.with_parameters(given)._periodic_end(y), phase.state)
